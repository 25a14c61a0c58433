// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <numeric>
#include <set>
#include <stdexcept>
#include <thread>

#include "entity_interfacer/axon/entity_interfacer.hpp"
#include "kinds.hpp"
#include "raw_client.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;
using Robots = std::vector<std::size_t>;

constexpr double kNever_ms = 3000;     // this long after the bound, what has not come will not come
constexpr double kKill_ms = 20;        // p99 of what the kernel tells at once
constexpr double kServerHop_ms = 350;  // watchdog of client and server hops, 250 ms, + 100 ms
constexpr double kLinkHop_ms = 350;    // watchdog of the link to the application, 250 ms, + 100 ms
constexpr int kPreparesMax = 20;
constexpr std::uint32_t kMoversMax = 64;

/// How a fault is brought about and taken back.
struct Fault {
    std::function<void(Run&, const Robots& victims)> inject;
    std::function<void(Run&, const Robots& victims)> heal;
    bool one_victim = false;  ///< each trial strikes one robot; else all of them
    bool told = false;        ///< measured is when the client was told, for the application is struck itself
    std::chrono::milliseconds thaw{0};   ///< so long after healing nothing may move
    std::function<void(Run&)> before{};  ///< what takes time and is not the fault
};

std::string causeName(std::uint32_t cause) {
    return toString(static_cast<StopSignal::Cause>(cause));
}

/// Of the robots that are to move, those that do not: they have stopped before the fault.
std::size_t standing(Board& board) {
    std::size_t count = 0;
    for (std::size_t i = 0; i < board.movers(); ++i) count += board[i].moving == 0 ? 1 : 0;
    return count;
}

/// Every robot moves, and the short watchdogs have been running for a while that differs from trial to trial,
/// so that faults fall on every phase of the heartbeats.
bool ready(Run& run) {
    for (int i = 0; i < kPreparesMax && !interrupted(); ++i) {
        if (!run.lab.prepare()) return false;
        std::this_thread::sleep_for(std::chrono::microseconds(run.among(60'000, 160'000)));
        const auto stood = standing(run.lab.board());
        if (stood == 0) return true;
        run.report.stopped_before += stood;
    }
    return false;
}

void trial(Run& run, const Fault& fault) {
    auto& board = run.lab.board();
    Robots victims(board.size());
    std::iota(victims.begin(), victims.end(), 0);
    if (fault.before) fault.before(run);
    if (fault.one_victim) victims = {static_cast<std::size_t>(run.among(0, board.size() - 1))};
    std::vector<std::uint32_t> stops(board.size()), starts(board.size());
    for (std::size_t i = 0; i < board.size(); ++i) {
        stops[i] = board[i].stops;
        starts[i] = board[i].starts;
        board[i].gone_at = 0;
    }

    const auto begin = nowNs();
    fault.inject(run, victims);
    const auto arrived = [&](std::size_t i) -> std::int64_t {
        if (fault.told) return board[i].gone_at;
        const auto* stop = board[i].firstStop(stops[i], begin);
        return stop ? stop->at.load() : 0;
    };
    const auto patience =
        std::chrono::milliseconds(static_cast<int>(run.report.promise.bound_ms + kNever_ms));
    waitUntil(
        [&] {
            return std::all_of(victims.begin(), victims.end(),
                               [&](std::size_t i) { return arrived(i) != 0; });
        },
        patience);
    std::this_thread::sleep_for(std::chrono::milliseconds(run.among(20, 60)));
    const auto end = nowNs();

    const auto stalled = run.lab.probe().overlap(begin, end);
    if (stalled > 0) ++run.report.trials_beside_stall;
    for (const auto i : victims) {
        const auto at = arrived(i);
        if (at == 0) {
            run.report.latency.addNever();
            run.lab.keepLogs();
            continue;
        }
        const double ms = static_cast<double>(at - begin) / 1e6;
        run.report.latency.add(ms);
        if (!fault.told) ++run.report.causes[causeName(board[i].firstStop(stops[i], begin)->cause)];
        if (ms <= run.report.promise.bound_ms) continue;
        ++run.report.late;
        if (ms - static_cast<double>(run.lab.probe().overlap(begin, at)) / 1e6 <= run.report.promise.bound_ms)
            ++run.report.late_beside_stall;
        else
            run.lab.keepLogs();
    }

    fault.heal(run, victims);
    std::this_thread::sleep_for(fault.thaw);
    const std::set<std::size_t> struck(victims.begin(), victims.end());
    std::size_t others = 0;
    for (std::size_t i = 0; i < board.size(); ++i) {
        run.report.moved_after_stop += board[i].starts - starts[i];
        if (!struck.contains(i) && board[i].stops != stops[i]) ++others;
    }
    if (others > 0) run.report.counts["robots stopped that the fault had not struck"] += others;
    ++run.report.trials;
}

void carryOut(Run& run, const Fault& fault) {
    while (run.goOn()) {
        if (!ready(run)) {
            if (interrupted()) return;
            run.lab.keepLogs();
            if (run.report.trials == 0)
                throw std::runtime_error("the robots did not begin to move; the logs are in " +
                                         run.lab.folder().string());
            ++run.report.not_recovered;
            run.lab.startAnew();
            if (!ready(run))
                throw std::runtime_error("nor after everything was started again; the logs are in " +
                                         run.lab.folder().string());
        }
        trial(run, fault);
    }
}

/// A client asks for a stop of everything while the cable between server and Entity Managers is bad. Whether
/// it arrives or the dead-man is first: the robots stop.
void stopOverBadCable(Run& run, const Impairment& how) {
    std::unique_ptr<RawClient> stopper;
    Fault fault;
    fault.before = [&](Run& now) {
        stopper = std::make_unique<RawClient>(now.lab.clientAddress(), "stopper@faults");
        auto impairment = how;
        impairment.seed = now.random.next();
        now.lab.relay().impair(Hop::Manager, impairment);
        // Some beats and reports are late already when it comes. Who has been stopped by that, was so without
        // reason.
        std::this_thread::sleep_for(std::chrono::microseconds(now.among(100'000, 400'000)));
        if (const auto stood = standing(now.lab.board()); stood > 0)
            now.report.violation(std::to_string(stood) + " robots stopped, and nobody had asked for it");
    };
    fault.inject = [&](Run&, const Robots&) { stopper->stop(""); };
    fault.heal = [](Run& now, const Robots&) { now.lab.relay().impair(Hop::Manager, {}); };
    fault.thaw = 50ms;
    carryOut(run, fault);
}

#ifdef AXON_FAULTS_SLOW_DISK
/// A client asks for a stop of everything while the disks of the Entity Managers take two seconds for each
/// operation. Before that every robot was rearmed and given a task, which has waited for its line in the
/// journal.
void stopBesideSlowDisk(Run& run) {
    std::unique_ptr<RawClient> stopper;
    Fault fault;
    fault.before = [&](Run& now) {
        stopper = std::make_unique<RawClient>(now.lab.clientAddress(), "stopper@faults");
        now.lab.slowDisk();
        std::this_thread::sleep_for(std::chrono::microseconds(now.among(100'000, 2'500'000)));
        if (const auto stood = standing(now.lab.board()); stood > 0)
            now.report.violation(std::to_string(stood) + " robots stopped, and nobody had asked for it");
    };
    fault.inject = [&](Run&, const Robots&) { stopper->stop(""); };
    fault.heal = [](Run&, const Robots&) {};
    fault.thaw = 50ms;
    carryOut(run, fault);
}
#endif

/// One order for everything. Beats of so many moving robots as there may be are more than two cores carry, so
/// that some of them stand; they are stopped all the same.
void stopEverything(Run& run) {
    std::unique_ptr<RawClient> stopper;
    Fault fault;
    fault.before = [&](Run& now) {
        if (!stopper || !stopper->connected())
            stopper = std::make_unique<RawClient>(now.lab.clientAddress(), "stopper@faults");
    };
    fault.inject = [&](Run&, const Robots&) { stopper->stop(""); };
    fault.heal = [](Run&, const Robots&) {};
    auto& desk = run.lab.board().desk();
    desk.movers = kMoversMax;
    carryOut(run, fault);
    desk.movers = 0;
}

/// Cables whose delay changes ten times a second.
void shake(Run& run) {
    for (const auto hop : {Hop::Client, Hop::Manager})
        run.lab.relay().delay(hop, std::chrono::milliseconds(run.among(0, 40)));
    run.lab.relay().delay(Hop::Link, std::chrono::milliseconds(run.among(0, 15)));
}

/// Nobody is struck; who stops, stops without a reason.
void watchForFalseTrips(Run& run, bool slow) {
    auto& board = run.lab.board();
    if (!ready(run))
        throw std::runtime_error("the robots did not begin to move; the logs are in " +
                                 run.lab.folder().string());
    run.report.stopped_before = 0;
    const auto begin = nowNs();
    const auto end = begin + static_cast<std::int64_t>(run.seconds * 1e9);
    std::vector<std::uint32_t> seen(board.size());
    for (std::size_t i = 0; i < board.size(); ++i) seen[i] = board[i].stops;
    while (!interrupted() && nowNs() < end) {
        std::this_thread::sleep_for(100ms);
        if (slow) shake(run);
        run.report.trials = static_cast<std::size_t>((nowNs() - begin) / 1'000'000'000);
        run.progress(run.report.trials, static_cast<std::size_t>(run.seconds));
        bool tripped = false;
        for (std::size_t i = 0; i < board.size(); ++i) {
            if (board[i].stops == seen[i]) continue;
            const auto* stop = board[i].firstStop(seen[i], begin);
            const auto at = stop ? stop->at.load() : nowNs();
            const auto cause = stop ? causeName(stop->cause) : "unknown";
            ++run.report.causes[cause];
            tripped = true;
            // The longest watchdog of a busy robot: a stall within it may be the reason.
            if (run.lab.probe().overlap(at - 350'000'000, at) > 0)
                ++run.report.counts["false trips beside a host stall"];
            else
                run.report.violation(robotName(i) + " stopped at " +
                                     std::to_string((at - begin) / 1'000'000) + " ms by " + cause);
            seen[i] = board[i].stops;
        }
        if (!tripped) continue;
        run.lab.keepLogs();
        if (!run.lab.prepare()) {
            ++run.report.not_recovered;
            return;
        }
        for (std::size_t i = 0; i < board.size(); ++i) seen[i] = board[i].stops;
    }
    for (const auto hop : {Hop::Client, Hop::Manager, Hop::Link}) run.lab.relay().delay(hop, 0ms);
    run.report.counts["robot seconds"] = run.report.trials * board.size();
}

}  // namespace

std::vector<Kind> stopKinds() {
    std::vector<Kind> all;
    const auto nothing = [](Run&, const Robots&) {};
    const auto add = [&all](std::string name, int trial_number, std::string what, Promise promise,
                            Needs needs, Fault fault) {
        all.push_back({std::move(name), trial_number, std::move(what), std::move(promise), needs,
                       fault.told ? "notices to the client" : "stops", 20, 1,
                       [fault = std::move(fault), needs](Run& run) {
                           auto& together = run.lab.board().desk().together;
                           together = needs.first_master ? 2 : needs.together ? 1 : 0;
                           carryOut(run, fault);
                           together = 0;
                       }});
    };
    const Promise server_hop{kServerHop_ms, 0, "every robot stops within 350 ms (watchdog + 100 ms)"};
    const Promise server_hop_told{kServerHop_ms, kKill_ms,
                                  "p99 within 20 ms, every robot stops within 350 ms"};
    const Promise link_hop{kLinkHop_ms, 0, "the robot stops within 350 ms (watchdog + 100 ms)"};
    const Promise link_hop_told{kLinkHop_ms, kKill_ms, "p99 within 20 ms, the robot stops within 350 ms"};
    const Promise client_told{
        kLinkHop_ms, 0, "the Entity Manager is UNAV and the client told within 350 ms (watchdog + 100 ms)"};

    // Trial 1: the cable of each hop.
    struct Cable {
        const char* name;
        const char* what;
        Hop hop;
        Needs needs;
        Promise silent, told;
    };
    const std::vector<Cable> cables = {
        {"client",
         "between client and server",
         Hop::Client,
         {.relay_clients = true},
         server_hop,
         server_hop_told},
        {"manager",
         "between server and Entity Manager",
         Hop::Manager,
         {.relay_managers = true},
         server_hop,
         server_hop_told},
        {"link",
         "between Entity Manager and application",
         Hop::Link,
         {.relay_links = true},
         link_hop,
         link_hop_told},
    };
    for (const auto& cable : cables) {
        const auto hop = cable.hop;
        const auto heal = [hop](Run& run, const Robots&) { run.lab.relay().heal(hop); };
        add(std::string("cut-") + cable.name, 1,
            std::string("the cable ") + cable.what + " is cut: bytes vanish, neither FIN nor RST",
            cable.silent, cable.needs,
            {[hop](Run& run, const Robots&) { run.lab.relay().cut(hop); }, heal, false, false, 100ms});
        add(std::string("stall-") + cable.name, 1,
            std::string("the cable ") + cable.what + " holds everything back, and lets it go later",
            cable.silent, cable.needs,
            {[hop](Run& run, const Robots&) { run.lab.relay().stall(hop); }, heal, false, false, 150ms});
        add(std::string("reset-") + cable.name, 1,
            std::string("every connection ") + cable.what + " is reset", cable.told, cable.needs,
            {[hop](Run& run, const Robots&) { run.lab.relay().reset(hop); }, nothing});
    }

    // Trial 2: the client.
    add("kill-client", 2, "kill -9 of the client", server_hop_told, {},
        {[](Run& run, const Robots&) { run.lab.client().kill(); },
         [](Run& run, const Robots&) { run.lab.client().reap(); }});
    add("freeze-client", 2, "SIGSTOP of the client", server_hop, {},
        {[](Run& run, const Robots&) { run.lab.client().freeze(); },
         [](Run& run, const Robots&) { run.lab.client().thaw(); }, false, false, 150ms});
    add("wedge-client", 2, "the client's event loop hangs: keep_running says no, or does not return",
        server_hop, {},
        {[](Run& run, const Robots&) {
             run.lab.board().desk().wedged = 1 + static_cast<std::uint32_t>(run.among(0, 1));
         },
         [](Run& run, const Robots&) { run.lab.board().desk().wedged = 0; }, false, false, 100ms});

    // Trial 3: the server.
    add("kill-server", 3, "kill -9 of the server", server_hop_told, {},
        {[](Run& run, const Robots&) { run.lab.server().kill(); },
         [](Run& run, const Robots&) { run.lab.server().reap(); }});
    add("freeze-server", 3, "SIGSTOP of the server", server_hop, {},
        {[](Run& run, const Robots&) { run.lab.server().freeze(); },
         [](Run& run, const Robots&) { run.lab.server().thaw(); }, false, false, 150ms});

    // Trial 4: Entity Manager and application.
    add("kill-manager", 4, "kill -9 of one Entity Manager", link_hop_told, {.daemons = true},
        {[](Run& run, const Robots& victims) { run.lab.manager(victims[0]).kill(); },
         [](Run& run, const Robots& victims) { run.lab.manager(victims[0]).reap(); }, true});
    add("freeze-manager", 4, "SIGSTOP of one Entity Manager", link_hop, {.daemons = true},
        {[](Run& run, const Robots& victims) { run.lab.manager(victims[0]).freeze(); },
         [](Run& run, const Robots& victims) { run.lab.manager(victims[0]).thaw(); }, true, false, 150ms});
    add("kill-application", 4, "kill -9 of the application of all robots", client_told, {},
        {[](Run& run, const Robots&) { run.lab.application().kill(); },
         [](Run& run, const Robots&) { run.lab.application().reap(); }, false, true});
    add("freeze-application", 4, "SIGSTOP of the application of all robots", client_told, {},
        {[](Run& run, const Robots&) { run.lab.application().freeze(); },
         [](Run& run, const Robots&) { run.lab.application().thaw(); }, false, true, 150ms});

    // Trial 6: everything at once.
    all.push_back({"stop-all",
                   6,
                   "a client stops every entity with one order; the first 64 robots move",
                   {kServerHop_ms, 0, "every robot stops within 350 ms of the order"},
                   {},
                   "stops",
                   20,
                   1,
                   stopEverything});

    // The master of a run: nobody else would tell its slaves.
    const Promise run_hop{kServerHop_ms, 0, "every robot of the run stops within 350 ms (watchdog + 100 ms)"};
    const auto master = [](Run& run) -> Child& { return run.lab.manager(run.lab.board().desk().master); };
    add("kill-master", kNoTrial,
        "kill -9 of the Entity Manager of a run's master, while every participant moves", run_hop,
        {.daemons = true, .together = true},
        {[master](Run& run, const Robots&) { master(run).kill(); },
         [master](Run& run, const Robots&) { master(run).reap(); }});
    add("freeze-master", kNoTrial, "SIGSTOP of the Entity Manager of a run's master", run_hop,
        {.daemons = true, .together = true},
        {[master](Run& run, const Robots&) { master(run).freeze(); },
         [master](Run& run, const Robots&) { master(run).thaw(); }, false, false, 150ms});
    add("cut-master", kNoTrial, "the cable between server and the Entity Manager of a run's master is cut",
        run_hop, {.relay_managers = true, .daemons = true, .together = true, .first_master = true},
        {[](Run& run, const Robots&) { run.lab.relay().cut(Hop::Master); },
         [](Run& run, const Robots&) { run.lab.relay().heal(Hop::Master); }, false, false, 100ms});

    // What a radio link does to TCP.
    const auto addBadCable = [&all](std::string name, std::string what, Impairment how) {
        all.push_back(
            {std::move(name),
             kNoTrial,
             std::move(what),
             {kServerHop_ms, 0, "every robot stops within 350 ms of a stop by a client, and none before"},
             {.relay_managers = true},
             "stops",
             20,
             1,
             [how](Run& run) { stopOverBadCable(run, how); }});
    };
    addBadCable(
        "loss",
        "the cable between server and Entity Managers loses 3 % of what it carries; as TCP shows it, in the "
        "relay: nothing is missing, but it is late by 10 to 20 ms and twice that each time it is lost again, "
        "150 ms at most, and all behind it waits (packets: axon-channel; longer silence: stall-manager)",
        {.piece = 1448, .lost = 0.03, .lost_again = 0.2, .retry = 20ms, .most = 150ms});
    addBadCable("reorder",
                "likewise the cable changes the order of packets; as TCP shows it, in the relay: the order "
                "is restored, but the stream comes in pieces of 1 to 64 bytes, each up to 5 ms late "
                "(packets: axon-channel)",
                {.piece = 64, .late = 5ms});

#ifdef AXON_FAULTS_SLOW_DISK
    all.push_back(
        {"slow-disk",
         kNoTrial,
         "every operation on the disks of the Entity Managers takes two seconds; tasks wait for their lines "
         "in the "
         "journal, and a client stops everything",
         {kServerHop_ms, kKill_ms,
          "99 of 100 robots stop within 20 ms of a stop by a client, all within 350 ms, and none before"},
         {.daemons = true, .slow_disk = true},
         "stops",
         20,
         1,
         stopBesideSlowDisk});
#endif

    const std::string what =
        "nothing is struck: for --seconds every robot moves, and whatever stops is a false trip";
    all.push_back({"steady", kNoTrial, what, {0, 0, "no robot stops"}, {}, "", 10, 2, [](Run& run) {
                       watchForFalseTrips(run, false);
                   }});
    all.push_back(
        {"steady-slow",
         kNoTrial,
         what + "; every cable delays, by up to 40 ms (to the application 15 ms), and changes its mind",
         {0, 0, "no robot stops"},
         {.relay_clients = true, .relay_managers = true, .relay_links = true},
         "",
         10,
         2,
         [](Run& run) { watchForFalseTrips(run, true); }});
    return all;
}

}  // namespace axon::faults
