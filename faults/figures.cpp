// SPDX-License-Identifier: GPL-2.0-or-later
#include "figures.hpp"

#include <sys/utsname.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <thread>

namespace axon::faults {

namespace {

constexpr std::size_t kViolationsShown = 100;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

std::string shown(const std::optional<double>& ms) {
    if (!ms) return "-";
    if (std::isinf(*ms)) return "never";
    char text[32];
    std::snprintf(text, sizeof text, *ms < 10 ? "%.2f" : "%.1f", *ms);
    return text;
}

nlohmann::json jsonOf(const std::optional<double>& ms) {
    if (!ms) return nullptr;
    if (std::isinf(*ms)) return "never";
    return *ms;
}

}  // namespace

std::optional<double> Series::percentile(double q) const {
    const auto n = size();
    // One of 1/(1-q) lies beyond it; fewer than that say nothing about it.
    const auto least = static_cast<std::size_t>(std::llround(1.0 / (1.0 - q)));
    if (n < least) return std::nullopt;
    auto rank = static_cast<std::size_t>(std::ceil(q * static_cast<double>(n) - 1e-9));
    rank = std::clamp<std::size_t>(rank, 1, n);
    if (rank > ms_.size()) return kInfinity;
    auto sorted = ms_;
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(rank - 1), sorted.end());
    return sorted[rank - 1];
}
std::optional<double> Series::minimum() const {
    if (ms_.empty()) return std::nullopt;
    return *std::min_element(ms_.begin(), ms_.end());
}
std::optional<double> Series::maximum() const {
    if (never_ > 0) return kInfinity;
    if (ms_.empty()) return std::nullopt;
    return *std::max_element(ms_.begin(), ms_.end());
}

void Report::violation(std::string sentence) {
    ++violations_count;
    if (violations.size() < kViolationsShown) violations.push_back(std::move(sentence));
}

std::vector<std::string> Report::broken() const {
    std::vector<std::string> why;
    if (latency.never() > 0) why.push_back(std::to_string(latency.never()) + " " + measured + " never came");
    if (late > late_beside_stall)
        why.push_back(std::to_string(late - late_beside_stall) + " " + measured + " came later than " +
                      shown(promise.bound_ms) + " ms");
    const auto judge = [&](const char* name, double q, double promised) {
        const auto found = latency.percentile(q);
        if (promised > 0 && !busy && host_stalls == 0 && found && *found > promised)
            why.push_back(std::string(name) + " is " + shown(found) + " ms, promised were " +
                          shown(promised) + " ms");
    };
    judge("p99", 0.99, promise.p99_ms);
    judge("p99.9", 0.999, promise.p999_ms);
    if (moved_after_stop > 0)
        why.push_back(std::to_string(moved_after_stop) + " robots moved after their stop without an order");
    if (not_recovered > 0)
        why.push_back("after " + std::to_string(not_recovered) +
                      " faults things did not come back by themselves");
    if (violations_count > 0) why.push_back(std::to_string(violations_count) + " violations");
    if (trials == 0 && !partial) why.push_back("no trial was carried out");
    return why;
}

std::string toText(const Report& report) {
    std::string text = report.kind + ": " + std::to_string(report.trials) + " trials";
    const auto line = [&text](const std::string& words) { text += "\n  " + words; };
    if (report.partial) text += " of " + std::to_string(report.trials_wanted) + " (interrupted)";
    char seconds[48];
    std::snprintf(seconds, sizeof seconds, " in %.1f s", report.seconds);
    text += seconds;
    if (report.busy) text += ", every core saturated";
    const auto& l = report.latency;
    if (l.size() > 0) {
        line(report.measured + ": n " + std::to_string(l.size()) + ", never arrived " +
             std::to_string(l.never()));
        line("ms: min " + shown(l.minimum()) + "  p50 " + shown(l.percentile(0.5)) + "  p90 " +
             shown(l.percentile(0.9)) + "  p99 " + shown(l.percentile(0.99)) + "  p99.9 " +
             shown(l.percentile(0.999)) + "  max " + shown(l.maximum()));
    }
    if (report.late > 0)
        line("later than promised: " + std::to_string(report.late) +
             ", of these within it but for a stall of the host: " + std::to_string(report.late_beside_stall));
    line("host stalls above 50 ms: " + std::to_string(report.host_stalls) +
         ", trials beside one: " + std::to_string(report.trials_beside_stall) +
         ", longest wait of the probe: " + shown(report.longest_stall_ms) + " ms");
    if (!report.causes.empty()) {
        std::string causes = "causes:";
        for (const auto& [name, count] : report.causes) causes += " " + name + " " + std::to_string(count);
        line(causes);
    }
    if (report.stopped_before > 0)
        line("robots that stopped before the fault: " + std::to_string(report.stopped_before));
    for (const auto& [name, count] : report.counts) line(name + ": " + std::to_string(count));
    for (const auto& sentence : report.violations) line("! " + sentence);
    const auto broken = report.broken();
    line((broken.empty() ? "kept: " : "BROKEN: ") + report.promise.text);
    for (const auto& why : broken) line("  " + why);
    return text + "\n";
}

std::string toJson(const Report& report) {
    const auto& l = report.latency;
    const auto broken = report.broken();
    return nlohmann::json{
        {"kind", report.kind},
        {"promise",
         {{"text", report.promise.text},
          {"bound_ms", report.promise.bound_ms},
          {"p99_ms", report.promise.p99_ms},
          {"p99.9_ms", report.promise.p999_ms}}},
        {"kept", broken.empty()},
        {"broken", broken},
        {"trials_wanted", report.trials_wanted},
        {"trials", report.trials},
        {"partial", report.partial},
        {"busy", report.busy},
        {"seconds", report.seconds},
        {"measured", report.measured},
        {"latency_ms",
         {{"n", l.size()},
          {"never", l.never()},
          {"min", jsonOf(l.minimum())},
          {"p50", jsonOf(l.percentile(0.5))},
          {"p90", jsonOf(l.percentile(0.9))},
          {"p99", jsonOf(l.percentile(0.99))},
          {"p99.9", jsonOf(l.percentile(0.999))},
          {"max", jsonOf(l.maximum())},
          {"all", l.all()}}},
        {"late", report.late},
        {"late_beside_stall", report.late_beside_stall},
        {"trials_beside_stall", report.trials_beside_stall},
        {"host_stalls", report.host_stalls},
        {"longest_stall_ms", report.longest_stall_ms},
        {"moved_after_stop", report.moved_after_stop},
        {"stopped_before", report.stopped_before},
        {"not_recovered", report.not_recovered},
        {"causes", report.causes},
        {"counts", report.counts},
        {"violations", report.violations_count},
        {"violations_shown", report.violations},
    }
        .dump();
}

std::string machineJson() {
    std::string model = "unknown";
    std::ifstream cpu("/proc/cpuinfo");
    for (std::string line; std::getline(cpu, line);)
        if (line.rfind("model name", 0) == 0) {
            model = line.substr(line.find(':') + 2);
            break;
        }
    utsname names{};
    ::uname(&names);
    return nlohmann::json{{"cpu", model},
                          {"cores", std::thread::hardware_concurrency()},
                          {"kernel", names.release},
                          {"clock", "CLOCK_MONOTONIC"}}
        .dump();
}

}  // namespace axon::faults
