// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/refusals_log.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdint>
#include <exception>
#include <string_view>
#include <utility>

#include "audit/trail.hpp"
#include "common/release.hpp"

namespace axon::router_guard {
namespace {

constexpr const char* kFolder = "Axon.Audit.Folder";
constexpr const char* kName = "Axon.Audit.Name";
constexpr const char* kSize = "Axon.Audit.Size";
constexpr const char* kFiles = "Axon.Audit.Files";
constexpr const char* kTraces = "Ice.Trace.Network";
constexpr int kNeededTraces = 2;

[[noreturn]] void refuseToStart(const std::string& why) {
    throw Ice::PluginInitializationException(__FILE__, __LINE__, why);
}

/// As axon-server takes them. 0 where the key is not set.
std::int64_t number(const Ice::PropertiesPtr& properties, const char* key, std::int64_t least,
                    std::int64_t most) {
    const auto text = properties->getProperty(key);
    if (text.empty()) return 0;
    std::int64_t value = 0;
    const auto* const end = text.data() + text.size();
    const auto [read, error] = std::from_chars(text.data(), end, value);
    if (error != std::errc{} || read != end || value < least || value > most)
        refuseToStart(std::string(key) + "=" + text + ": expected a number from " + std::to_string(least) +
                      " to " + std::to_string(most) + "; fix: correct or remove the key");
    return value;
}

/// Ice does not know these keys, and so does not warn about one that is misspelt.
void refuseUnknown(const Ice::PropertiesPtr& properties) {
    constexpr std::array<std::string_view, 4> kKnown{kFolder, kName, kSize, kFiles};
    for (const auto& [key, value] : properties->getPropertiesForPrefix("Axon.Audit."))
        if (std::find(kKnown.begin(), kKnown.end(), key) == kKnown.end())
            refuseToStart("there is no key " + key + "; expected " + kFolder + ", " + kName + ", " + kSize +
                          " or " + kFiles + "; fix: correct or remove the key");
}

/// The name of the program's trail in a folder that others may use, too.
std::string trailNameOf(const Ice::PropertiesPtr& properties) {
    const auto program = properties->getProperty("Ice.ProgramName");
    const auto name = properties->getPropertyWithDefault(kName, program.substr(program.rfind('/') + 1));
    return name.empty() ? "ice" : name;
}

std::unique_ptr<audit::AuditTrail> trailOf(const Ice::PropertiesPtr& properties, const Refusals::Say& say) {
    audit::TrailSettings settings;
    settings.folder = properties->getProperty(kFolder);
    using Bounds = audit::Files::Bounds;
    if (const auto bytes = number(properties, kSize, Bounds::kBytesLeast, Bounds::kBytesMost))
        settings.files.bytes = static_cast<std::uint64_t>(bytes);
    if (const auto files = number(properties, kFiles, Bounds::kFilesLeast, Bounds::kFilesMost))
        settings.files.files = static_cast<int>(files);
    if (settings.folder.empty()) return nullptr;
    const auto name = trailNameOf(properties);
    try {
        return std::make_unique<audit::Trail>(settings, name, name + " with axon " + kRelease, say);
    } catch (const std::exception& error) {
        refuseToStart(error.what());
    }
}

/// `set`: what needs the traces.
std::string tracesMissing(const std::string& set) {
    return set + " is set, but not " + kTraces + "=" + std::to_string(kNeededTraces) +
           ", without which Ice tells nobody whom it refuses; fix: add that line, which fills no log";
}

const Clock& steadyClock() {
    static const SteadyClock clock;
    return clock;
}

}  // namespace

RefusalsLog::RefusalsLog(Ice::LoggerPtr before, std::shared_ptr<Refusals> refusals, bool pass_on)
    : before_(std::move(before)), refusals_(std::move(refusals)), pass_on_(pass_on) {}

void RefusalsLog::print(const std::string& message) {
    before_->print(message);
}

void RefusalsLog::trace(const std::string& category, const std::string& message) {
    const bool network = category == "Network";
    if (!network || pass_on_) before_->trace(category, message);
    if (network) refusals_->onTrace(message);
}

void RefusalsLog::warning(const std::string& message) {
    before_->warning(message);
}

void RefusalsLog::error(const std::string& message) {
    before_->error(message);
}

std::string RefusalsLog::getPrefix() {
    return before_->getPrefix();
}

Ice::LoggerPtr RefusalsLog::cloneWithPrefix(const std::string& prefix) {
    return new RefusalsLog(before_->cloneWithPrefix(prefix), refusals_, pass_on_);
}

WatchedProgram watchRefusals(const Ice::CommunicatorPtr& communicator, const std::string& plug_in,
                             bool for_this_only) {
    const auto properties = communicator->getProperties();
    refuseUnknown(properties);
    const auto traces = properties->getPropertyAsInt(kTraces);
    const auto before = communicator->getLogger();
    if (traces < kNeededTraces) {
        if (!properties->getProperty(kFolder).empty()) refuseToStart(tracesMissing(kFolder));
        if (for_this_only) refuseToStart(tracesMissing(plug_in));
        before->warning(tracesMissing(plug_in));
        return {{}, before};
    }
    const Refusals::Say say = [before](const std::string& line) { before->warning(line); };
    const auto refusals = std::make_shared<Refusals>(trailOf(properties, say), steadyClock(), say);
    return {refusals, new RefusalsLog(before, refusals, traces > kNeededTraces)};
}

}  // namespace axon::router_guard
