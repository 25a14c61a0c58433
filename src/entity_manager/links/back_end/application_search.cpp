// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/back_end/application_search.hpp"

#include <set>
#include <string_view>
#include <utility>
#include <vector>

#include "messages/text.hpp"

namespace axon::entity_manager {

namespace {

constexpr Duration kLastPause = std::chrono::minutes{10};
constexpr Duration kRecent =
    std::chrono::seconds{3};  // an application that still runs is asked again within a second
constexpr std::size_t kMet = 64;
constexpr std::size_t kNamed = 8;

std::string named(const std::string& application, const std::string& instance) {
    return inQuotes(application) + (instance.empty() ? "" : ", instance " + inQuotes(instance));
}

}  // namespace

ApplicationSearch::ApplicationSearch(Wanted wanted, Duration first)
    : wanted_(std::move(wanted)), pause_(first, kLastPause) {}

void ApplicationSearch::begin(TimePoint now) {
    met_.clear();
    pause_.reset();
    next_ = now + pause_.next();
}

void ApplicationSearch::met(std::uint16_t port, const std::string& application, const std::string& instance,
                            const std::string& declined, TimePoint now) {
    if (met_.size() < kMet || met_.contains(port)) met_[port] = {application, instance, declined, now};
}

std::optional<SearchReport> ApplicationSearch::report(TimePoint now) {
    if (!next_ || now < *next_) return std::nullopt;
    next_ = now + pause_.next();
    std::erase_if(met_, [&](const auto& entry) { return now - entry.second.at > kRecent; });

    const auto& ports = wanted_.where.ports;
    SearchReport report;
    report.finding = "no robot application " + named(wanted_.application, wanted_.instance) +
                     " is found at " + wanted_.where.address +
                     (ports.first == ports.last
                          ? ", port " + std::to_string(ports.first)
                          : ", ports " + std::to_string(ports.first) + " to " + std::to_string(ports.last)) +
                     " (" + (wanted_.ports_from.empty() ? "the defaults" : wanted_.ports_from) + ")";
    std::string others;
    std::set<std::string_view> names;
    std::size_t count = 0;
    for (const auto& [port, one] : met_) {
        if (!one.declined.empty()) {
            report.finding = "the robot application " + named(one.application, one.instance) +
                             " is found at port " + std::to_string(port) + " and declines: " + one.declined;
            return report;  // its words say what to do
        }
        if (one.application != wanted_.application) names.insert(one.application);
        if (count++ < kNamed)
            others += (others.empty() ? "" : ", ") + named(one.application, one.instance) + " (port " +
                      std::to_string(port) + ")";
    }
    if (count > kNamed) others += " and " + std::to_string(count - kNamed) + " more";
    report.finding += others.empty() ? "; none listens there" : "; found there: " + others;

    const auto near = nearNames(wanted_.application, {names.begin(), names.end()});
    report.fix = "start the application with the same ports.cfg, or correct ";
    report.fix += !met_.empty() && names.empty() ? "--instance" : "--application";
    if (!near.empty()) report.fix += " (did you mean " + alternatives(near) + "?)";
    return report;
}

}  // namespace axon::entity_manager
