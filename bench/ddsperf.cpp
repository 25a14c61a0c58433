// SPDX-License-Identifier: GPL-2.0-or-later
#include "ddsperf.hpp"

#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <thread>

#include "child.hpp"

namespace axon::bench {

namespace {

// One interface, and no multicast on it: loopback has none everywhere. The largest datagram that UDP has, so
// that a message of chapter 5 is one.
constexpr const char* kLoopback =
    "CYCLONEDDS_URI=<CycloneDDS><Domain id=\"any\"><General><Interfaces><NetworkInterface "
    "name=\"lo\"/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast><MaxMessageSize>65500B</MaxMessageSize></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer "
    "address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>";
/// Within which the two find each other, even on a machine that has much else to do.
constexpr std::chrono::seconds kDiscovery{20};
constexpr std::chrono::seconds kSlack{5};

}  // namespace

std::optional<DdsperfSecond> readDdsperf(const std::string& line) {
    std::istringstream words(line);
    DdsperfSecond second;
    int found = 0;
    for (std::string key, value; words >> key;) {
        double* to = key == "mean"  ? &second.mean_us
                     : key == "50%" ? &second.p50_us
                     : key == "99%" ? &second.p99_us
                     : key == "max" ? &second.max_us
                                    : nullptr;
        if (to == nullptr && key != "cnt") continue;
        if (!(words >> value)) return std::nullopt;
        if (key == "cnt") {
            found += std::sscanf(value.c_str(), "%ld", &second.count);
        } else {
            found += std::sscanf(value.c_str(), "%lfus", to);
        }
    }
    return found == 5 && second.count > 0 ? std::optional(second) : std::nullopt;
}

namespace {

std::vector<DdsperfSecond> readAll(const std::filesystem::path& log) {
    std::vector<DdsperfSecond> all;
    std::ifstream in(log);
    for (std::string line;
         std::getline(in, line) && !in.eof();)  // a line whose end is not there yet is not one
        if (const auto second = readDdsperf(line)) all.push_back(*second);
    return all;
}

}  // namespace

std::vector<DdsperfSecond> pingPong(const std::filesystem::path& folder, std::size_t bytes, int seconds,
                                    const Placement& placement) {
    // The ports of greater domains lie among those that the kernel gives to others.
    const auto domain = std::to_string(1 + ::getpid() % 100);
    const auto program = findProgram("ddsperf");
    const Child pong({program, "-i", domain, "pong"}, folder / "pong.log", {kLoopback},
                     placement.asReceiver());
    const Child ping({program, "-i", domain, "ping", "size", std::to_string(bytes)}, folder / "ping.log",
                     {kLoopback}, placement.asSender());
    std::vector<DdsperfSecond> all;
    const auto wait = [&](std::size_t lines, std::chrono::seconds time) {
        for (const auto end = std::chrono::steady_clock::now() + time;
             all.size() < lines && !interrupted && std::chrono::steady_clock::now() < end;) {
            const bool last = !ping.running();
            all = readAll(folder / "ping.log");
            if (last) return;
            std::this_thread::sleep_for(std::chrono::milliseconds{50});
        }
    };
    const auto wanted = static_cast<std::size_t>(seconds) + 1;
    wait(1, kDiscovery);
    if (!all.empty()) wait(wanted, std::chrono::seconds{seconds} + kSlack);
    if (!all.empty()) all.erase(all.begin());
    if (all.empty() && !interrupted)
        throw std::runtime_error(ping.complaint("ddsperf printed no round trips"));
    return all;
}

}  // namespace axon::bench
