// SPDX-License-Identifier: GPL-2.0-or-later
#include "report.hpp"

#include <sched.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <thread>

#include "board.hpp"
#include "child.hpp"
#include "transport/ice/communicator.hpp"

namespace axon::bench {

namespace {

constexpr double kNever = std::numeric_limits<double>::infinity();
/// From so many samples on a quantile of 0.999 is more than the maximum by another name.
constexpr std::size_t kEnoughForP999 = 1000;

nlohmann::json orNull(double value) {
    return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json();
}

std::string valueOf(const char* file, const std::string& key) {
    std::ifstream in(file);
    for (std::string line; std::getline(in, line);)
        if (line.rfind(key, 0) == 0) {
            const auto begin = line.find_first_not_of(" \t:", key.size());
            return begin == std::string::npos ? "" : line.substr(begin);
        }
    return {};
}

std::string now() {
    const auto seconds = std::time(nullptr);
    std::array<char, 40> text{};
    std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", std::gmtime(&seconds));
    return text.data();
}

bool realTimePermitted() {
    sched_param before{};
    const int policy = ::sched_getscheduler(0);
    ::sched_getparam(0, &before);
    sched_param wish{};
    wish.sched_priority = transport::kStopPriority;
    if (::sched_setscheduler(0, SCHED_RR, &wish) != 0) return false;
    ::sched_setscheduler(0, policy, &before);
    return true;
}

}  // namespace

double quantile(const std::vector<double>& ordered, double q) {
    const auto n = ordered.size();
    if (n == 0) return 0;
    if (q == 0.5 && n % 2 == 0) return (ordered[n / 2 - 1] + ordered[n / 2]) / 2;
    constexpr double kRounding = 1e-9;  // 0.07 * 100 is a little more than 7
    const auto rank =
        static_cast<std::size_t>(std::max(1.0, std::ceil(q * static_cast<double>(n) - kRounding)));
    return ordered[std::min(rank, n) - 1];
}

nlohmann::json spread(std::vector<double> values) {
    std::erase_if(values, [](double value) { return std::isnan(value); });
    std::sort(values.begin(), values.end());
    if (values.empty()) return {{"n", 0}};
    return {{"n", values.size()},
            {"median", orNull(quantile(values, 0.5))},
            {"p10", orNull(quantile(values, 0.1))},
            {"p90", orNull(quantile(values, 0.9))}};
}

std::vector<double> ratios(const std::vector<double>& ours, const std::vector<double>& theirs) {
    std::vector<double> all;
    for (std::size_t i = 0; i < std::min(ours.size(), theirs.size()); ++i) all.push_back(ours[i] / theirs[i]);
    return all;
}

void MeanOverN::add(std::size_t n, const nlohmann::json& ratio) {
    const auto median = ratio.value("median", nlohmann::json());
    if (!median.is_number() || median <= 0) {
        null_ = true;
        return;
    }
    logs_ += std::log(median.get<double>());
    n_.push_back(n);
}

nlohmann::json MeanOverN::mean() const {
    return null_ || n_.empty() ? nlohmann::json()
                               : nlohmann::json(std::exp(logs_ / static_cast<double>(n_.size())));
}

void Series::endBatch() {
    if (!open_) return;
    open_ = false;
    double sum = 0, last = 0;
    for (auto i = batch_begin_; i < arrived_.size(); ++i) {
        sum += arrived_[i];
        last = std::max(last, arrived_[i]);
    }
    const bool whole = lost_ == batch_lost_ && arrived_.size() > batch_begin_;
    means_.push_back(whole ? sum / static_cast<double>(arrived_.size() - batch_begin_) : kNever);
    lasts_.push_back(whole ? last : kNever);
}

void Series::beginBatch() {
    endBatch();
    open_ = true;
    batch_begin_ = arrived_.size();
    batch_lost_ = lost_;
}

void Series::add(double ms) {
    arrived_.push_back(ms);
}
void Series::lose() {
    ++lost_;
}

nlohmann::json Series::json() {
    endBatch();
    nlohmann::json out{{"n", sent()}, {"lost", lost_}};
    if (sent() == 0) return out;
    auto all = arrived_;
    std::sort(all.begin(), all.end());
    double sum = 0;
    for (const double value : all) sum += value;
    out["mean"] = orNull(all.empty() ? kNever : sum / static_cast<double>(all.size()));
    all.insert(all.end(), lost_, kNever);
    out["p50"] = orNull(quantile(all, 0.5));
    out["p99"] = orNull(quantile(all, 0.99));
    if (sent() >= kEnoughForP999) out["p99.9"] = orNull(quantile(all, 0.999));
    out["max"] = orNull(all.back());
    if (!lasts_.empty()) {
        auto last = lasts_;
        std::sort(last.begin(), last.end());
        out["last"] = orNull(quantile(last, 0.5));
    }
    return out;
}

std::string figure(const nlohmann::json& series, const char* key, int width) {
    std::array<char, 40> text{};
    const auto found = series.find(key);
    if (found == series.end()) {
        std::snprintf(text.data(), text.size(), "%*s", width, "-");
    } else if (found->is_null()) {
        std::snprintf(text.data(), text.size(), "%*s", width, "never");
    } else {
        std::snprintf(text.data(), text.size(), "%*.3f", width, found->get<double>());
    }
    return text.data();
}

Report::Report(std::string file, const std::string& experiment, nlohmann::json settings)
    : file_(std::move(file)),
      all_{{"experiment", experiment},
           {"began", now()},
           {"partial", true},
           {"machine", machine()},
           {"settings", std::move(settings)},
           {"results", nlohmann::json::array()}} {
    write();
}

void Report::add(nlohmann::json row) {
    all_["results"].push_back(std::move(row));
    write();
}

void Report::set(const std::string& key, nlohmann::json value) {
    all_[key] = std::move(value);
    write();
}

void Report::finish() {
    all_["partial"] = interrupted != 0;
    all_["ended"] = now();
    write();
}

void Report::write() const {
    if (file_.empty()) return;
    // Whole or not at all: whoever reads it meanwhile, or pulls the plug, has the one before.
    const auto draft = file_ + ".part";
    std::ofstream out(draft);
    out << all_.dump(2) << "\n";
    out.close();
    std::error_code failed;
    if (out) std::filesystem::rename(draft, file_, failed);
    if (!out || failed)
        throw std::runtime_error("cannot write " + file_ +
                                 "; fix: name a file in a folder to which you may write with --json");
}

void carryOut(const std::function<void()>& work) {
    try {
        work();
    } catch (const std::exception&) {
        if (!interrupted) throw;
    }
    progress("");
}

int conclude(Report& report, const std::string& wrong) {
    report.finish();
    if (interrupted) std::printf("INTERRUPTED: these are partial results.\n");
    if (!wrong.empty()) std::printf("%s\n", wrong.c_str());
    return interrupted || !wrong.empty() ? 1 : 0;
}

void progress(const std::string& text) {
    static const bool terminal = ::isatty(STDERR_FILENO) == 1;
    if (terminal) std::fprintf(stderr, "\r\033[K%s", text.c_str());
}

nlohmann::json machine() {
    utsname kernel{};
    ::uname(&kernel);
    std::array<double, 3> load{};
    ::getloadavg(load.data(), 3);
    return {{"cpu", valueOf("/proc/cpuinfo", "model name")},
            {"cores", std::thread::hardware_concurrency()},
            {"memory_kb", std::atoll(valueOf("/proc/meminfo", "MemTotal").c_str())},
            {"kernel", std::string(kernel.sysname) + " " + kernel.release},
            {"hypervisor", valueOf("/proc/cpuinfo", "flags").find(" hypervisor") != std::string::npos},
            {"system", valueOf("/etc/os-release", "PRETTY_NAME=")},
            {"load_average", load},
            {"real_time_permitted", realTimePermitted()},
            {"clock", "CLOCK_MONOTONIC"},
#ifdef NDEBUG
            {"assertions", false},
#else
            {"assertions", true},
#endif
#ifdef __OPTIMIZE__
            {"optimised", true},
#else
            {"optimised", false},
#endif
            {"compiler", __VERSION__}};
}

std::string packageVersion(const std::string& package) {
    FILE* pipe = ::popen(("dpkg-query -W -f='${Version}' " + package + " 2>/dev/null").c_str(), "r");
    if (pipe == nullptr) return {};
    std::array<char, 200> text{};
    const auto size = std::fread(text.data(), 1, text.size() - 1, pipe);
    return ::pclose(pipe) == 0 ? std::string(text.data(), size) : std::string();
}

bool sleepUntil(std::int64_t time) {
    for (auto left = time - nowNs(); left > 0 && !interrupted; left = time - nowNs())
        std::this_thread::sleep_for(std::chrono::nanoseconds(std::min<std::int64_t>(left, 100'000'000)));
    return !interrupted;
}

}  // namespace axon::bench
