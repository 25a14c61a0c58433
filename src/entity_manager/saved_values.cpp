// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/saved_values.hpp"

#include "common/utf8.hpp"
#include "entity_manager/ports.hpp"
#include "entity_manager/service_profiler.hpp"
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
        values_[{one.service(), one.param().name()}].Swap(one.mutable_param());
}

void SavedValues::set(const std::string& service, const proto::CtrlParam& meta, const proto::Param& param) {
    const Name name{service, meta.name()};
    findings_.erase(name);
    if (!meta.savable()) return;
    auto& value = values_[name];
    value = param;
    value.set_name(meta.name());
    value.set_units(meta.units());  // a profile with other units must not take the number for its own
    keep();
}

Refusal SavedValues::mayKeep(const std::string& service, const proto::Param& param) const {
    auto bytes = service.size() + param.ByteSizeLong();
    for (const auto& [name, value] : values_)
        if (name != Name{service, param.name()})
            bytes += name.first.size() + value.ByteSizeLong() + kOverhead;
    if (bytes + kOverhead <= kBytesMax) return {};
    return {RefusalCode::TooLarge,
            "All saved values of the entity together have at most 1 MiB, and with this one they would have " +
                std::to_string(bytes) + " bytes. Set a shorter one, or upload a file as a resource.",
            {}};
}

std::string SavedValues::restore(ServiceProfiler& profiler) {
    std::string dropped;
    for (auto at = values_.begin(); at != values_.end();) {
        const auto refusal = profiler.restoreParam(at->first.first, at->second);
        if (refusal.ok()) {
            ++at;
            continue;
        }
        const auto& [service, param] = at->first;
        auto message = "the saved value " + shown(at->second) + " of parameter " + inQuotes(param) + " of " +
                       inQuotes(service) + " was dropped: " + refusal.message;
        dropped += (dropped.empty() ? "" : "; ") + message;
        find(at->first, std::move(message),
             refusal.code == RefusalCode::UnknownService || refusal.code == RefusalCode::UnknownParameter
                 ? "nothing, where the profile was meant to lose it; else correct the profile and set it "
                   "again with axon set"
                 : "set it again with axon set");
        at = values_.erase(at);
    }
    if (!dropped.empty()) keep();
    return dropped;
}

std::vector<proto::EntityFinding> SavedValues::findings() const {
    std::vector<proto::EntityFinding> all;
    for (const auto& [name, finding] : findings_) all.push_back(finding);
    return all;
}

void SavedValues::keep() {
    proto::ServiceParams all;
    std::size_t bytes = 0;
    for (const auto& [name, value] : values_) {
        proto::ServiceParam one;
        one.set_service(name.first);
        *one.mutable_param() = value;
        const auto size = one.ByteSizeLong();
        if (bytes + size > kBytesMax) {
            find(
                name,
                "the value of parameter " + inQuotes(name.second) + " of " + inQuotes(name.first) +
                    " is lost when the Entity Manager restarts: all saved values together have at most 1 MiB",
                "upload a file as a resource instead of a long value");
            continue;
        }
        bytes += size;
        all.add_params()->Swap(&one);
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
