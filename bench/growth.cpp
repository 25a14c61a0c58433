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

// What entities and clients cost the server, idle and active. Method: docs/reference/benchmarks.md.

namespace axon::bench {

namespace {

struct Wish {
    std::vector<std::size_t> entities{64, 512, 2048, 5000}, clients{64, 512, 2048};
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

constexpr std::int64_t kPeriod_ns = 500'000'000;

/// What a share of a core the process takes while `work` goes on for so long.
template <class Work>
double cpuShare(pid_t pid, double seconds, const Work& work) {
    const auto before = useOf(pid);
    work(before.at + static_cast<std::int64_t>(seconds * 1e9));
    const auto after = useOf(pid);
    return (after.cpu_s - before.cpu_s) / (static_cast<double>(after.at - before.at) / 1e9);
}

/// N entities. Active: a client that holds all of them sends 60 bytes to each every 500 ms.
class EntitiesThere {
  public:
    EntitiesThere(const AxonServer& server, const std::filesystem::path& folder, std::size_t n)
        : server_(server), entities_(folder, "idle", n, server.entityAddress()) {}
    void begin() {
        client_ = connectClient(server_.clientAddress());
        held_ = holdAll(*client_, entities_.names());
        left_ = countLeft(*client_);
    }
    void work(std::int64_t until) {
        auto bytes = content(kSmallBytes);
        for (auto due = nowNs(); due < until && sleepUntil(due); due += kPeriod_ns) {
            setNumber(bytes, number_++);
            for (const auto& entity : held_)
                static_cast<void>(entity.sendRaw(bytes, client::Seconds{1}));  // what has arrived counts
        }
        sleepUntil(until);
    }
    std::uint64_t arrived() {
        std::uint64_t sum = 0;
        for (std::size_t i = 0; i < entities_.board().size(); ++i) sum += entities_.board()[i].intact;
        return sum;
    }
    /// Since begin(): idle, nobody is told.
    std::uint64_t disconnected() const { return *left_; }
    std::string ended() const { return entities_.ended(); }

  private:
    const AxonServer& server_;
    Entities entities_;
    std::unique_ptr<client::Client> client_;
    std::vector<client::CheckOut> held_;
    std::shared_ptr<std::atomic<std::size_t>> left_;
    std::uint32_t number_ = 0;
};

/// M clients that hold one open entity together. Active: it sends 60 bytes to each every 500 ms.
class ClientsThere {
  public:
    ClientsThere(const AxonServer& server, const std::filesystem::path& folder, std::size_t n)
        : speaker_(folder, "speaker", 1, server.entityAddress(), nullptr, Variant::Open),
          herd_(folder, n, server, "speaker", 1, true) {}
    void begin() { speaker_.board().go() = 1; }
    void work(std::int64_t until) { sleepUntil(until); }
    std::uint64_t arrived() { return herd_.sums().received; }
    std::uint64_t disconnected() { return herd_.sums().disconnected; }
    std::string ended() const {
        const auto its = herd_.ended();
        return its.empty() ? speaker_.ended() : its;
    }

  private:
    Entities speaker_;
    Herd herd_;
};

class Growth {
  public:
    Growth(const Wish& wish, Report& report) : wish_(wish), report_(report) {}

    void run() {
        std::printf(
            "The server with N entities, or M clients; memory above that of an empty one, processor in %% of "
            "a core. Active: each takes 60 bytes every 500 ms.\n");
        std::printf("%9s %9s %9s %12s | %10s %9s %9s | %10s %9s %9s | %8s\n", "", "N", "ready s",
                    "all there s", "idle MiB", "KiB each", "CPU %", "active MiB", "KiB each", "CPU %",
                    "threads");
        for (const auto n : wish_.entities) row<EntitiesThere>("entities", n);
        for (const auto n : wish_.clients) row<ClientsThere>("clients", n);
    }

    bool sound() const { return sound_; }

  private:
    template <class There>
    void row(const char* what, std::size_t n) {
        if (interrupted) return;
        progress(std::string("growth: ") + std::to_string(n) + " " + what);
        const auto folder = work_.sub(std::string(what) + "-" + std::to_string(n));
        const auto begin = nowNs();
        AxonServer server(folder);
        nlohmann::json its{
            {"what", what}, {"n", n}, {"server_ready_s", static_cast<double>(nowNs() - begin) / 1e9}};
        sleepUntil(nowNs() + 1'000'000'000);
        try {
            measure<There>(server, folder, n, its);
        } catch (const std::exception& problem) {
            // So many cannot be had here; what there is of the others counts. A server that ends is another
            // matter.
            if (interrupted) throw;
            its["not_measured"] = problem.what();
        }
        if (interrupted) return;
        if (const auto ended = whichHasEnded({{"axon-server", &server.process()}}); !ended.empty())
            its["ended"] = ended;
        if (its["disconnected"].is_number() && its["disconnected"] > 0) sound_ = false;
        if (its.value("ended", std::string()) != "") sound_ = false;
        say(its);
        report_.add(std::move(its));
    }

    template <class There>
    void measure(const AxonServer& server, const std::filesystem::path& folder, std::size_t n,
                 nlohmann::json& its) {
        const auto pid = server.process().pid();
        const auto empty = useOf(pid);
        its["empty_own_kb"] = empty.own_kb;
        const auto begin = nowNs();
        There there(server, folder, n);
        its["all_there_s"] = static_cast<double>(nowNs() - begin) / 1e9;
        const auto settled = [&] {
            return nowNs() + static_cast<std::int64_t>(std::min(wish_.seconds, 3.0) * 1e9);
        };  // what joining or beginning has stirred up
        const auto take = [&](nlohmann::json& to, const auto& work) {
            to["cpu_share"] = cpuShare(pid, wish_.seconds, work);
            const auto use = useOf(pid);
            to["own_kb"] = use.own_kb;
            to["resident_kb"] = use.resident_kb;
            to["threads"] = use.threads;
            to["kb_each"] = static_cast<double>(use.own_kb - empty.own_kb) / static_cast<double>(n);
        };
        sleepUntil(settled());
        take(its["idle"], [](std::int64_t until) { sleepUntil(until); });
        there.begin();
        there.work(settled());
        const auto before = there.arrived();
        take(its["active"], [&](std::int64_t until) { there.work(until); });
        // Of those that were due in this time, one more or less for each.
        const auto due = static_cast<std::size_t>(wish_.seconds * 1e9 / kPeriod_ns) * n,
                   arrived = there.arrived() - before;
        its["active"]["due"] = due;
        its["active"]["arrived"] = arrived;
        if (arrived + n < due && !interrupted) sound_ = false;
        its["disconnected"] = there.disconnected();
        its["ended"] = there.ended();
    }

    static void say(const nlohmann::json& its) {
        progress("");
        const auto what = its["what"].get<std::string>();
        const auto n = its["n"].get<std::size_t>();
        if (its.contains("active")) {
            std::printf("%9s %9zu %9.3f %12.3f", what.c_str(), n, its["server_ready_s"].get<double>(),
                        its["all_there_s"].get<double>());
            for (const auto* key : {"idle", "active"})
                std::printf(
                    " | %10.1f %9.1f %9.2f",
                    static_cast<double>(its[key]["own_kb"].get<long>() - its["empty_own_kb"].get<long>()) /
                        1024,
                    its[key]["kb_each"].get<double>(), its[key]["cpu_share"].get<double>() * 100);
            std::printf(" | %8ld\n", its["active"]["threads"].get<long>());
            if (const auto due = its["active"]["due"].get<std::size_t>(),
                arrived = its["active"]["arrived"].get<std::size_t>();
                arrived + n < due)
                std::printf("%9s %9zu: OF %zu MESSAGES THAT WERE DUE ONLY %zu ARRIVED.\n", what.c_str(), n,
                            due, arrived);
        } else {
            std::printf("%9s %9zu is not measured: %s\n", what.c_str(), n,
                        its.value("not_measured", std::string()).c_str());
        }
        if (its.contains("disconnected") && its["disconnected"] > 0)
            std::printf("%9s %9zu: %llu TIMES ONE OF THEM LOST ITS CONNECTION.\n", what.c_str(), n,
                        its["disconnected"].get<unsigned long long>());
        if (its.value("ended", std::string()) != "")
            std::printf("%9s %9zu: %s\n", what.c_str(), n, its["ended"].get<std::string>().c_str());
        std::fflush(stdout);
    }

    const Wish& wish_;
    Report& report_;
    const WorkFolder work_;
    bool sound_ = true;
};

int run(const Wish& wish) {
    Report report(wish.json, "growth",
                  {{"entities", wish.entities}, {"clients", wish.clients}, {"seconds", wish.seconds}});
    reportPeers(report, {});
    Growth growth(wish, report);
    carryOut([&] { growth.run(); });
    return conclude(report,
                    growth.sound() ? "" : "SOMETHING OF AXON'S WAS LOST OR DISCONNECTED, OR HAS ENDED.");
}

}  // namespace

Experiment declareGrowth(CLI::App& app) {
    const auto wish = std::make_shared<Wish>();
    auto* command = app.add_subcommand(
        "growth", "Memory and processor time of the server per entity and client, idle and active");
    command->footer(
        "Examples:\n  axon-bench growth --json growth.json\n  axon-bench growth --entities 5000 --clients "
        "0\n");
    command
        ->add_option("--entities", wish->entities,
                     "Numbers of entities, each with a server of its own [64,512,2048,5000]; 0 = none")
        ->delimiter(',')
        ->check(CLI::Range(0, 16384).description(""))
        ->type_name("N,…");
    command
        ->add_option("--clients", wish->clients,
                     "Numbers of clients, each with a server of its own [64,512,2048]; 0 = none")
        ->delimiter(',')
        ->check(CLI::Range(0, 4096).description(""))
        ->type_name("M,…");
    command
        ->add_option("--seconds", wish->seconds,
                     "Seconds over which processor time is measured, idle and active [10]")
        ->check(CLI::Range(0.5, 1e5).description(""))
        ->type_name("S");
    command
        ->add_option("--json", wish->json,
                     "Write the results, with a description of the machine, to this file (JSON)")
        ->type_name("FILE");
    return {command, [wish] {
                std::erase(wish->entities, 0U);
                std::erase(wish->clients, 0U);
                return run(*wish);
            }};
}

}  // namespace axon::bench
