// SPDX-License-Identifier: MIT
// axon_entity._native: the Entity Interfacer for Python. Typed by axon_entity/_native.pyi.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <unistd.h>

#include <axon/device_guard.hpp>
#include <cstring>

#include "interfacer.hpp"

namespace py = pybind11;
using namespace axon::python;

namespace {

/// For calls that may wait for a mutex, a thread or the system.
using Others = py::call_guard<py::gil_scoped_release>;

std::vector<axon::Value> toValues(const py::object& object, const std::string& what) {
    std::vector<axon::Value> values;
    if (py::isinstance<py::list>(object) || py::isinstance<py::tuple>(object))
        for (const auto& one : object) values.push_back(toValue(one, what));
    else
        values.push_back(toValue(object, what));
    return values;
}

/// The bytes of a contiguous buffer, copied once, without the interpreter lock.
std::string copied(const py::buffer_info& buffer) {
    py::ssize_t contiguous = buffer.itemsize;
    for (auto axis = buffer.ndim; axis-- > 0;) {
        if (buffer.shape[static_cast<std::size_t>(axis)] > 1 &&
            buffer.strides[static_cast<std::size_t>(axis)] != contiguous)
            throw py::value_error(
                "expected a contiguous array; fix: pass numpy.ascontiguousarray(array) instead of a view");
        contiguous *= buffer.shape[static_cast<std::size_t>(axis)];
    }
    const auto bytes = static_cast<std::size_t>(buffer.size * buffer.itemsize);
    const py::gil_scoped_release others;
    return std::string(static_cast<const char*>(buffer.ptr), bytes);
}

axon::Image toImage(const py::buffer& pixels, std::uint32_t width, std::uint32_t height,
                    std::string encoding) {
    return {width, height, std::move(encoding), copied(pixels.request())};
}

template <class Number>
bool copyNumbers(const py::buffer_info& buffer, const char* format, std::vector<double>& out) {
    if (buffer.format != format) return false;
    const auto* from = static_cast<const char*>(buffer.ptr);
    for (py::ssize_t i = 0; i < buffer.size; ++i) {
        Number value{};
        std::memcpy(&value, from + i * buffer.strides[0], sizeof value);
        out.push_back(static_cast<double>(value));
    }
    return true;
}

std::vector<double> toNumbers(const py::object& object) {
    if (!PyObject_CheckBuffer(object.ptr())) return object.cast<std::vector<double>>();
    const auto buffer = object.cast<py::buffer>().request();
    if (buffer.ndim != 1)
        throw py::value_error("expected an array of one dimension, found " + std::to_string(buffer.ndim));
    std::vector<double> numbers;
    numbers.reserve(static_cast<std::size_t>(buffer.size));
    if (copyNumbers<double>(buffer, "d", numbers) || copyNumbers<float>(buffer, "f", numbers)) return numbers;
    return object.cast<std::vector<double>>();
}

std::vector<float> toFloats(const py::object& object) {
    const auto numbers = toNumbers(object);
    return {numbers.begin(), numbers.end()};
}

axon::EntityInterfacer::Options toOptions(const py::dict& settings, bool& queue_log) {
    axon::EntityInterfacer::Options options;
    for (const auto& [key, value] : settings) {
        const auto name = key.cast<std::string>();
        if (name == "application")
            options.application = value.cast<std::string>();
        else if (name == "instance")
            options.instance = value.cast<std::string>();
        else if (name == "ports_file")
            options.ports_file = value.cast<std::string>();
        else if (name == "first_port")
            options.first_port = value.cast<std::uint16_t>();
        else if (name == "last_port")
            options.last_port = value.cast<std::uint16_t>();
        else if (name == "address")
            options.address = value.cast<std::string>();
        else if (name == "users")
            options.users = value.cast<std::string>();
        else if (name == "beyond_loopback")
            options.beyond_loopback = value.cast<bool>();
        else if (name == "watch_profiles")
            options.watch_profiles = value.cast<bool>();
        else if (name == "resource_folders")
            for (const auto& folder : value.cast<std::vector<std::string>>())
                options.resource_folders.emplace_back(folder);
        else if (name == "reports_standstill")
            options.reports_standstill = value.cast<bool>();
        else if (name == "clock")
            options.clock = value.cast<ClockOfTest&>().clock;
        else if (name == "queue_log")
            queue_log = value.cast<bool>();
        else
            throw py::type_error("unknown setting '" + name + "'");
    }
    return options;
}

std::unique_ptr<Interfacer> makeInterfacer(const py::dict& settings) {
    bool queue_log = false;
    auto options = toOptions(settings, queue_log);
    return std::make_unique<Interfacer>(Interfacer::Settings{std::move(options), queue_log});
}

void defineTypes(py::module_& module) {
    using Cause = axon::StopSignal::Cause;
    py::enum_<Cause>(module, "StopCause", "Why the robot is stopped.")
        .value("UNSPECIFIED", Cause::Unspecified)
        .value("REQUESTED", Cause::Requested)
        .value("CLIENT_LOST", Cause::ClientLost)
        .value("RELEASED", Cause::Released)
        .value("IMPROPER", Cause::Improper)
        .value("SERVER_LOST", Cause::ServerLost)
        .value("LINK_LOST", Cause::LinkLost)
        .value("RESET", Cause::Reset)
        .value("CLEAR", Cause::Clear)
        .value("CANCEL", Cause::Cancel)
        .value("SHUTDOWN", Cause::Shutdown)
        .value("FAULT", Cause::Fault)
        .def_property_readonly("text", [](Cause cause) { return axon::toString(cause); });
    py::class_<axon::StopSignal>(module, "StopSignal", "The order to stop all motion now.")
        .def_readonly("cause", &axon::StopSignal::cause)
        .def_readonly("generation", &axon::StopSignal::generation)
        .def("__repr__", [](const axon::StopSignal& signal) {
            return "<StopSignal " + std::to_string(signal.generation) + ": " + axon::toString(signal.cause) +
                   ">";
        });
    py::class_<axon::Parameter>(module, "Parameter", "One parameter as the client gave it.")
        .def_readonly("name", &axon::Parameter::name)
        .def_property_readonly("values",
                               [](const axon::Parameter& parameter) {
                                   py::list values;
                                   for (const auto& value : parameter.values) values.append(fromValue(value));
                                   return values;
                               })
        .def_readonly("units", &axon::Parameter::units);
    py::class_<ClockOfTest>(module, "ClockOfTest", "A clock of axon_entity.testing.");
}

/// A task, a stream or a stop action, in the process to which it belongs: in a fork, a lock of it may be held
/// for ever.
template <class Thing>
Thing& owned(Thing& thing) {
    checkProcessOfTasks();
    return thing;
}

/// The values of a parameter as it is now. The library's readers say so by an exception where the type
/// differs.
py::list valuesNow(const axon::Task& task, const std::string& name) {
    const auto read = [](const auto& values) {
        py::list list;
        for (const auto& value : values) list.append(fromValue(axon::Value(value)));
        return list;
    };
    try {
        return read(task.texts(name));
    } catch (const std::invalid_argument&) {
    }
    try {
        return read(task.integers(name));
    } catch (const std::invalid_argument&) {
    }
    try {
        py::list list;
        for (const bool value : task.flags(name)) list.append(py::bool_(value));
        return list;
    } catch (const std::invalid_argument&) {
    }
    return read(task.numbers(name));
}

void defineTask(py::module_& module) {
    using axon::Task;
    py::class_<Task>(module, "Task")
        .def_property_readonly("id", &Task::id)
        .def_property_readonly("service", &Task::service)
        .def("has", [](const Task& task, const std::string& name) { return owned(task).has(name); })
        .def("values", [](const Task& task, const std::string& name) { return valuesNow(owned(task), name); })
        .def("units", [](const Task& task, const std::string& name) { return owned(task).units(name); })
        .def("resource",
             [](const Task& task, const std::string& name) { return owned(task).resource(name).string(); })
        .def("progress",
             [](Task& task, double part) {
                 checkProcessOfTasks();
                 const py::gil_scoped_release others;
                 task.progress(part);
             })
        .def("feedback",
             [](Task& task, const std::string& text) {
                 checkProcessOfTasks();
                 const py::gil_scoped_release others;
                 task.feedback(text);
             })
        .def("result",
             [](Task& task, const std::string& name, const py::object& value, const std::string& units) {
                 checkProcessOfTasks();
                 auto values = toValues(value, "result '" + name + "'");
                 const py::gil_scoped_release others;
                 task.result(name, std::move(values), units);
             })
        .def_property_readonly("stop_requested", [](const Task& task) { return owned(task).stopRequested(); })
        .def_property_readonly("stop_cause", [](const Task& task) { return owned(task).stopCause(); })
        .def_property_readonly("paused", [](const Task& task) { return owned(task).paused(); })
        .def(
            "wait_while_paused",
            [](const Task& task) {
                checkProcessOfTasks();
                return task.waitWhilePaused();
            },
            Others())
        .def(
            "wait",
            [](const Task& task, double seconds) {
                checkProcessOfTasks();
                return task.waitFor(std::chrono::duration<double>(std::min(seconds, 1e9)));
            },
            Others())
        .def("fail",
             [](Task& task, const std::string& reason) {
                 checkProcessOfTasks();
                 const py::gil_scoped_release others;
                 task.fail(reason);
             })
        .def("robot_lost", [](Task& task, const std::string& reason) {
            checkProcessOfTasks();
            const py::gil_scoped_release others;
            task.robotLost(reason);
        });
}

/// Sends a sample that was made with the interpreter lock, without it.
template <class... Sample>
void send(axon::Stream& stream, const Sample&... sample) {
    checkProcessOfTasks();
    const py::gil_scoped_release others;
    stream.send(sample...);
}

void defineStream(py::module_& module) {
    using axon::Stream;
    py::class_<Stream>(module, "Stream")
        .def_property_readonly("wanted", [](const Stream& stream) { return owned(stream).wanted(); })
        .def("value",
             [](Stream& stream, double value, const std::string& units) { send(stream, value, units); })
        .def("values", [](Stream& stream, const py::object& values,
                          const std::string& units) { send(stream, toNumbers(values), units); })
        .def("pose",
             [](Stream& stream, double x, double y, double z, double roll, double pitch, double yaw,
                const std::string& frame) {
                 send(stream, axon::Pose{x, y, z, roll, pitch, yaw, frame});
             })
        .def("scan",
             [](Stream& stream, double start_angle, double step, double max_range, const py::object& ranges,
                const py::object& angles) {
                 send(stream, axon::Scan{start_angle, step, max_range, toFloats(ranges), toFloats(angles)});
             })
        .def("image",
             [](Stream& stream, const py::buffer& pixels, std::uint32_t width, std::uint32_t height,
                const std::string& encoding) { send(stream, toImage(pixels, width, height, encoding)); })
        .def("bytes", [](Stream& stream, const py::buffer& bytes) {
            checkProcessOfTasks();
            const auto copy = copied(bytes.request());
            const py::gil_scoped_release others;
            stream.sendBytes(copy);
        });
}

void defineInterfacer(py::module_& module) {
    py::class_<Interfacer>(module, "Interfacer")
        .def(py::init(&makeInterfacer))
        .def("upload_basic_profile", &Interfacer::uploadBasicProfile, Others())
        .def("upload_service_profile", &Interfacer::uploadServiceProfile, Others())
        .def("on_task", &Interfacer::onTask)
        .def("on", &Interfacer::on)
        .def("on_stop", &Interfacer::onStop)
        .def("start", &Interfacer::start)
        .def("wait_until_quit", &Interfacer::waitUntilQuit)
        .def("quit", &Interfacer::quit)
        .def("begin_shutdown", &Interfacer::beginShutdown, Others())
        .def("force_exit_after", &Interfacer::forceExitAfter, Others())
        .def("finish", &Interfacer::finish, Others())
        .def("take_log", &Interfacer::takeLog, Others())
        .def_property_readonly("log_ended", &Interfacer::logEnded)
        .def_property_readonly("started", &Interfacer::started)
        .def_property_readonly("forked", &Interfacer::forked)
        .def_property_readonly("stops", &Interfacer::stops)
        .def_property_readonly("linked", [](const Interfacer& self) { return self.library().linked(); })
        .def_property_readonly("port", [](const Interfacer& self) { return self.library().port(); })
        .def(
            "standstill", [](Interfacer& self) { self.library().standstill(); }, Others())
        .def(
            "status",
            [](Interfacer& self, bool busy, const std::string& text) {
                self.library().setStatus(busy, text);
            },
            Others())
        .def(
            "info", [](Interfacer& self, const std::string& text) { self.library().sendInfoMsg(text); },
            Others())
        .def("raw",
             [](Interfacer& self, const std::string& to, const std::vector<py::bytes>& blocks) {
                 const std::vector<std::string> copies(blocks.begin(), blocks.end());
                 const py::gil_scoped_release others;
                 self.library().sendRawTo(to, copies);
             })
        .def(
            "position",
            [](Interfacer& self, double x_mm, double y_mm, double z_mm) {
                self.library().setPosition(x_mm, y_mm, z_mm);
            },
            Others())
        .def(
            "service_active",
            [](Interfacer& self, const std::string& service, bool active, const std::string& reason) {
                self.library().setServiceActive(service, active, reason);
            },
            Others())
        .def(
            "stream", [](Interfacer& self, const std::string& name) { return self.library().stream(name); },
            Others());
}

void defineStopActions(py::module_& module) {
    using Seconds = std::chrono::duration<double>;
    py::class_<StopAction, std::shared_ptr<StopAction>>(module, "StopAction")
        .def(
            "carry_out",
            [](StopAction& action) {
                checkProcessOfTasks();
                action.carryOut();
            },
            Others())
        .def_property_readonly("runs", [](const StopAction& action) { return owned(action).runs(); })
        .def_property_readonly("failures", [](const StopAction& action) { return owned(action).failures(); })
        .def("__repr__", [](const StopAction& action) { return "<" + action.describe() + ">"; });
    py::class_<CloseDescriptor, StopAction, std::shared_ptr<CloseDescriptor>>(module, "CloseDescriptor")
        .def(py::init<int>())
        .def(
            "watch", [](CloseDescriptor& action, int descriptor) { owned(action).watch(descriptor); },
            Others())
        .def(
            "release", [](CloseDescriptor& action) { owned(action).release(); }, Others())
        .def_property_readonly("closed",
                               [](const CloseDescriptor& action) { return owned(action).closed(); });
    py::class_<WriteBytes, StopAction, std::shared_ptr<WriteBytes>>(module, "WriteBytes")
        .def(py::init([](int descriptor, const py::bytes& bytes, double within) {
            return std::make_shared<WriteBytes>(descriptor, bytes, Seconds(within));
        }))
        .def(py::init([](const std::string& path, const py::bytes& bytes, double within) {
            return std::make_shared<WriteBytes>(std::filesystem::path(path), bytes, Seconds(within));
        }))
        .def("order",
             [](WriteBytes& action, const axon::Task& task, const py::bytes& bytes) {
                 checkProcessOfTasks();
                 const std::string order = bytes;
                 const py::gil_scoped_release others;
                 return action.order([&] { return task.stopRequested(); }, order);
             })
        .def(
            "watch", [](WriteBytes& action, int descriptor) { owned(action).watch(descriptor); }, Others())
        .def(
            "release", [](WriteBytes& action) { owned(action).release(); }, Others());
    py::class_<RunCommand, StopAction, std::shared_ptr<RunCommand>>(module, "RunCommand")
        .def(py::init([](std::vector<std::string> words, double within) {
            return std::make_shared<RunCommand>(std::move(words), Seconds(within));
        }));
}

/// A guard, for the process that has made it. A fork of that process has the same connection to the guard, so
/// whatever it did would be done in the name of the other: it would end the guarding, or beat for a process
/// that is frozen.
class OwnGuard {
  public:
    explicit OwnGuard(axon::DeviceGuard::Options options)
        : guard_(std::make_unique<axon::DeviceGuard>(std::move(options))) {}
    OwnGuard(const OwnGuard&) = delete;
    OwnGuard& operator=(const OwnGuard&) = delete;
    ~OwnGuard() {
        if (::getpid() != process_) {
            (void)guard_.release();
            return;
        }
        const py::gil_scoped_release others;  // it waits for the guard's end
        guard_.reset();
    }
    axon::DeviceGuard& get() const {
        if (::getpid() != process_)
            throw ForkedError(
                "this process is a fork of the one to which the guard belongs; fix: make a DeviceGuard in "
                "this process, or start other processes with subprocess or "
                "multiprocessing.get_context('spawn')");
        return *guard_;
    }

  private:
    const pid_t process_ = ::getpid();
    std::unique_ptr<axon::DeviceGuard> guard_;
};

void defineGuard(py::module_& module) {
    py::class_<OwnGuard>(module, "DeviceGuard",
                         "A process beside this one that stops the device when this one freezes or dies.")
        .def(py::init([](const std::string& device, const py::bytes& stop, double silence) {
                 axon::DeviceGuard::Options options;
                 options.device = device;
                 options.stop = stop;
                 options.silence = std::chrono::milliseconds(static_cast<std::int64_t>(silence * 1000));
                 return std::make_unique<OwnGuard>(std::move(options));
             }),
             py::arg("device"), py::kw_only(), py::arg("stop"), py::arg("silence") = 0.2)
        .def(
            "watch", [](const OwnGuard& guard, int fd) { return guard.get().watch(fd); }, py::arg("fd"),
            Others())
        .def(
            "beat", [](const OwnGuard& guard) { return guard.get().beat(); }, Others())
        .def_property_readonly("stopped", [](const OwnGuard& guard) { return guard.get().stopped(); })
        .def(
            "release", [](const OwnGuard& guard) { guard.get().release(); }, Others())
        .def_property_readonly("pid", [](const OwnGuard& guard) { return guard.get().pid(); });
}

}  // namespace

PYBIND11_MODULE(_native, module) {
    module.doc() = "The Entity Interfacer for Python; use axon_entity, which is built on it.";
    py::register_exception<axon::Misconfiguration>(module, "Misconfiguration", PyExc_ValueError);
    py::register_exception<ForkedError>(module, "ForkedError", PyExc_RuntimeError);
    defineTypes(module);
    defineTask(module);
    defineStream(module);
    defineInterfacer(module);
    defineStopActions(module);
    defineGuard(module);
}
