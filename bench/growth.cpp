// SPDX-License-Identifier: GPL-2.0-or-later
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <memory>
#include <optional>
#include <sstream>

#include "experiment.hpp"
#include "herd.hpp"
#include "report.hpp"
#include "subject.hpp"

// What idle entities and clients cost the server. Method: docs/reference/benchmarks.md.

namespace axon::bench {

namespace {

struct Wish {
    std::vector<std::size_t> entities{64, 512, 2048}, clients{64, 512};
    double seconds = 10;
    std::string json;
};

/// Of a process, as the kernel counts it.
struct Use {
    long resident_kb = 0, own_kb = 0, threads = 0;  ///< own: anonymous memory, without files that are mapped
    double cpu_s = 0;
    std::int64_t at = 0;
};

Use useOf(pid_t pid) {
    Use use;
    std::ifstream status("/proc/" + std::to_string(pid) + "/status");
    for (std::string key; status >> key; status.ignore(1000, '\n')) {
        if (key == "VmRSS:") status >> use.resident_kb;
        if (key == "RssAnon:") status >> use.own_kb;
        if (key == "Threads:") status >> use.threads;
    }
    std::ifstream stat("/proc/" + std::to_string(pid) + "/stat");
    std::string line;
    std::getline(stat, line);
    std::istringstream fields(line.substr(line.rfind(')') + 1));  // a name may hold spaces
    std::string skipped;
    for (int i = 3; i <= 13; ++i) fields >> skipped;
    long user = 0, system = 0;
    fields >> user >> system;
    use.cpu_s = static_cast<double>(user + system) / static_cast<double>(::sysconf(_SC_CLK_TCK));
    use.at = nowNs();
    return use;
}

/// Waits, and says what share of a core the process took meanwhile.
double cpuShare(pid_t pid, double seconds) {
    const auto before = useOf(pid);
    sleepUntil(before.at + static_cast<std::int64_t>(seconds * 1e9));
    const auto after = useOf(pid);
    return (after.cpu_s - before.cpu_s) / (static_cast<double>(after.at - before.at) / 1e9);
}

/// Entities do not tell here.
std::uint64_t disconnectedOf(Entities&) { return 0; }
std::uint64_t disconnectedOf(Herd& clients) { return clients.sums().disconnected; }

class Growth {
  public:
    Growth(const Wish& wish, Report& report) : wish_(wish), report_(report) {}

    void run() {
        std::printf("The server with N idle entities, or M idle clients that hold nothing; memory above that of an empty one.\n");
        std::printf("%9s %9s %12s %14s %12s %12s %10s %9s\n", "", "N", "ready s", "all there s", "memory MiB", "KiB each", "CPU %", "threads");
        for (const auto n : wish_.entities)
            if (!interrupted) row("entities", n, [&](const AxonServer& server, const std::filesystem::path& folder) {
                return std::make_shared<Entities>(folder, "idle", n, server.entityAddress());
            });
        for (const auto n : wish_.clients)
            if (!interrupted) row("clients", n, [&](const AxonServer& server, const std::filesystem::path& folder) {
                return std::make_shared<Herd>(folder, n, server, "nobody", 0);
            });
    }

    bool sound() const { return sound_; }

  private:
    template <class Join>
    void row(const char* what, std::size_t n, const Join& join) {
        progress(std::string("growth: ") + std::to_string(n) + " " + what);
        const auto folder = work_.sub(std::string(what) + "-" + std::to_string(n));
        const auto begin = nowNs();
        AxonServer server(folder);
        const double ready = static_cast<double>(nowNs() - begin) / 1e9;
        sleepUntil(nowNs() + 1'000'000'000);
        const auto empty = useOf(server.process().pid());
        const auto join_begin = nowNs();
        const auto joined = join(server, folder);
        const double there = static_cast<double>(nowNs() - join_begin) / 1e9;
        sleepUntil(nowNs() + static_cast<std::int64_t>(std::min(wish_.seconds, 3.0) * 1e9));  // what joining has stirred up settles
        const double share = cpuShare(server.process().pid(), wish_.seconds);
        if (interrupted) return;
        const auto full = useOf(server.process().pid());
        const auto disconnected = disconnectedOf(*joined);
        const auto server_ended = whichHasEnded({{"axon-server", &server.process()}});
        const auto ended = server_ended.empty() ? joined->ended() : server_ended;
        if (disconnected > 0 || !ended.empty()) sound_ = false;
        const double each = static_cast<double>(full.own_kb - empty.own_kb) / static_cast<double>(n);
        progress("");
        std::printf("%9s %9zu %12.3f %14.3f %12.1f %12.1f %10.2f %9ld\n", what, n, ready, there, static_cast<double>(full.own_kb - empty.own_kb) / 1024, each, share * 100,
                    full.threads);
        if (disconnected > 0) std::printf("%9s %9zu: %llu TIMES A CLIENT LOST ITS CONNECTION.\n", what, n, static_cast<unsigned long long>(disconnected));
        if (!ended.empty()) std::printf("%9s %9zu: %s\n", what, n, ended.c_str());
        std::fflush(stdout);
        report_.add({{"what", what}, {"n", n}, {"server_ready_s", ready}, {"all_there_s", there}, {"empty_own_kb", empty.own_kb}, {"own_kb", full.own_kb},
                     {"resident_kb", full.resident_kb}, {"kb_each", each}, {"cpu_share", share}, {"threads", full.threads}, {"disconnected", disconnected}, {"ended", ended}});
    }

    const Wish& wish_;
    Report& report_;
    const WorkFolder work_;
    bool sound_ = true;
};

int run(const Wish& wish) {
    Report report(wish.json, "growth", {{"entities", wish.entities}, {"clients", wish.clients}, {"seconds", wish.seconds}});
    reportPeers(report, {});
    Growth growth(wish, report);
    carryOut([&] { growth.run(); });
    return conclude(report, growth.sound() ? "" : "SOMETHING OF AXON'S WAS DISCONNECTED OR HAS ENDED.");
}

}  // namespace

Experiment declareGrowth(CLI::App& app) {
    const auto wish = std::make_shared<Wish>();
    auto* command = app.add_subcommand("growth", "Memory and processor of the server for each idle entity and client");
    command->footer("Examples:\n  axon-bench growth --json growth.json\n  axon-bench growth --entities 5000 --clients 0\n");
    command->add_option("--entities", wish->entities, "One server for each number [64,512,2048]; 0 = none")->delimiter(',')->check(CLI::Range(0, 16384).description(""))->type_name("N,…");
    command->add_option("--clients", wish->clients, "Likewise [64,512]; 0 = none")->delimiter(',')->check(CLI::Range(0, 4096).description(""))->type_name("M,…");
    command->add_option("--seconds", wish->seconds, "For which the processor's time is taken [10]")->check(CLI::Range(0.5, 1e5).description(""))->type_name("S");
    command->add_option("--json", wish->json, "Write the results, with the machine described, to this file")->type_name("FILE");
    return {command, [wish] {
                std::erase(wish->entities, 0U);
                std::erase(wish->clients, 0U);
                return run(*wish);
            }};
}

}  // namespace axon::bench
