// SPDX-License-Identifier: GPL-2.0-or-later
#include "ddsperf.hpp"

#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "child.hpp"

namespace axon::bench {

namespace {

// One interface, and no multicast on it: loopback has none everywhere. The largest datagram that UDP has, so that a message of
// chapter 5 is one.
constexpr const char* kLoopback =
    "CYCLONEDDS_URI=<CycloneDDS><Domain id=\"any\"><General><Interfaces><NetworkInterface name=\"lo\"/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast><MaxMessageSize>65500B</MaxMessageSize></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>";

}  // namespace

std::optional<DdsperfSecond> readDdsperf(const std::string& line) {
    std::istringstream words(line);
    DdsperfSecond second;
    int found = 0;
    for (std::string key, value; words >> key;) {
        double* to = key == "mean" ? &second.mean_us : key == "50%" ? &second.p50_us : key == "99%" ? &second.p99_us : key == "max" ? &second.max_us : nullptr;
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

std::vector<DdsperfSecond> pingPong(const std::filesystem::path& folder, std::size_t bytes, int seconds) {
    const auto domain = std::to_string(1 + ::getpid() % 200);
    const auto program = findProgram("ddsperf");
    const Child pong({program, "-i", domain, "pong"}, folder / "pong.log", {kLoopback});
    const Child ping({program, "-i", domain, "-D", std::to_string(seconds + 2), "ping", "size", std::to_string(bytes)}, folder / "ping.log", {kLoopback});
    ping.wait(std::chrono::seconds{seconds + 15});
    std::vector<DdsperfSecond> all;
    std::ifstream in(folder / "ping.log");
    for (std::string line; std::getline(in, line);)
        if (const auto second = readDdsperf(line)) all.push_back(*second);
    if (!all.empty()) all.erase(all.begin());
    if (all.empty() && !interrupted) throw std::runtime_error(ping.complaint("ddsperf printed no round trips"));
    return all;
}

}  // namespace axon::bench
