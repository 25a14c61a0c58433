// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>
#include <stdexcept>

#include "contender.hpp"
#include "experiment.hpp"
#include "herd.hpp"
#include "picture.hpp"
#include "report.hpp"
#include "thesis_tables.hpp"

// The experiments of the thesis' chapter 5, its figures beside those of this machine. Method:
// docs/reference/benchmarks.md.

namespace axon::bench {

namespace {

constexpr std::int64_t kPeriod_ns = 500'000'000;
/// Not counted: caches, connections and the scheduler settle.
constexpr int kWarmUp = 3;
/// The systems take turns: so many turns for each, unless there is but one batch for each turn.
constexpr int kTurns = 2;

struct Wish {
    std::vector<std::string> tables{"5.1", "5.2", "5.3", "5.4"};
    std::vector<std::size_t> entities, clients;
    std::vector<std::string> with{"axon-direct", "axon-robots", "mosquitto-qos0", "raw"};
    double seconds = 20;
    std::size_t standard = kStandardEntities, robots = 512, paths = 256;
    std::vector<std::string> modes{"partitioned", "open"};
    std::string channel = "lan";
    std::string json, plot;
};

/// peers(), and Axon with robot applications.
std::vector<const Peer*> systems() {
    std::vector<const Peer*> all;
    for (const auto& peer : peers()) {
        if (!variantOf(peer.name) && all.back()->name == "axon-direct") all.push_back(&axonRobots());
        all.push_back(&peer);
    }
    return all;
}

void printHead(const ThesisTable& table) {
    std::printf("\nTable %s. %s. Latency in ms; from the start of each batch, every 500 ms.\n",
                std::string(table.number).c_str(), std::string(table.title).c_str());
    std::printf("%8s %10s %9s  %-24s %9s %9s %9s %9s %9s %5s %5s | %9s %9s | %9s %9s\n",
                table.many_clients ? "clients" : "entities", "thesis LAN", "WLAN", "", "mean", "p50", "p99",
                "p99.9", "max", "lost", "disc.", "from call", "p99", "callback", "p99");
}

void printRow(const ThesisTable& table, std::size_t count, const std::string& name,
              const nlohmann::json& its) {
    const auto thesis = table.row(count);
    const auto& batch = its.at("from_batch");
    const auto& call = its.at("from_call");
    const auto callback = its.value("at_callback", nlohmann::json::object());
    const auto old = [](bool there, double value) {
        char text[20] = "-";
        if (there) std::snprintf(text, sizeof(text), "%.1f", value);
        return std::string(text);
    };
    std::printf("%8zu %10s %9s  %-24s %s %s %s %s %s %5zu %5zu | %s %s | %s %s\n", count,
                old(thesis.has_value(), thesis ? thesis->lan_ms : 0).c_str(),
                old(thesis.has_value(), thesis ? thesis->wlan_ms : 0).c_str(), name.c_str(),
                figure(batch, "mean").c_str(), figure(batch, "p50").c_str(), figure(batch, "p99").c_str(),
                figure(batch, "p99.9").c_str(), figure(batch, "max").c_str(),
                batch.value("lost", std::size_t{0}), its.value("disconnected", std::size_t{0}),
                figure(call, "mean").c_str(), figure(call, "p99").c_str(), figure(callback, "mean").c_str(),
                figure(callback, "p99").c_str());
    std::fflush(stdout);
}

nlohmann::json rowOf(const ThesisTable& table, std::size_t count) {
    nlohmann::json row{{"table", table.number}, {table.many_clients ? "clients" : "entities", count}};
    if (const auto thesis = table.row(count))
        row["thesis"] = {{"lan_mean", thesis->lan_ms}, {"wlan_mean", thesis->wlan_ms}};
    return row;
}

class Chapter5 {
  public:
    Chapter5(const Wish& wish, Report& report, const Radio* radio)
        : wish_(wish),
          report_(report),
          radio_(radio),
          periods_(std::max(1, static_cast<int>(wish.seconds * 1e9 / kPeriod_ns))),
          turns_(periods_ > kTurns ? kTurns : 1) {}

    void run() {
        for (const auto& table : kThesisTables) {
            if (interrupted) return;
            if (std::find(wish_.tables.begin(), wish_.tables.end(), table.number) == wish_.tables.end())
                continue;
            printHead(table);
            auto counts = table.many_clients ? wish_.clients : wish_.entities;
            if (counts.empty())
                for (const auto& row : table.rows) counts.push_back(row.count);
            for (const auto count : counts) {
                if (interrupted) return;
                if (!table.many_clients) {
                    oneClient(table, count);
                    continue;
                }
                for (const auto& mode : wish_.modes)
                    if (!interrupted) manyClients(table, count, mode);
            }
        }
    }
    bool sound() const { return sound_; }

  private:
    /// What --with names, and Axon relayed, which is always there.
    bool takesPart(const std::string& name) const {
        return name == "axon" || std::find(wish_.with.begin(), wish_.with.end(), name) != wish_.with.end();
    }

    /// A system that this machine does not permit, or that fails to start, is no reason to measure no other.
    void notStarted(std::size_t count, const std::string& name, const std::exception& problem,
                    nlohmann::json& of) {
        if (interrupted) throw;
        progress("");
        std::printf("%8zu %s is not measured: %s\n", count, name.c_str(), problem.what());
        of["not_measured"] = problem.what();
        if (dynamic_cast<const NotPermitted*>(&problem) == nullptr) sound_ = false;
    }

    /// The systems take turns; what it is of each stands in the same place of the result.
    std::vector<std::vector<Figures>> measure(const ThesisTable& table, const std::string& what,
                                              const std::vector<std::unique_ptr<Contender>>& all) {
        const auto message = table.stop ? Message::Stop : Message::Data;
        auto bytes = content(bytesOf(message));
        std::vector<std::vector<Figures>> figures;
        for (const auto& one : all) figures.push_back(parts(*one));
        for (int turn = 0; turn < turns_ && !interrupted; ++turn, ++begins_)
            for (std::size_t i = 0; i < all.size() && !interrupted; ++i) {
                const auto k = (i + begins_) % all.size();  // another one begins each time
                progress("chapter5: table " + std::string(table.number) + ", " + what + ": " + all[k]->name +
                         ", turn " + std::to_string(turn + 1) + " of " + std::to_string(turns_));
                measurePaced(*all[k], message, bytes, {kPeriod_ns, periods_ / turns_, kWarmUp}, figures[k]);
            }
        progress("");
        return figures;
    }

    /// Tables 5.1 and 5.2. The peers do the same work in the same way, in turns. Axon's other variants come
    /// afterwards, each by itself: beside thousands of direct paths, each with beats of its own, the others
    /// would be measured under that load.
    void oneClient(const ThesisTable& table, std::size_t n) {
        auto row = rowOf(table, n);
        std::vector<const Peer*> in_turns;
        std::vector<std::vector<const Peer*>> groups;
        for (const auto* peer : systems()) {
            const auto variant = variantOf(peer->name);
            if (!takesPart(peer->name) || !peer->missing.empty() || (radio_ && !variant)) continue;
            if (variant && *variant != Variant::Relayed) {
                groups.push_back({peer});
            } else {
                in_turns.push_back(peer);
            }
        }
        groups.insert(groups.begin(), in_turns);
        for (const auto& group : groups)
            if (!interrupted) together(table, n, group, row);
        report_.add(std::move(row));
    }

    void together(const ThesisTable& table, std::size_t n, const std::vector<const Peer*>& group,
                  nlohmann::json& row) {
        const auto what = std::to_string(n) + " entities";
        std::vector<std::unique_ptr<Contender>> all;
        for (const auto* peer : group) {
            progress("chapter5: table " + std::string(table.number) + ", " + what + ": starting " +
                     peer->name);
            const auto folder =
                work_.sub(peer->name + "-" + std::string(table.number) + "-" + std::to_string(n));
            try {
                if (variantOf(peer->name) == Variant::Robots && n > wish_.robots)
                    throw NotPermitted("more entities than --robots");
                if (variantOf(peer->name) == Variant::Direct && n > wish_.paths)
                    throw NotPermitted("more entities than --paths");
                all.push_back(std::make_unique<Contender>(
                    peer->name, radio_ ? axonWithRadio(*radio_, folder, n, *variantOf(peer->name))
                                       : peer->start(folder, n)));
            } catch (const std::exception& problem) {
                notStarted(n, peer->name, problem, row[peer->name]);
            }
        }
        auto figures = measure(table, what, all);
        for (std::size_t k = 0; k < all.size(); ++k) {
            row[all[k]->name] = resultOf(*all[k], figures[k]);
            say(table, n, all[k]->name, figures[k], row);
            if (!all[k]->ended().empty())
                std::printf("%8zu %s: %s. What was sent to it from then on is lost.\n", n,
                            all[k]->name.c_str(), all[k]->ended().c_str());
            if (variantOf(all[k]->name)) judge(*all[k], figures[k].front());
        }
    }

    /// Tables 5.3 and 5.4: the standard entities partitioned among the standard clients under exclusive
    /// leases, as in normal operation, or open to all of them, as in the thesis. Each of Axon's variants has
    /// ten entities of its own that are measured, and a client; those whose turn it is not are idle.
    void manyClients(const ThesisTable& table, std::size_t clients, const std::string& mode) {
        auto row = rowOf(table, clients);
        row["mode"] = mode;
        try {
            measureBeside(table, clients, mode, row);
        } catch (const std::exception& problem) {
            notStarted(clients, "clients " + mode, problem, row);
        }
        report_.add(std::move(row));
    }

    void measureBeside(const ThesisTable& table, std::size_t clients, const std::string& mode,
                       nlohmann::json& row) {
        const bool open = mode == "open";
        const auto what = std::to_string(clients) + " clients, " + mode;
        const auto folder = work_.sub(mode + "-" + std::string(table.number) + "-" + std::to_string(clients));
        progress("chapter5: table " + std::string(table.number) + ", " + what + ": starting");
        AxonServer server(folder, radio_);
        Entities standard(folder, "standard", wish_.standard, server.entityAddress(), radio_,
                          open ? Variant::Open : Variant::Relayed);
        std::optional<Herd> herd;
        if (clients > 1) herd.emplace(folder, clients - 1, server, "standard", wish_.standard, open);
        std::vector<std::unique_ptr<Contender>> all;
        for (const auto* peer : systems())
            if (const auto variant = variantOf(peer->name); variant && takesPart(peer->name)) {
                try {
                    all.push_back(std::make_unique<Contender>(
                        peer->name,
                        axonOf(server, folder, "testing-" + peer->name, kTestingEntities, *variant)));
                } catch (const std::exception& problem) {
                    notStarted(clients, peer->name, problem, row[peer->name]);
                }
            }
        if (herd) herd->go();
        const auto began = nowNs();
        auto figures = measure(table, what, all);
        const auto passed = static_cast<double>(nowNs() - began);
        row["entities"] = wish_.standard + kTestingEntities * all.size();
        nlohmann::json others{{"entities", wish_.standard}, {"disconnected", 0}};
        // Of these the content only: each client numbers what was taken, and what it was refused may have
        // arrived.
        std::uint64_t corrupt = 0, arrived = 0;
        for (std::size_t i = 0; i < wish_.standard; ++i) {
            corrupt += standard.board()[i].corrupt;
            arrived += standard.board()[i].intact;
        }
        others["corrupt"] = corrupt;
        others["arrived"] = arrived;
        if (corrupt > 0) sound_ = false;
        for (const auto& ended : {whichHasEnded({{"axon-server", &server.process()}}), standard.ended(),
                                  herd ? herd->ended() : std::string()}) {
            if (ended.empty()) continue;
            std::printf("%8zu %s\n", clients, ended.c_str());
            others["ended"] = ended;
            sound_ = false;
        }
        if (herd) {
            const auto sums = herd->sums();
            // Each of their entities once in each period; what they are behind with is sent without a pause,
            // and the load is what it is.
            const auto due = std::llround(passed / static_cast<double>(kPeriod_ns) *
                                          static_cast<double>(wish_.standard * (open ? clients - 1 : 1)));
            others["clients"] = {{"due", due},
                                 {"data", sums.data},
                                 {"signals", sums.signals},
                                 {"refused", sums.refused},
                                 {"leases_lost", sums.leases_lost},
                                 {"without_entities",
                                  !open && clients - 1 > wish_.standard ? clients - 1 - wish_.standard : 0}};
            others["disconnected"] = sums.disconnected;
            const auto sent = sums.data + sums.signals;
            std::printf(
                "%8zu clients %s: the standard ones sent %llu of %lld messages that were due; of %llu with "
                "data %llu had arrived by then\n",
                clients, mode.c_str(), static_cast<unsigned long long>(sent), due,
                static_cast<unsigned long long>(sums.data), static_cast<unsigned long long>(arrived));
            if (sums.disconnected > 0 || sums.leases_lost > 0) sound_ = false;
        }
        for (std::size_t k = 0; k < all.size(); ++k) {
            auto its = resultOf(*all[k], figures[k]);
            its["disconnected"] =
                its["disconnected"].get<std::size_t>() + others["disconnected"].get<std::size_t>();
            if (!all[k]->ended().empty())
                std::printf("%8zu %s: %s\n", clients, all[k]->name.c_str(), all[k]->ended().c_str());
            row[all[k]->name] = std::move(its);
            say(table, clients, all[k]->name, figures[k], row, " " + mode);
            judge(*all[k], figures[k].front());
        }
        row["standard"] = std::move(others);
    }

    static nlohmann::json resultOf(Contender& of, std::vector<Figures>& figures) {
        auto its = figures.front().json();
        its["disconnected"] = of.subject().disconnected();
        its["corrupt_or_misplaced"] = of.bad();
        if (variantOf(of.name) == Variant::Direct) its["relayed"] = of.relayed;
        if (of.hasRobots()) its["corrupt_at_callback"] = of.corruptAtCallback();
        if (!of.ended().empty()) its["ended"] = of.ended();
        return its;
    }

    void judge(Contender& axon, const Figures& figures) {
        if (!axon.ended().empty() || axon.subject().disconnected() > 0 || (!radio_ && axon.relayed > 0))
            sound_ = false;
        if (axon.relayed > 0)
            std::printf("%8s %s: UP TO %zu WERE REACHED THROUGH THE SERVERS.\n", "", axon.name.c_str(),
                        axon.relayed);
        // Behind a radio link two seconds may pass; what is lost for good leaves a gap, which is misplaced.
        // At a callback content may be missing: the oldest data is dropped for an application that reads
        // slowly.
        if (axon.bad() > 0 || (axon.hasRobots() && axon.corruptAtCallback() > 0) ||
            (!radio_ && figures.from_batch.lost() > 0))
            sound_ = false;
    }

    /// All of them, and with a radio link the two halves.
    std::vector<Figures> parts(Contender& of) const {
        const auto n = of.board().size();
        std::vector<Figures> all{{0, n, {}, {}, {}}};
        if (radio_) {
            all.push_back({0, Entities::firstWireless(n), {}, {}, {}});
            all.push_back({Entities::firstWireless(n), n, {}, {}, {}});
        }
        return all;
    }

    static void say(const ThesisTable& table, std::size_t count, const std::string& name,
                    std::vector<Figures>& figures, nlohmann::json& row, const std::string& mode = {}) {
        printRow(table, count, name + mode, row[name]);
        for (std::size_t i = 1; i < figures.size(); ++i) {
            if (figures[i].from_batch.sent() == 0) continue;
            const auto half = name + (i == 1 ? " wired" : " wireless");
            row[half] = figures[i].json();
            printRow(table, count, half + mode, row[half]);
        }
    }

    const Wish& wish_;
    Report& report_;
    const Radio* const radio_;
    const int periods_, turns_;
    const WorkFolder work_;
    std::size_t begins_ = 0;
    bool sound_ = true;
};

int run(const Wish& wish) {
    // Before any thread.
    const auto radio = wish.channel == "wlan" ? std::make_unique<Radio>() : nullptr;
    Report report(wish.json, "chapter5",
                  {{"tables", wish.tables},
                   {"seconds", wish.seconds},
                   {"period_ms", 500},
                   {"warm_up", kWarmUp},
                   {"patience_s", 2},
                   {"channel", radio ? Radio::settings() : nlohmann::json("loopback")},
                   {"modes", wish.modes},
                   {"robots", wish.robots},
                   {"paths", wish.paths},
                   {"standard_entities", wish.standard},
                   {"testing_entities", kTestingEntities},
                   {"with", wish.with}});
    const auto compared = [&wish](const char* table) {
        return std::find(wish.tables.begin(), wish.tables.end(), table) != wish.tables.end();
    };
    reportPeers(report,
                !radio && (compared("5.1") || compared("5.2")) ? wish.with : std::vector<std::string>{});
    std::printf(
        "LAN and WLAN: average latency as the thesis printed it (a server of four cores at 2.66 GHz, real "
        "networks).\n"
        "The others: this machine, %s.\n",
        radio ? "half of the entities behind a channel that loses 2.2 % of the packets and takes 2 ms"
              : "all over loopback");
    Chapter5 chapter(wish, report, radio.get());
    carryOut([&] { chapter.run(); });
    const int status =
        conclude(report, chapter.sound() ? ""
                                         : "SOMETHING OF AXON'S WAS LOST, DISCONNECTED OR CORRUPT, OR WENT "
                                           "ANOTHER WAY, OR A SYSTEM DID NOT START.");
    if (!wish.plot.empty()) drawChapter5(report.all(), wish.plot);
    return status;
}

}  // namespace

Experiment declareChapter5(CLI::App& app) {
    const auto wish = std::make_shared<Wish>();
    auto* command = app.add_subcommand(
        "chapter5", "The four experiments of the thesis: its figures next to those of this machine");
    command->footer(
        "Tables:\n  5.1  one client, data to each of N entities every 500 ms      5.2  the same with a "
        "stop\n  5.3  M clients and 256 entities, of which ten are measured: data     5.4  the same with a "
        "stop\n\nExamples:\n  axon-bench chapter5 --table 5.2 --entities 1,64,256 --seconds 10\n  axon-bench "
        "chapter5 --table 5.4 --clients 1,16 --json clients.json --plot figure.png\nAll of it takes about "
        "two hours.\n");
    command->add_option("--table", wish->tables, "Tables to measure: 5.1, 5.2, 5.3, 5.4 [all]")
        ->delimiter(',')
        ->check(CLI::IsMember({"5.1", "5.2", "5.3", "5.4"}).description(""))
        ->type_name("TABLE,…");
    command->add_option("--entities", wish->entities, "Numbers of entities in 5.1 and 5.2 [1,2,4,…,2048]")
        ->delimiter(',')
        ->check(CLI::Range(1, 4096).description(""))
        ->type_name("N,…");
    command->add_option("--clients", wish->clients, "Numbers of clients in 5.3 and 5.4 [1,2,4,…,256]")
        ->delimiter(',')
        ->check(CLI::Range(1, 1024).description(""))
        ->type_name("M,…");
    command
        ->add_option("--channel", wish->channel,
                     "lan: all over loopback; wlan: half of the entities behind an emulated radio link, Axon "
                     "only; needs root or user namespaces, and /dev/net/tun [lan]")
        ->check(CLI::IsMember({"lan", "wlan"}).description(""))
        ->type_name("CHANNEL");
    command->add_option("--seconds", wish->seconds, "Duration of each row and system [20]")
        ->check(CLI::Range(0.5, 1e6).description(""))
        ->type_name("S");
    std::vector<std::string> names;
    for (const auto* peer : systems())
        if (peer->name != "axon") names.push_back(peer->name);
    names.emplace_back("none");
    command
        ->add_option(
            "--with", wish->with,
            "Besides Axon relayed: axon-direct (direct paths; in 5.3 and 5.4 to the ten that are "
            "measured), axon-robots (through the servers, to the callbacks of real Entity Interfacers) and, "
            "in 5.1 and 5.2, other systems: raw, mosquitto-qos0, mosquitto-qos1, nats; or none "
            "[axon-direct,axon-robots,mosquitto-qos0,raw]")
        ->delimiter(',')
        ->check(CLI::IsMember(names).description(""))
        ->type_name("SYSTEM,…");
    command
        ->add_option("--mode", wish->modes,
                     "Modes of 5.3 and 5.4: partitioned (one client holds each standard entity) and open "
                     "(all clients use every one, as in the thesis) [both]")
        ->delimiter(',')
        ->check(CLI::IsMember({"partitioned", "open"}).description(""))
        ->type_name("MODE,…");
    command
        ->add_option("--standard", wish->standard,
                     "Number of entities in 5.3 and 5.4 besides the ten that are measured [246]")
        ->check(CLI::Range(1, 4096).description(""))
        ->type_name("N");
    command
        ->add_option("--robots", wish->robots,
                     "Largest number of entities with axon-robots [512]; each has an application with three "
                     "threads that send heartbeats")
        ->check(CLI::Range(0, 4096).description(""))
        ->type_name("N");
    command
        ->add_option("--paths", wish->paths,
                     "Largest number of entities with axon-direct [256]; each path in use sends 20 "
                     "heartbeats a second in both directions")
        ->check(CLI::Range(0, 4096).description(""))
        ->type_name("N");
    command
        ->add_option("--json", wish->json,
                     "Write the results, with a description of the machine, to this file (JSON)")
        ->type_name("FILE");
    command
        ->add_option("--plot", wish->plot,
                     "Draw figures 5.1 to 5.4 with gnuplot (PNG); for several tables, their numbers are "
                     "added to the file name")
        ->type_name("FILE");
    return {command, [wish] { return run(*wish); }};
}

}  // namespace axon::bench
