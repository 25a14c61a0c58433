// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/services/service_profiler.hpp"

#include <algorithm>

#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

std::size_t place(int position) {
    return static_cast<std::size_t>(position);
}

std::size_t messageBytes(const proto::Param& param) {
    return ServiceProfiler::kFieldHead + param.ByteSizeLong();
}

/// What an application has said, at the end of a sentence of ours.
std::string asSentence(std::string text) {
    if (!text.ends_with('.') && !text.ends_with('!')) text += '.';
    return text;
}

Refusal notSettable(const proto::Service& service, const proto::CtrlParam& meta) {
    return {RefusalCode::WrongType,
            "Parameter " + inQuotes(meta.name()) + " of " + inQuotes(service.name()) + " is " +
                (meta.type() == proto::OUTPUT ? "OUTPUT" : "FEEDBACK") +
                ": the robot tells it. Only INPUT and CONFIG parameters can be set.",
            {}};
}

}  // namespace

std::vector<ResourceQuery> ServiceProfiler::resourcesOf(const proto::ServicesProfile& profile) {
    std::vector<ResourceQuery> all;
    for (const auto& service : profile.services())
        for (const auto& resource : service.resources())
            all.push_back({service.name(), resource.name(), resource.url(), resource.savable()});
    return all;
}

bool ServiceProfiler::hasUrls() const {
    for (const auto& service : declared_.services())
        for (const auto& resource : service.resources())
            if (!resource.url().empty()) return true;
    return false;
}

std::vector<proto::EntityFinding> ServiceProfiler::findings() const {
    std::vector<proto::EntityFinding> all;
    for (const auto& [resource, finding] : findings_) all.push_back(finding);
    return all;
}

/// What lies in its place, and what the profile says of it.
void ServiceProfiler::judge(int service, int resource, const ResourcePlace& place) {
    const auto& declared = declared_.services(service).resources(resource);
    auto& record = *profile_.mutable_services(service)->mutable_resources(resource);
    findings_.erase({service, resource});
    record.set_ready(place.there && (declared.savable() || declared.ready()));
    if (record.ready()) {
        record.set_url(place.path);
        record.set_size(place.size);
        return;
    }
    record.set_url(declared.url());
    if (place.refusal.ok() && !declared.ready()) return;
    auto& finding = findings_[{service, resource}];
    finding.set_message(
        "resource " + inQuotes(declared.name()) + " of " + inQuotes(declared_.services(service).name()) +
        (place.refusal.ok()
             ? " is declared ready, and " +
                   (place.path.empty() ? std::string("nothing has been uploaded for it; it has no url")
                                       : "there is no file " + inQuotes(place.path, 512))
             : " cannot be used: " + place.refusal.message));
    finding.set_fix(place.refusal.ok()
                        ? "put the file there, upload it with axon upload, or correct the services profile"
                        : "correct the services profile, or the robot's machine");
}

void ServiceProfiler::load(proto::ServicesProfile profile, const std::string& entity_id,
                           const std::vector<ResourcePlace>& places) {
    profile_ = std::move(profile);
    declared_ = profile_;
    composites_ = readComposites(profile_);
    stamps_.clear();
    active_.clear();
    around_.assign(place(profile_.services_size()), {});
    findings_.clear();
    auto place_of = places.begin();
    for (int i = 0; i < profile_.services_size(); ++i) {
        auto& service = *profile_.mutable_services(i);
        service.set_entity_id(entity_id);
        service.set_id(i);
        service.set_is_exec(false);
        active_.push_back({service.is_active(), {}});
        for (auto& param : *service.mutable_params()) param.set_ready(param.initial_size() > 0);
        for (int r = 0; r < service.resources_size(); ++r) judge(i, r, *place_of++);
        stamps_.push_back({std::vector<std::uint64_t>(place(service.params_size())),
                           std::vector<std::uint64_t>(place(service.resources_size()))});
    }
    for (int i = 0; i < profile_.services_size(); ++i) showParts(i);
    for (int i = 0; i < profile_.services_size(); ++i) {
        refreshActive(i);
        refreshRecord(i);
    }
}

std::vector<int> ServiceProfiler::relocate(const std::vector<ResourcePlace>& places) {
    std::vector<int> changed;
    auto place_of = places.begin();
    for (int i = 0; i < declared_.services_size(); ++i)
        for (int r = 0; r < ownResources(i); ++r, ++place_of) {
            const auto& declared = declared_.services(i).resources(r);
            if (!declared.savable() || declared.url().empty()) continue;
            auto& resource = *profile_.mutable_services(i)->mutable_resources(r);
            const bool was_ready = resource.ready();
            if (was_ready && place_of->there && resource.size() == place_of->size) continue;
            resource.clear_sha256();
            resource.clear_size();
            judge(i, r, *place_of);
            const bool same = !was_ready && !resource.ready();
            if (!same && (changed.empty() || changed.back() != i)) changed.push_back(i);
        }
    for (const auto service : changed) refresh(service);
    return changed;
}

/// Once: the names of what the parts have, and the flags of the whole.
void ServiceProfiler::showParts(int index) {
    auto& service = *profile_.mutable_services(index);
    if (service.type() != proto::CMPLX) return;
    std::set<int> with;
    for (const auto& part : composites_.parts[place(index)]) with.insert(part.begin() + 1, part.end());
    for (const auto part : with) {
        const auto& declared = declared_.services(part);
        around_[place(part)].push_back(index);
        service.set_is_blocking(service.is_blocking() || declared.is_blocking());
        service.set_is_pausable(service.is_pausable() && declared.is_pausable());
    }
    for (const auto& view : composites_.params[place(index)]) {
        auto& param = *service.add_params();
        param = declared_.services(view.service).params(view.item);
        param.set_name(viewName(declared_, view.service, param.name()));
    }
    for (const auto& view : composites_.resources[place(index)]) {
        auto& resource = *service.add_resources();
        resource = declared_.services(view.service).resources(view.item);
        resource.set_name(viewName(declared_, view.service, resource.name()));
    }
}

/// What of the service has changed is seen in the composites with it too.
void ServiceProfiler::refresh(int service) {
    refreshRecord(service);
    for (const auto composite : compositesWith(service)) refreshRecord(composite);
}

void ServiceProfiler::refreshRecord(int index) {
    auto& service = *profile_.mutable_services(index);
    int at = ownParams(index);
    for (const auto& view : composites_.params[place(index)]) {
        const auto& part = record(view.service).params(view.item);
        auto& param = *service.mutable_params(at++);
        *param.mutable_initial() = part.initial();
        param.set_ready(part.ready());
    }
    at = ownResources(index);
    for (const auto& view : composites_.resources[place(index)]) {
        auto& resource = *service.mutable_resources(at++);
        const auto name = resource.name();
        resource = record(view.service).resources(view.item);
        resource.set_name(name);
    }
    std::vector<Lack> lacks;
    for (const auto& part : composites_.parts[place(index)]) merge(part, {}, lacks);
    service.clear_missing();
    for (const auto& lack : lacks) service.add_missing(lack.name);
}

std::optional<int> ServiceProfiler::inactivePart(int service) const {
    for (const auto& part : composites_.parts[place(service)])
        for (const auto step : part)
            if (!active_[place(step)].on) return step;
    return std::nullopt;
}

void ServiceProfiler::refreshActive(int service) {
    auto& record = *profile_.mutable_services(service);
    const auto& own = active_[place(service)];
    const auto part = inactivePart(service);
    record.set_is_active(own.on && !part);
    record.clear_inactive_reason();
    if (!own.on) {
        record.set_inactive_reason(own.reason);
    } else if (part) {
        const auto& why = active_[place(*part)].reason;
        record.set_inactive_reason("its part " + inQuotes(this->record(*part).name()) + " is switched off" +
                                   (why.empty() ? std::string() : ": " + why));
    }
}

std::optional<int> ServiceProfiler::ownSettable(int service, std::string_view name) const {
    const auto& params = declared_.services(service).params();
    for (int i = 0; i < params.size(); ++i)
        if (params[i].name() == name && isSettable(params[i])) return i;
    return std::nullopt;
}

Result<int> ServiceProfiler::find(std::string_view service) const {
    return findServiceIndex(profile_, service);
}

Composites::View ServiceProfiler::ownerOf(int service, int param) const {
    const int view = param - ownParams(service);
    return view < 0 ? Composites::View{service, param} : composites_.params[place(service)][place(view)];
}

Result<ServiceProfiler::Accepted> ServiceProfiler::accept(int service, const proto::Param& param) const {
    const auto& record = this->record(service);
    const auto at = findParamIndex(record, param.name());
    if (!at) return at.refusal();
    const auto& meta = record.params(at.value());
    if (!isSettable(meta)) return notSettable(record, meta);
    auto value = acceptParam(meta, param);
    if (!value) return value.refusal();
    Accepted accepted{ownerOf(service, at.value()), std::move(value).value()};
    const auto& name = declared_.services(accepted.of.service).params(accepted.of.item).name();
    accepted.param.set_name(name);
    accepted.param.set_units(meta.units());
    for (const auto& way : composites_.parts[place(accepted.of.service)])
        for (std::size_t level = 1; level < way.size(); ++level) {
            const auto fed = ownSettable(way[level], name);
            if (!fed) continue;
            auto refusal = axon::checkParam(declared_.services(way[level]).params(*fed), accepted.param);
            if (refusal.ok()) continue;
            refusal.message =
                "For its part " + inQuotes(this->record(way[level]).name()) + ": " + refusal.message;
            return refusal;
        }
    return accepted;
}

Result<std::pair<int, proto::Param>> ServiceProfiler::checkParam(std::string_view service,
                                                                 const proto::Param& param) const {
    const auto index = find(service);
    if (!index) return index.refusal();
    auto accepted = accept(index.value(), param);
    if (!accepted) return accepted.refusal();
    return std::pair{accepted->of.service, std::move(accepted->param)};
}

void ServiceProfiler::storeParam(int service, const proto::Param& param) {
    const auto at = findParamIndex(record(service), param.name());
    if (!at) return;
    auto& meta = *profile_.mutable_services(service)->mutable_params(at.value());
    *meta.mutable_initial() = param.values();
    meta.set_ready(true);
    stamps_[place(service)].params[place(at.value())] = ++clock_;
    refresh(service);
}

bool ServiceProfiler::isConfig(int service, std::string_view param) const {
    const auto own = ownSettable(service, param);
    return own && declared_.services(service).params(*own).type() == proto::CONFIG;
}

std::vector<proto::ServiceParam> ServiceProfiler::configuration() const {
    std::vector<proto::ServiceParam> all;
    for (int i = 0; i < declared_.services_size(); ++i)
        for (int p = 0; p < ownParams(i); ++p) {
            const auto& meta = record(i).params(p);
            if (meta.type() != proto::CONFIG || !meta.ready()) continue;
            auto& one = all.emplace_back();
            one.set_service(record(i).name());
            one.mutable_param()->set_name(meta.name());
            one.mutable_param()->set_units(meta.units());
            *one.mutable_param()->mutable_values() = meta.initial();
        }
    return all;
}

std::optional<ServiceProfiler::Slot> ServiceProfiler::slotOf(const Order& order, int service,
                                                             const std::string& param) const {
    const auto at = std::find(order.way.begin(), order.way.end(), service);
    if (at == order.way.end() || !isConfig(order.service, param)) return std::nullopt;
    const auto level = static_cast<std::size_t>(at - order.way.begin());
    const auto has = std::find_if(order.params.begin(), order.params.end(),
                                  [&](const auto& one) { return one.param.name() == param; });
    if (has != order.params.end() && has->level < level) return std::nullopt;
    return Slot{static_cast<std::size_t>(has - order.params.begin()), level};
}

bool ServiceProfiler::reconfigure(Plan& plan, std::size_t from, int service,
                                  const proto::Param& param) const {
    bool taken = false;
    for (auto part = from; part < plan.parts.size(); ++part) {
        auto& order = plan.parts[part];
        const auto slot = slotOf(order, service, param.name());
        if (!slot) continue;
        if (slot->at == order.params.size()) order.params.emplace_back();
        order.params[slot->at] = {param, slot->level};
        taken = taken || part == from;
    }
    // Of what was given with the task the application is asked when it begins.
    for (auto& [whose, given] : plan.given)
        if (whose == service && given.name() == param.name() && given.values_size() > 0)
            *given.mutable_values() = param.values();
    return taken;
}

std::size_t ServiceProfiler::bytesOf(const Plan& plan, std::size_t from) {
    std::size_t bytes = 0;
    for (auto part = from; part < plan.parts.size(); ++part)
        for (const auto& [param, level] : plan.parts[part].params) bytes += messageBytes(param);
    if (from > 0) return bytes;
    for (const auto& [service, param] : plan.given) bytes += messageBytes(param);
    return bytes;
}

std::ptrdiff_t ServiceProfiler::growth(const Plan& plan, std::size_t from, int service,
                                       const proto::Param& param) const {
    const auto bytes = static_cast<std::ptrdiff_t>(messageBytes(param));
    std::ptrdiff_t more = 0;
    for (auto part = from; part < plan.parts.size(); ++part) {
        const auto& order = plan.parts[part];
        const auto slot = slotOf(order, service, param.name());
        if (!slot) continue;
        more += bytes;
        if (slot->at < order.params.size())
            more -= static_cast<std::ptrdiff_t>(messageBytes(order.params[slot->at].param));
    }
    if (from > 0) return more;
    for (const auto& [whose, given] : plan.given)
        if (whose == service && given.name() == param.name() && given.values_size() > 0)
            more += bytes - static_cast<std::ptrdiff_t>(messageBytes(given));
    return more;
}

Refusal ServiceProfiler::restoreParam(const std::string& service, const proto::Param& param) {
    // By exact names: what differs in upper and lower case may mean something else.
    const auto& services = declared_.services();
    const auto at = std::find_if(services.begin(), services.end(),
                                 [&](const auto& one) { return one.name() == service; });
    if (at == services.end())
        return {RefusalCode::UnknownService, "the profile no longer has this service", {}};
    const auto& params = at->params();
    const auto meta = std::find_if(params.begin(), params.end(),
                                   [&](const auto& one) { return one.name() == param.name(); });
    if (meta == params.end())
        return {RefusalCode::UnknownParameter, "the profile no longer has this parameter", {}};
    if (!meta->savable()) return {RefusalCode::WrongType, "the profile no longer declares it savable", {}};
    auto checked = checkParam(service, param);
    if (!checked) return checked.refusal();
    storeParam(checked->first, checked->second);
    return {};
}

Result<std::pair<int, int>> ServiceProfiler::findResource(std::string_view service,
                                                          std::string_view resource) const {
    const auto index = find(service);
    if (!index) return index.refusal();
    const auto at = findResourceIndex(record(index.value()), resource);
    if (!at) return at.refusal();
    if (const int view = at.value() - ownResources(index.value()); view >= 0) {
        const auto& part = composites_.resources[place(index.value())][place(view)];
        return std::pair{part.service, part.item};
    }
    return std::pair{index.value(), at.value()};
}

void ServiceProfiler::storeResource(int service, int resource, std::string path, std::string sha256,
                                    std::uint64_t size) {
    auto& record = *profile_.mutable_services(service)->mutable_resources(resource);
    record.set_url(std::move(path));
    record.set_sha256(std::move(sha256));
    record.set_size(size);
    record.set_ready(true);
    findings_.erase({service, resource});
    stamps_[place(service)].resources[place(resource)] = ++clock_;
    refresh(service);
}

bool ServiceProfiler::loseResource(int service, std::string_view resource, std::string_view path) {
    for (auto& record : *profile_.mutable_services(service)->mutable_resources()) {
        if (record.name() != resource || !record.ready() || record.url() != path) continue;
        record.set_ready(false);
        record.clear_sha256();
        record.clear_size();
        refresh(service);
        return true;
    }
    return false;
}

const ServiceProfiler::Values* ServiceProfiler::valuesOf(int service, int param, const Given& given) const {
    if (const auto at = given.find({service, param}); at != given.end()) return &at->second.values();
    const auto& meta = record(service).params(param);
    return meta.ready() ? &meta.initial() : nullptr;
}

/// Of the outermost composite around it that declares a parameter of the name and has a value for it, else
/// its own.
ServiceProfiler::Source ServiceProfiler::valuesOf(const Composites::Part& way, std::size_t level, int param,
                                                  const Given& given) const {
    const auto& name = declared_.services(way[level]).params(param).name();
    for (std::size_t around = 0; around < level; ++around)
        if (const auto own = ownSettable(way[around], name))
            if (const auto* values = valuesOf(way[around], *own, given)) return {values, around};
    return {valuesOf(way[level], param, given), level};
}

/// Under which name a client of the service at the beginning of the way sets it.
std::string ServiceProfiler::nameIn(const Composites::Part& way, std::size_t level,
                                    const std::string& name) const {
    std::size_t owner = 0;
    while (owner < level && !ownSettable(way[owner], name)) ++owner;
    return owner == 0 ? name : viewName(declared_, way[owner], name);
}

/// What the service at the end of the way is given, and what it and the composites around it lack.
ServiceProfiler::Order ServiceProfiler::merge(const Composites::Part& way, const Given& given,
                                              std::vector<Lack>& lacks) const {
    const auto lack = [&lacks](const char* kind, std::string name) {
        Lack found{kind, std::move(name)};
        if (std::find(lacks.begin(), lacks.end(), found) == lacks.end()) lacks.push_back(std::move(found));
    };
    Order order;
    order.service = way.back();
    order.way = way;
    for (std::size_t level = 0; level < way.size(); ++level) {
        const auto& service = record(way[level]);
        const bool simple = level + 1 == way.size();
        for (int i = 0; i < ownParams(way[level]); ++i) {
            const auto& meta = service.params(i);
            if (!isSettable(meta)) continue;
            if (const auto source = valuesOf(way, level, i, given); source.values != nullptr) {
                if (!simple) continue;
                auto& [param, whose] = order.params.emplace_back();
                param.set_name(meta.name());
                param.set_units(meta.units());
                *param.mutable_values() = *source.values;
                whose = source.level;
            } else if (meta.required()) {
                lack("parameter", nameIn(way, level, meta.name()));
            }
        }
        for (int i = 0; i < ownResources(way[level]); ++i) {
            const auto& resource = service.resources(i);
            if (resource.ready() && simple)
                order.resources.push_back(resource);
            else if (resource.required() && !resource.ready())
                lack("resource",
                     level == 0 ? resource.name() : viewName(declared_, way[level], resource.name()));
        }
    }
    return order;
}

std::set<std::pair<int, int>> ServiceProfiler::unusedBy(const std::vector<Composites::Part>& parts,
                                                        const Given& given) const {
    std::set<std::pair<int, int>> unused;
    std::set<std::pair<int, int>> used;
    for (const auto& way : parts) {
        for (std::size_t level = 0; level < way.size(); ++level) {
            for (int i = 0; i < ownParams(way[level]); ++i) {
                const bool own = valuesOf(way, level, i, given).values == valuesOf(way[level], i, given);
                (own ? used : unused).emplace(way[level], i);
            }
        }
    }
    for (const auto& param : used) unused.erase(param);
    return unused;
}

bool ServiceProfiler::shareParts(int one, int other) const {
    const auto& parts = composites_.parts[place(one)];
    const auto& others = composites_.parts[place(other)];
    return std::any_of(parts.begin(), parts.end(), [&](const auto& part) {
        return std::any_of(others.begin(), others.end(),
                           [&](const auto& beside) { return part.back() == beside.back(); });
    });
}

Result<ServiceProfiler::Plan> ServiceProfiler::prepare(std::string_view service, const Params& given,
                                                       const std::vector<std::string>& later) const {
    const auto index = find(service);
    if (!index) return index.refusal();
    const auto& record = this->record(index.value());
    const auto off = [&](int which) {
        const auto& why = active_[place(which)].reason;
        return inQuotes(this->record(which).name()) + " is switched off by the robot application" +
               (why.empty() ? std::string(" at present.") : ": " + asSentence(why));
    };
    if (!active_[place(index.value())].on)
        return Refusal{RefusalCode::InactiveService, "Service " + off(index.value()), {}};
    if (const auto part = inactivePart(index.value()))
        return Refusal{RefusalCode::InactiveService,
                       "Service " + inQuotes(record.name()) + " cannot run: its part " + off(*part),
                       {}};
    const auto& parts = composites_.parts[place(index.value())];
    if (parts.empty())
        return Refusal{
            RefusalCode::NotSupported,
            "Service " + inQuotes(record.name()) +
                " is composite and lists no service that could run. Its profile needs a <Services> list.",
            {}};
    Plan plan;
    plan.service = index.value();
    plan.composite = record.type() == proto::CMPLX;
    plan.stamp = clock_;
    Given accepted;
    for (const auto& param : given) {
        auto value = accept(index.value(), param);
        if (!value) return value.refusal();
        auto& asked = plan.given.emplace_back(value->of.service, proto::Param{}).second;
        asked.set_name(value->param.name());
        if (plan.composite) asked = value->param;  // a simple service's are in its order
        if (!accepted.emplace(std::pair{value->of.service, value->of.item}, std::move(value->param)).second)
            return Refusal{
                RefusalCode::Malformed, "Parameter " + inQuotes(param.name()) + " is given twice.", {}};
    }
    for (const auto& name : later)
        if (const auto at = findParamIndex(record, name)) {
            const auto of = ownerOf(index.value(), at.value());
            accepted.try_emplace({of.service, of.item});
        }
    std::vector<Lack> lacks;
    plan.parts.reserve(parts.size());
    for (const auto& part : parts) plan.parts.push_back(merge(part, accepted, lacks));
    if (plan.composite) plan.unused = unusedBy(parts, accepted);
    if (lacks.empty()) return plan;
    std::string missing;
    for (const auto& lack : lacks)
        missing += (missing.empty() ? "" : ", ") + std::string(lack.kind) + ' ' + inQuotes(lack.name);
    return Refusal{RefusalCode::MissingDependency,
                   "Service " + inQuotes(record.name()) + " still needs: " + missing +
                       ". Give the parameters with the task or set them first, and upload the resources.",
                   {}};
}

Result<ServiceProfiler::Params> ServiceProfiler::typed(std::string_view service, const Params& given,
                                                       const std::vector<std::string>& told) const {
    const auto index = find(service);
    if (!index) return index.refusal();
    const auto& record = this->record(index.value());
    Params all = given;
    for (auto& param : all) {
        const auto at = findParamIndex(record, param.name());
        if (!at) continue;  // prepare() says so
        const auto& meta = record.params(at.value());
        const bool text = param.values_size() == 1 && param.values(0).kind_case() == proto::Value::kStr;
        const bool whole =
            !meta.multiple() || std::find(told.begin(), told.end(), param.name()) != told.end();
        if (!text || (meta.data_type() == proto::STR && whole)) continue;
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
        else if (!isSettable(record.params(at.value())))
            all.push_back(notSettable(record, record.params(at.value())));
        else
            awaited.push_back(record.params(at.value()).name());
    }
    for (const auto& name : wanted) {
        const auto at = findParamIndex(record, name);
        if (!at)
            all.push_back({at.refusal().code, at.refusal().message + "; a later step is to take it", {}});
        else if (isSettable(record.params(at.value())))
            all.push_back({RefusalCode::WrongType,
                           "A later step takes " + inQuotes(name) + " of " + inQuotes(record.name()) +
                               ", which is set and not told by the robot. Name an OUTPUT parameter.",
                           {}});
    }
    if (auto plan = prepare(service, good, awaited); !plan) all.push_back(plan.refusal());
    return all;
}

Result<int> ServiceProfiler::setActive(std::string_view service, bool active, std::string reason) {
    const auto index = find(service);
    if (!index) return index;
    active_[place(index.value())] = {active, active ? std::string() : std::move(reason)};
    refreshActive(index.value());
    for (const auto composite : compositesWith(index.value())) refreshActive(composite);
    return index;
}

void ServiceProfiler::setExecuting(int service, bool executing) {
    profile_.mutable_services(service)->set_is_exec(executing);
}

ServiceProfiler::Cleared ServiceProfiler::clearAfterTask(const Plan& plan) {
    Cleared cleared;
    std::set<int> services;
    for (const auto& part : plan.parts) services.insert(part.way.begin(), part.way.end());
    for (const auto service : services) clear(service, plan, cleared);
    return cleared;
}

void ServiceProfiler::clear(int index, const Plan& plan, Cleared& cleared) {
    auto& service = *profile_.mutable_services(index);
    const auto& stamps = stamps_[place(index)];
    bool changed = false;
    for (int i = 0; i < ownParams(index); ++i) {
        auto& param = *service.mutable_params(i);
        if (param.savable() || !isSettable(param) || !param.ready() || stamps.params[place(i)] > plan.stamp)
            continue;
        if (plan.unused.contains({index, i})) continue;
        *param.mutable_initial() = declared_.services(index).params(i).initial();
        param.set_ready(param.initial_size() > 0);
        changed = true;
    }
    for (int i = 0; i < ownResources(index); ++i) {
        auto& resource = *service.mutable_resources(i);
        const auto stamp = stamps.resources[place(i)];
        // Stamp 0: it was never uploaded; a file that the robot's owner has put there is not ours to delete.
        if (resource.savable() || !resource.ready() || stamp > plan.stamp) continue;
        resource.set_ready(false);
        changed = true;
        if (stamp == 0) continue;
        resource.clear_url();
        cleared.files.emplace_back(index, resource.name());
    }
    if (!changed) return;
    cleared.changed.push_back(index);
    refresh(index);
}

}  // namespace axon::entity_manager
