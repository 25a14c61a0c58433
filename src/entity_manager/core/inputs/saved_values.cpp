// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/inputs/saved_values.hpp"

#include "common/utf8.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/ports/ports.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

constexpr const char* kKey = "values";
constexpr std::size_t kShown = 100;
constexpr std::size_t kOverhead = 16;  ///< of an entry, at most: tags and lengths

/// `5000 mm`, `left, right`; the beginning of a long one.
std::string shown(const proto::Param& param) {
    std::string text;
    for (const auto& value : param.values()) text += (text.empty() ? "" : ", ") + toText(value);
    if (text.size() > kShown) text = std::string(cutUtf8(text, kShown)) + "…";
    if (!param.units().empty()) text += ' ' + param.units();
    return text;
}

}  // namespace

SavedValues::SavedValues(Storage& storage) : storage_(storage) {
    const auto stored = storage.load(kKey);
    if (!stored) return;
    proto::ServiceParams all;
    if (!all.ParseFromString(*stored)) {
        find({},
             "the saved values of its parameters could not be read and were dropped: the file in its state "
             "folder is damaged",
             "set them again with axon set");
        return;
    }
    for (auto& one : *all.mutable_params())
        values_[{one.service(), one.param().name()}].param.Swap(one.mutable_param());
}

void SavedValues::set(const std::string& service, const proto::CtrlParam& meta, const proto::Param& param) {
    const Name name{service, meta.name()};
    findings_.erase(name);
    if (!meta.savable()) return;
    auto& value = values_[name];
    value = {param, meta.type() == proto::CONFIG};
    value.param.set_name(meta.name());
    value.param.set_units(meta.units());  // a profile with other units must not take the number for its own
    keep();
}

Refusal SavedValues::mayKeepConfig(const std::string& service, const proto::Param& param) const {
    auto bytes = bytesOf(service, param);
    for (const auto& [name, value] : values_)
        if (value.config && name != Name{service, param.name()}) bytes += bytesOf(name.first, value.param);
    if (bytes <= kBytesMax) return {};
    return {
        RefusalCode::TooLarge,
        "All CONFIG values of the entity together have at most 1 MiB, and with this one they would have " +
            std::to_string(bytes) + " bytes. Set a shorter one, or upload a file as a resource.",
        {}};
}

std::string SavedValues::restore(ServiceProfiler& profiler) {
    std::string dropped;
    for (auto at = values_.begin(); at != values_.end();) {
        const auto& [service, param] = at->first;
        const auto refusal = profiler.restoreParam(service, at->second.param);
        if (refusal.ok()) {
            at->second.config = profiler.isConfig(profiler.find(service).value(), param);
            ++at;
            continue;
        }
        auto message = "the saved value " + shown(at->second.param) + " of parameter " + inQuotes(param) +
                       " of " + inQuotes(service) + " was dropped: " + refusal.message;
        dropped += (dropped.empty() ? "" : "; ") + message;
        find(at->first, std::move(message),
             refusal.code == RefusalCode::UnknownService || refusal.code == RefusalCode::UnknownParameter
                 ? "nothing, where the profile was meant to lose it; else correct the profile and set it "
                   "again with axon set"
                 : "set it again with axon set");
        at = values_.erase(at);
    }
    if (!dropped.empty() || !all_kept_) keep();  // which have room may be others now
    return dropped;
}

std::vector<proto::EntityFinding> SavedValues::findings() const {
    std::vector<proto::EntityFinding> all;
    for (const auto& [name, finding] : findings_) all.push_back(finding);
    return all;
}

std::size_t SavedValues::bytesOf(const std::string& service, const proto::Param& param) {
    return service.size() + param.ByteSizeLong() + kOverhead;
}

void SavedValues::keep() {
    proto::ServiceParams all;
    std::size_t bytes = 0;
    all_kept_ = true;
    for (const bool config : {true, false})
        for (const auto& [name, value] : values_) {
            if (value.config != config) continue;
            const auto size = bytesOf(name.first, value.param);
            if (bytes + size > kBytesMax) {
                all_kept_ = false;
                find(name,
                     "the value of parameter " + inQuotes(name.second) + " of " + inQuotes(name.first) +
                         " is lost when the Entity Manager restarts: all saved values together have at most "
                         "1 MiB, and CONFIG values come first",
                     "upload a file as a resource instead of a long value");
                continue;
            }
            bytes += size;
            findings_.erase(name);
            auto& one = *all.add_params();
            one.set_service(name.first);
            *one.mutable_param() = value.param;
        }
    storage_.keep(kKey, all.SerializeAsString());
}

void SavedValues::find(const Name& name, std::string message, std::string fix) {
    if (findings_.size() >= kFindings && !findings_.contains(name)) return;
    auto& finding = findings_[name];
    finding.set_message(std::move(message));
    finding.set_fix(std::move(fix));
}

}  // namespace axon::entity_manager
