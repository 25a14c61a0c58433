// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/service_profiler.hpp"

#include "entity_manager/ports.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

bool settable(const proto::CtrlParam& meta) {
    return meta.type() == proto::INPUT || meta.type() == proto::CONFIG;
}

Refusal notSettable(const proto::Service& service, const proto::CtrlParam& meta) {
    return {RefusalCode::WrongType,
            "Parameter " + inQuotes(meta.name()) + " of " + inQuotes(service.name()) + " is " +
                (meta.type() == proto::OUTPUT ? "OUTPUT" : "FEEDBACK") +
                ": the robot tells it. Only INPUT and CONFIG parameters can be set.",
            {}};
}

}  // namespace

void ServiceProfiler::load(proto::ServicesProfile profile, const std::string& entity_id,
                           ResourceStore& store) {
    profile_ = std::move(profile);
    declared_ = profile_;
    stamps_.clear();
    for (int i = 0; i < profile_.services_size(); ++i) {
        auto& service = *profile_.mutable_services(i);
        service.set_entity_id(entity_id);
        service.set_id(i);
        service.set_is_exec(false);
        for (auto& param : *service.mutable_params()) param.set_ready(param.initial_size() > 0);
        for (auto& resource : *service.mutable_resources()) {
            if (!resource.savable()) continue;
            if (auto path = store.find(service.name(), resource.name())) {
                resource.set_url(*path);
                resource.set_ready(true);
            }
        }
        stamps_.push_back({std::vector<std::uint64_t>(static_cast<std::size_t>(service.params_size())),
                           std::vector<std::uint64_t>(static_cast<std::size_t>(service.resources_size()))});
        refreshMissing(i);
    }
}

void ServiceProfiler::refreshMissing(int index) {
    auto& service = *profile_.mutable_services(index);
    service.clear_missing();
    for (const auto& param : service.params())
        if (param.required() && settable(param) && !param.ready()) service.add_missing(param.name());
    for (const auto& resource : service.resources())
        if (resource.required() && !resource.ready()) service.add_missing(resource.name());
}

Result<int> ServiceProfiler::find(std::string_view service) const {
    return findServiceIndex(profile_, service);
}

Result<std::pair<int, proto::Param>> ServiceProfiler::checkParam(std::string_view service,
                                                                 const proto::Param& param) const {
    const auto index = find(service);
    if (!index) return index.refusal();
    const auto& record = this->record(index.value());
    const auto at = findParamIndex(record, param.name());
    if (!at) return at.refusal();
    const auto& meta = record.params(at.value());
    if (!settable(meta)) return notSettable(record, meta);
    auto accepted = acceptParam(meta, param);
    if (!accepted) return accepted.refusal();
    return std::pair{index.value(), std::move(accepted).value()};
}

void ServiceProfiler::storeParam(int service, const proto::Param& param) {
    const auto at = findParamIndex(record(service), param.name());
    if (!at) return;
    auto& meta = *profile_.mutable_services(service)->mutable_params(at.value());
    *meta.mutable_initial() = param.values();
    meta.set_ready(true);
    stamps_[static_cast<std::size_t>(service)].params[static_cast<std::size_t>(at.value())] = ++clock_;
    refreshMissing(service);
}

Result<std::pair<int, int>> ServiceProfiler::findResource(std::string_view service,
                                                          std::string_view resource) const {
    const auto index = find(service);
    if (!index) return index.refusal();
    const auto at = findResourceIndex(record(index.value()), resource);
    if (!at) return at.refusal();
    return std::pair{index.value(), at.value()};
}

void ServiceProfiler::storeResource(int service, int resource, std::string path, std::string sha256,
                                    std::uint64_t size) {
    auto& record = *profile_.mutable_services(service)->mutable_resources(resource);
    record.set_url(std::move(path));
    record.set_sha256(std::move(sha256));
    record.set_size(size);
    record.set_ready(true);
    stamps_[static_cast<std::size_t>(service)].resources[static_cast<std::size_t>(resource)] = ++clock_;
    refreshMissing(service);
}

Result<ServiceProfiler::Order> ServiceProfiler::prepare(std::string_view service, const Params& given,
                                                        const std::vector<std::string>& later) const {
    const auto index = find(service);
    if (!index) return index.refusal();
    const auto& record = this->record(index.value());
    if (!record.is_active())
        return Refusal{
            RefusalCode::InactiveService,
            "Service " + inQuotes(record.name()) + " is switched off by the robot application at present.",
            {}};
    if (record.type() == proto::CMPLX)
        return Refusal{RefusalCode::NotSupported,
                       "Service " + inQuotes(record.name()) +
                           " is composite (CMPLX), which this version cannot run. Run its parts one by one.",
                       {}};
    Order order;
    order.service = index.value();
    order.stamp = clock_;
    std::vector<const proto::Param*> own(static_cast<std::size_t>(record.params_size()), nullptr);
    std::vector<proto::Param> accepted;
    accepted.reserve(static_cast<std::size_t>(given.size()));
    for (const auto& param : given) {
        const auto at = findParamIndex(record, param.name());
        if (!at) return at.refusal();
        const auto& meta = record.params(at.value());
        if (!settable(meta)) return notSettable(record, meta);
        auto value = acceptParam(meta, param);
        if (!value) return value.refusal();
        auto*& slot = own[static_cast<std::size_t>(at.value())];
        if (slot != nullptr)
            return Refusal{
                RefusalCode::Malformed, "Parameter " + inQuotes(meta.name()) + " is given twice.", {}};
        accepted.push_back(std::move(value).value());
        slot = &accepted.back();
    }
    std::string missing;
    const auto lack = [&missing](const std::string& what, const std::string& name) {
        missing += (missing.empty() ? "" : ", ") + what + " " + inQuotes(name);
    };
    for (int i = 0; i < record.params_size(); ++i) {
        const auto& meta = record.params(i);
        if (!settable(meta)) continue;
        if (const auto* param = own[static_cast<std::size_t>(i)]) {
            order.params.push_back(*param);
        } else if (meta.ready()) {
            auto& stored = order.params.emplace_back();
            stored.set_name(meta.name());
            stored.set_units(meta.units());
            *stored.mutable_values() = meta.initial();
        } else if (meta.required() && std::find(later.begin(), later.end(), meta.name()) == later.end()) {
            lack("parameter", meta.name());
        }
    }
    for (const auto& resource : record.resources()) {
        if (resource.ready())
            order.resources.push_back(resource);
        else if (resource.required())
            lack("resource", resource.name());
    }
    if (!missing.empty())
        return Refusal{RefusalCode::MissingDependency,
                       "Service " + inQuotes(record.name()) + " still needs: " + missing +
                           ". Give the parameters with the task or set them first, and upload the resources.",
                       {}};
    return order;
}

Result<ServiceProfiler::Params> ServiceProfiler::typed(std::string_view service, const Params& given) const {
    const auto index = find(service);
    if (!index) return index.refusal();
    const auto& record = this->record(index.value());
    Params all = given;
    for (auto& param : all) {
        const auto at = findParamIndex(record, param.name());
        if (!at) continue;  // prepare() says so
        const auto& meta = record.params(at.value());
        const bool text = param.values_size() == 1 && param.values(0).kind_case() == proto::Value::kStr;
        if (!text || (meta.data_type() == proto::STR && !meta.multiple())) continue;
        auto read = parseParam(meta, param.values(0).str());
        if (!read) return read.refusal();
        const auto name = param.name();
        param = std::move(read).value();
        param.set_name(name);
    }
    return all;
}

std::vector<Refusal> ServiceProfiler::problems(std::string_view service, const Params& given,
                                               const std::vector<std::string>& later,
                                               const std::vector<std::string>& wanted) const {
    const auto index = find(service);
    if (!index) return {index.refusal()};
    std::vector<Refusal> all;
    Params good;
    std::vector<std::string> awaited;
    const auto& record = this->record(index.value());
    for (const auto& param : given) {
        Params one;
        *one.Add() = param;
        auto read = typed(service, one);
        if (!read)
            all.push_back(read.refusal());
        else if (const auto checked = checkParam(service, read.value().Get(0)); !checked)
            all.push_back(checked.refusal());
        else
            good.Add()->Swap(&*read.value().begin());
        awaited.push_back(param.name());  // given, if wrongly: not missing
    }
    for (const auto& name : later) {
        const auto at = findParamIndex(record, name);
        if (!at)
            all.push_back(at.refusal());
        else if (!settable(record.params(at.value())))
            all.push_back(notSettable(record, record.params(at.value())));
        else
            awaited.push_back(record.params(at.value()).name());
    }
    for (const auto& name : wanted) {
        const auto at = findParamIndex(record, name);
        if (!at)
            all.push_back({at.refusal().code, "A later step takes its result " + inQuotes(name) + ". " + at.refusal().message, {}});
        else if (settable(record.params(at.value())))
            all.push_back({RefusalCode::WrongType,
                           "A later step takes " + inQuotes(name) + " of " + inQuotes(record.name()) +
                               ", which is set and not told by the robot. Name an OUTPUT parameter.",
                           {}});
    }
    if (auto order = prepare(service, good, awaited); !order) all.push_back(order.refusal());
    return all;
}

Result<int> ServiceProfiler::setActive(std::string_view service, bool active) {
    const auto index = find(service);
    if (index) profile_.mutable_services(index.value())->set_is_active(active);
    return index;
}

void ServiceProfiler::setExecuting(int service, bool executing) {
    profile_.mutable_services(service)->set_is_exec(executing);
}

ServiceProfiler::Cleared ServiceProfiler::clearAfterTask(const Order& order) {
    Cleared cleared;
    auto& service = *profile_.mutable_services(order.service);
    const auto& stamps = stamps_[static_cast<std::size_t>(order.service)];
    for (int i = 0; i < service.params_size(); ++i) {
        auto& param = *service.mutable_params(i);
        if (param.savable() || !settable(param) || !param.ready() ||
            stamps.params[static_cast<std::size_t>(i)] > order.stamp)
            continue;
        *param.mutable_initial() = declared_.services(order.service).params(i).initial();
        param.set_ready(param.initial_size() > 0);
        cleared.changed = true;
    }
    for (int i = 0; i < service.resources_size(); ++i) {
        auto& resource = *service.mutable_resources(i);
        const auto stamp = stamps.resources[static_cast<std::size_t>(i)];
        // Stamp 0: it was never uploaded; a file that the robot's owner has put there is not ours to delete.
        if (resource.savable() || !resource.ready() || stamp > order.stamp) continue;
        resource.set_ready(false);
        cleared.changed = true;
        if (stamp == 0) continue;
        resource.clear_url();
        cleared.files.push_back(resource.name());
    }
    refreshMissing(order.service);
    return cleared;
}

}  // namespace axon::entity_manager
