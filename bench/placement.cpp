// SPDX-License-Identifier: GPL-2.0-or-later
#include "placement.hpp"

#include <sched.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <filesystem>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <system_error>
#include <utility>

namespace axon::bench {

namespace {

namespace fs = std::filesystem;

std::optional<pid_t> number(std::string_view text) {
    pid_t value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
    return value;
}

/// The numbers among the names in a folder of /proc. A process that ends meanwhile has none.
std::vector<pid_t> numbersIn(const fs::path& folder) {
    std::vector<pid_t> all;
    std::error_code gone;
    for (fs::directory_iterator it(folder, gone), end; !gone && it != end; it.increment(gone))
        if (const auto one = number(it->path().filename().string())) all.push_back(*one);
    return all;
}

std::vector<pid_t> children() {
    std::vector<pid_t> all;
    for (const auto process : numbersIn("/proc")) {
        std::ifstream in("/proc/" + std::to_string(process) + "/stat");
        std::string line;
        std::getline(in, line);
        // "PID (NAME) STATE PARENT …", and a name may contain anything.
        const auto name_end = line.rfind(')');
        if (name_end == std::string::npos || name_end + 4 >= line.size()) continue;
        const auto rest = std::string_view(line).substr(name_end + 4);
        if (number(rest.substr(0, rest.find(' '))) == ::getpid()) all.push_back(process);
    }
    return all;
}

/// `thread`: 0 = the calling one.
void pin(pid_t thread, const std::vector<int>& cores) {
    cpu_set_t set;
    CPU_ZERO(&set);
    for (const auto core : cores) CPU_SET(core, &set);
    if (::sched_setaffinity(thread, sizeof(set), &set) != 0 && errno != ESRCH)  // it has ended
        throw std::system_error(errno, std::generic_category(), "sched_setaffinity");
}

/// Every thread of it. Looks until no new one has appeared, for one may be begun by a thread that has not
/// been moved yet.
void pinProcess(pid_t process, const std::vector<int>& cores) {
    const auto tasks = fs::path("/proc") / std::to_string(process) / "task";
    for (std::vector<pid_t> before, now = numbersIn(tasks); now != before;
         before = std::exchange(now, numbersIn(tasks)))
        for (const auto thread : now) pin(thread, cores);
}

}  // namespace

const char* nameOf(Cores cores) {
    return cores == Cores::Any ? "any" : cores == Cores::One ? "one" : "two";
}

Cores coresOf(const std::string& name) {
    for (const auto cores : {Cores::Any, Cores::One, Cores::Two})
        if (name == nameOf(cores)) return cores;
    throw std::invalid_argument("expected any, one or two, found '" + name + "'");
}

Placement::Placement() {
    cpu_set_t set;
    if (::sched_getaffinity(0, sizeof(set), &set) != 0)
        throw std::system_error(errno, std::generic_category(), "sched_getaffinity");
    for (int core = 0; core < CPU_SETSIZE; ++core)
        if (CPU_ISSET(core, &set)) all_.push_back(core);
    first_ = {all_.at(0)};
    if (all_.size() > 1) second_ = {all_[1]};
}

Placement::~Placement() {
    try {
        apply(Cores::Any);
    } catch (const std::exception&) {  // what follows runs where this has run
    }
}

bool Placement::permits(Cores cores) const {
    return cores != Cores::Two || !second_.empty();
}

const std::vector<int>& Placement::of(Cores cores, bool sender) const {
    return cores == Cores::Any ? all_ : cores == Cores::One || sender ? first_ : second_;
}

void Placement::apply(Cores cores) {
    if (!permits(cores)) throw std::system_error(EINVAL, std::generic_category(), "a second core");
    pinProcess(::getpid(), of(cores, true));
    for (const auto child : children()) pinProcess(child, of(cores, false));
    applied_ = cores;
}

std::function<void()> Placement::asSender() const {
    return [cores = of(applied_, true)] { pin(0, cores); };
}

std::function<void()> Placement::asReceiver() const {
    return [cores = of(applied_, false)] { pin(0, cores); };
}

}  // namespace axon::bench
