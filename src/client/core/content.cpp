// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/content.hpp"

#include <axon/messages.pb.h>
#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/util/json_util.h>
#include <google/protobuf/wire_format_lite.h>

#include <algorithm>
#include <array>
#include <cstdint>

#include "messages/values.hpp"

namespace axon::client {

std::string toText(const Value& value) {
    return axon::toText(toProto(value));
}

const char* toString(ParameterKind kind) {
    switch (kind) {
        case ParameterKind::Input:
            return "INPUT";
        case ParameterKind::Output:
            return "OUTPUT";
        case ParameterKind::Config:
            return "CONFIG";
        case ParameterKind::Feedback:
            return "FEEDBACK";
    }
    return "?";
}

const char* toString(DataType type) {
    switch (type) {
        case DataType::Unknown:
            return "";
        case DataType::Integer:
            return "INT";
        case DataType::Double:
            return "DBL";
        case DataType::Text:
            return "STR";
        case DataType::Boolean:
            return "BOOL";
    }
    return "?";
}

const char* toString(ServiceKind kind) {
    return kind == ServiceKind::Composite ? "CMPLX" : "SMPL";
}

const char* toString(TaskState state) {
    switch (state) {
        case TaskState::Queued:
            return "QUEUED";
        case TaskState::Dispatched:
            return "DISPATCHED";
        case TaskState::Running:
            return "RUNNING";
        case TaskState::Paused:
            return "PAUSED";
        case TaskState::Succeeded:
            return "SUCCEEDED";
        case TaskState::Failed:
            return "FAILED";
        case TaskState::Stopped:
            return "STOPPED";
        case TaskState::Cancelled:
            return "CANCELLED";
        case TaskState::Refused:
            return "REFUSED";
        case TaskState::Unknown:
            return "UNKNOWN";
    }
    return "UNKNOWN";
}

Value fromProto(const proto::Value& value) {
    switch (value.kind_case()) {
        case proto::Value::kInt:
            return std::int64_t{value.int_()};
        case proto::Value::kDbl:
            return value.dbl();
        case proto::Value::kBool:
            return value.bool_();
        default:
            return value.str();
    }
}

proto::Value toProto(const Value& value) {
    proto::Value out;
    if (const auto* i = std::get_if<std::int64_t>(&value)) out.set_int_(*i);
    if (const auto* d = std::get_if<double>(&value)) out.set_dbl(*d);
    if (const auto* s = std::get_if<std::string>(&value)) out.set_str(*s);
    if (const auto* b = std::get_if<bool>(&value)) out.set_bool_(*b);
    return out;
}

bool parse(google::protobuf::MessageLite& message, std::string_view bytes) {
    return message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()));
}

LeaseNumber fromProto(const proto::Lease& lease) {
    return {static_cast<std::int32_t>(lease.epoch()), static_cast<std::int32_t>(lease.number())};
}

proto::HandOverPolicy toProto(const HandOverPolicy& policy) {
    proto::HandOverPolicy message;
    message.set_answer_within_s(std::clamp(policy.answer_within.count(), 0.0, 600.0));
    message.set_yield(policy.yield && !policy.refuse);
    return message;
}

namespace {

ParameterKind kindFromProto(proto::ParamType type) {
    switch (type) {
        case proto::OUTPUT:
            return ParameterKind::Output;
        case proto::CONFIG:
            return ParameterKind::Config;
        case proto::FEEDBACK:
            return ParameterKind::Feedback;
        default:
            return ParameterKind::Input;
    }
}

DataType dataTypeFromProto(proto::DataType type) {
    switch (type) {
        case proto::INT:
            return DataType::Integer;
        case proto::DBL:
            return DataType::Double;
        case proto::STR:
            return DataType::Text;
        case proto::BOOL:
            return DataType::Boolean;
        default:
            return DataType::Unknown;
    }
}

}  // namespace

Service fromProto(const proto::Service& service) {
    Service out;
    out.name = service.name();
    out.global_id = service.global_id();
    out.kind = service.type() == proto::CMPLX ? ServiceKind::Composite : ServiceKind::Simple;
    out.descr = service.descr();
    out.notes = service.notes();
    out.active = service.is_active();
    out.inactive_reason = service.inactive_reason();
    out.executing = service.is_exec();
    out.blocking = service.is_blocking();
    out.pausable = service.is_pausable();
    for (const auto& meta : service.params()) {
        Parameter& p = out.parameters.emplace_back();
        p.name = meta.name();
        p.kind = kindFromProto(meta.type());
        p.data_type = dataTypeFromProto(meta.data_type());
        p.units = meta.units();
        p.descr = meta.descr();
        p.ready = meta.ready();
        p.required = meta.required();
        p.savable = meta.savable();
        p.multiple = meta.multiple();
        for (const auto& value : meta.initial()) p.values.push_back(fromProto(value));
        for (const auto& value : meta.choices()) p.choices.push_back(fromProto(value));
        if (meta.has_minimum()) p.minimum = meta.minimum();
        if (meta.has_maximum()) p.maximum = meta.maximum();
    }
    for (const auto& resource : service.resources()) {
        Resource& r = out.resources.emplace_back();
        r.name = resource.name();
        r.descr = resource.descr();
        r.ready = resource.ready();
        r.required = resource.required();
        r.savable = resource.savable();
        r.size = resource.size();
    }
    out.missing.assign(service.missing().begin(), service.missing().end());
    out.parts.assign(service.service_list().begin(), service.service_list().end());
    return out;
}

std::optional<EntityState> stateFromProto(proto::EntityState state) {
    if (state < proto::UNAV || state > proto::EntityState_MAX) return std::nullopt;
    return static_cast<EntityState>(static_cast<int>(state) - 1);
}

std::optional<TaskState> taskStateFromProto(proto::TaskState state) {
    if (state < proto::TASK_QUEUED || state > proto::TASK_UNKNOWN) return std::nullopt;
    return static_cast<TaskState>(static_cast<int>(state));
}

Result<std::vector<proto::Param>> toParams(const proto::Service& service,
                                           const std::vector<Argument>& arguments) {
    std::vector<proto::Param> params;
    for (const auto& argument : arguments) {
        const auto index = findParamIndex(service, argument.name);
        if (!index) return index.refusal();
        const auto& meta = service.params(index.value());
        proto::Param param;
        param.set_name(meta.name());
        param.set_units(argument.units);
        const auto* only =
            argument.values.size() == 1 ? std::get_if<std::string>(&argument.values[0]) : nullptr;
        if (argument.from_text && only != nullptr) {
            auto parsed = parseParam(meta, *only);
            if (!parsed) return parsed.refusal();
            param = std::move(parsed).value();
            if (!argument.units.empty()) param.set_units(argument.units);
        } else {
            for (const auto& value : argument.values) {
                const auto* text = argument.from_text ? std::get_if<std::string>(&value) : nullptr;
                if (text == nullptr) {
                    *param.add_values() = toProto(value);
                    continue;
                }
                auto parsed = parseValue(meta, *text);
                if (!parsed) return parsed.refusal();
                *param.add_values() = std::move(parsed).value();
            }
        }
        auto accepted = acceptParam(meta, param);
        if (!accepted) return accepted.refusal();
        params.push_back(std::move(accepted).value());
    }
    return params;
}

std::string rawMessage(std::string_view bytes) {
    using google::protobuf::internal::WireFormatLite;
    using google::protobuf::io::CodedOutputStream;
    constexpr auto kBytes = WireFormatLite::WIRETYPE_LENGTH_DELIMITED;
    const auto tag = [](int field) { return WireFormatLite::MakeTag(field, kBytes); };
    const auto size = static_cast<std::uint32_t>(bytes.size());
    const auto block = tag(proto::ByteStream::kDataFieldNumber);
    const auto inner = CodedOutputStream::VarintSize32(block) + CodedOutputStream::VarintSize32(size) + size;

    std::array<std::uint8_t, 20> before{};  // four numbers of at most five bytes
    auto* end = CodedOutputStream::WriteTagToArray(tag(proto::ToEntity::kRawFieldNumber), before.data());
    end = CodedOutputStream::WriteVarint32ToArray(static_cast<std::uint32_t>(inner), end);
    end = CodedOutputStream::WriteTagToArray(block, end);
    end = CodedOutputStream::WriteVarint32ToArray(size, end);
    std::string message;
    message.reserve(static_cast<std::size_t>(end - before.data()) + bytes.size());
    message.append(reinterpret_cast<const char*>(before.data()),
                   static_cast<std::size_t>(end - before.data()));
    return message.append(bytes);
}

std::string Sample::json() const {
    proto::StreamSample sample;
    if (!sample.ParseFromArray(raw.data(), static_cast<int>(raw.size()))) return "{}";
    google::protobuf::util::JsonPrintOptions options;
    options.preserve_proto_field_names = true;
    options.always_print_primitive_fields = true;
    std::string text;
    if (!google::protobuf::util::MessageToJsonString(sample, &text, options).ok()) return "{}";
    return text;
}

}  // namespace axon::client
