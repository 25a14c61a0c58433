// SPDX-License-Identifier: GPL-2.0-or-later
#include "sample.hpp"

#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>
#include <pybind11/numpy.h>

#include "bindings.hpp"

namespace axon::python {
namespace {

namespace py = pybind11;
namespace pb = google::protobuf;

/// An empty axon.proto.StreamSample. Its header is not installed with the client library, but the library has
/// it inside.
const pb::Message& prototype() {
    static const pb::Message& the = [&]() -> const pb::Message& {
        const auto* const type =
            pb::DescriptorPool::generated_pool()->FindMessageTypeByName("axon.proto.StreamSample");
        if (!type) throw std::logic_error("the client library has no axon.proto.StreamSample");
        return *pb::MessageFactory::generated_factory()->GetPrototype(type);
    }();
    return the;
}

/// A message, and its fields by their names.
class Reader {
  public:
    explicit Reader(const pb::Message& message) : message_(message), reflection_(*message.GetReflection()) {}

    double number(const char* name) const { return reflection_.GetDouble(message_, field(name)); }
    std::uint32_t whole(const char* name) const { return reflection_.GetUInt32(message_, field(name)); }
    const std::string& bytes(const char* name) const {
        return reflection_.GetStringReference(message_, field(name), &unused_);
    }
    template <class T>
    const pb::RepeatedField<T>& many(const char* name) const {
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wdeprecated-declarations"  // its successor has no contiguous memory
        return reflection_.GetRepeatedField<T>(message_, field(name));
#pragma GCC diagnostic pop
    }

  private:
    const pb::FieldDescriptor* field(const char* name) const {
        const auto* const found = message_.GetDescriptor()->FindFieldByName(name);
        if (!found)
            throw std::logic_error(std::string("a sample of this client library has no field ") + name);
        return found;
    }
    const pb::Message& message_;
    const pb::Reflection& reflection_;
    mutable std::string unused_;
};

/// What the sample holds: its name in the .proto, and the message in it (nullptr for raw bytes).
struct Content {
    std::string kind;
    const pb::Message* message = nullptr;
    const std::string* raw = nullptr;
};

}  // namespace

/// The sample. It is read when it is first looked into; then the bytes that arrived are let go, and arrays
/// look into what was read, so they keep it alive.
class NativeSample {
  public:
    explicit NativeSample(client::Sample sample) : sample_(std::move(sample)) {}

    const client::Sample& sample() const { return sample_; }
    const Content& content() {
        if (read_) return content_;
        read_.reset(prototype().New());
        if (!read_->ParseFromString(sample_.raw)) {
            read_.reset();
            throw py::value_error("stream " + sample_.stream + " brought a sample that cannot be read");
        }
        std::string().swap(sample_.raw);
        const auto* const type = read_->GetDescriptor();
        const auto& reflection = *read_->GetReflection();
        const auto* const which = reflection.GetOneofFieldDescriptor(*read_, type->FindOneofByName("sample"));
        if (!which) return content_;
        content_.kind = which->name();
        if (which->cpp_type() == pb::FieldDescriptor::CPPTYPE_MESSAGE)
            content_.message = &reflection.GetMessage(*read_, which);
        else
            content_.raw = &reflection.GetStringReference(*read_, which, &scratch_);
        return content_;
    }
    Reader reader(const char* kind) {
        const auto& in = content();
        if (in.kind != kind)
            throw py::type_error("stream " + sample_.stream + " brings " + in.kind + ", not " + kind);
        return Reader(*in.message);
    }
    double taken_at() {
        content();
        const auto* const field = read_->GetDescriptor()->FindFieldByName("taken_at_us");
        return static_cast<double>(read_->GetReflection()->GetInt64(*read_, field)) * 1e-6;
    }

  private:
    client::Sample sample_;
    std::unique_ptr<pb::Message> read_;
    Content content_;
    std::string scratch_;
};

namespace {

/// An array that looks into the sample and cannot be written.
template <class T>
py::array view(const py::object& sample, const T* data, std::vector<py::ssize_t> shape) {
    py::array array(py::dtype::of<T>(), std::move(shape), data, sample);
    array.attr("setflags")(py::arg("write") = false);
    return array;
}

template <class T>
py::array view(const py::object& sample, const pb::RepeatedField<T>& values) {
    return view(sample, values.data(), {static_cast<py::ssize_t>(values.size())});
}

/// Bytes per pixel and their type, of the encodings that are arrays as they are.
py::array image(const py::object& self) {
    const auto in = self.cast<NativeSample&>().reader("image");
    const auto& encoding = in.bytes("encoding");
    const auto& pixels = in.bytes("pixels");
    const py::ssize_t width = in.whole("width"), height = in.whole("height");
    const auto* const bytes = reinterpret_cast<const std::uint8_t*>(pixels.data());
    const auto size = static_cast<py::ssize_t>(pixels.size());
    const auto check = [&](py::ssize_t per_pixel) {
        const auto row = width * per_pixel;  // at most 34 bits
        const bool fits = row > 0 ? size % row == 0 && size / row == height : size == 0;
        if (!fits)
            throw py::value_error("a picture of " + std::to_string(width) + " x " + std::to_string(height) +
                                  " pixels of " + encoding + " was expected, and it has " +
                                  std::to_string(size) + " bytes");
    };
    if (encoding == "rgb8" || encoding == "bgr8") return check(3), view(self, bytes, {height, width, 3});
    if (encoding == "rgba8" || encoding == "bgra8") return check(4), view(self, bytes, {height, width, 4});
    if (encoding == "mono8") return check(1), view(self, bytes, {height, width});
    if (encoding == "mono16") {
        check(2);
        if (reinterpret_cast<std::uintptr_t>(bytes) % alignof(std::uint16_t))
            throw py::value_error("a picture of mono16 is not aligned");
        return view(self, reinterpret_cast<const std::uint16_t*>(bytes), {height, width});
    }
    return view(self, bytes, {size});  // compressed
}

py::object dataOf(const py::object& self) {
    auto& sample = self.cast<NativeSample&>();
    const auto& in = sample.content();
    if (in.kind == "scalar") return py::float_(Reader(*in.message).number("value"));
    if (in.kind == "vector") return view(self, Reader(*in.message).many<double>("values"));
    if (in.kind == "scan") return view(self, Reader(*in.message).many<float>("ranges"));
    if (in.kind == "image") return image(self);
    if (in.kind == "pose") {
        const Reader pose(*in.message);
        py::list numbers;
        for (const auto* const name : {"x", "y", "z", "roll", "pitch", "yaw"})
            numbers.append(pose.number(name));
        return py::module_::import("numpy").attr("array")(numbers);
    }
    return in.raw ? py::object(py::bytes(*in.raw)) : py::object(py::none());
}

}  // namespace

py::object toPython(client::Sample sample) {
    return py::cast(std::make_unique<NativeSample>(std::move(sample)));
}

void bindSamples(py::module_& module) {
    py::class_<NativeSample>(module, "NativeSample")
        .def_property_readonly("entity",
                               [](const NativeSample& sample) { return text(sample.sample().entity); })
        .def_property_readonly("stream",
                               [](const NativeSample& sample) { return text(sample.sample().stream); })
        .def_property_readonly("sequence",
                               [](const NativeSample& sample) { return sample.sample().sequence; })
        .def_property_readonly("taken_at", &NativeSample::taken_at)
        .def_property_readonly("kind", [](NativeSample& sample) { return sample.content().kind; })
        .def_property_readonly("units",
                               [](NativeSample& sample) {
                                   const auto& in = sample.content();
                                   const bool has = in.kind == "scalar" || in.kind == "vector";
                                   return has ? text(Reader(*in.message).bytes("units")) : text("");
                               })
        .def_property_readonly(
            "frame", [](NativeSample& sample) { return text(sample.reader("pose").bytes("frame")); })
        .def_property_readonly(
            "encoding", [](NativeSample& sample) { return text(sample.reader("image").bytes("encoding")); })
        .def_property_readonly(
            "start_angle", [](NativeSample& sample) { return sample.reader("scan").number("start_angle"); })
        .def_property_readonly("step",
                               [](NativeSample& sample) { return sample.reader("scan").number("step"); })
        .def_property_readonly("max_range",
                               [](NativeSample& sample) { return sample.reader("scan").number("max_range"); })
        .def_property_readonly("angles",
                               [](const py::object& self) {
                                   return view(
                                       self, self.cast<NativeSample&>().reader("scan").many<float>("angles"));
                               })
        .def_property_readonly("data", &dataOf);
    // For tests and benchmarks: as if it had come from an entity.
    module.def("read_sample", [](const std::string& stream, const py::bytes& raw) {
        return toPython({"", stream, 0, std::string(raw)});
    });
}

}  // namespace axon::python
