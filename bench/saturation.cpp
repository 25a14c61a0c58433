// SPDX-License-Identifier: GPL-2.0-or-later
#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <memory>
#include <optional>
#include <thread>

#include "contender.hpp"
#include "experiment.hpp"
#include "mosquitto_peer.hpp"
#include "report.hpp"
#include "streams.hpp"
#include "transport/ice/communicator.hpp"

// How long a stop takes while others take data as fast as they can and a tenth of them has stopped reading.
// Method: docs/reference/benchmarks.md.

namespace axon::bench {

namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kPeriod_ns = 50'000'000;
constexpr int kWarmUp = 20;
/// With the warm-up, and the patience for the last ones, less than the ten seconds in which the watchdog of
/// an idle entity lets the server be silent: those that are halted are there all the time.
constexpr double kSecondsAtMost = 6;

struct Wish {
    std::size_t entities = 20;
    double seconds = 6;
    int rounds = 3;
    std::string json;
};

/// The load and the target, of one system.
class Scene {
  public:
    virtual ~Scene() = default;
    virtual Contender& target() = 0;
    /// Those that read, those that are to stop reading.
    virtual Board& readers() = 0;
    virtual Board& stalled() = 0;
    virtual const Child& stalledProcess() = 0;
    virtual StreamBoard& stream() = 0;
    /// As Subject::ended(), of all but the target.
    virtual std::string ended() = 0;

    std::uint64_t received() {
        std::uint64_t sum = 0;
        for (auto* board : {&readers(), &stalled()})
            for (std::size_t i = 0; i < board->size(); ++i) sum += (*board)[i].intact;
        return sum;
    }
    /// At those that read.
    std::uint64_t gaps() {
        std::uint64_t sum = 0;
        for (std::size_t i = 0; i < readers().size(); ++i) sum += readers()[i].misplaced;
        return sum;
    }
    std::uint64_t corrupt() {
        std::uint64_t sum = 0;
        for (auto* board : {&readers(), &stalled()})
            for (std::size_t i = 0; i < board->size(); ++i) sum += (*board)[i].corrupt;
        return sum + target().corrupt();
    }
};

class AxonScene final : public Scene {
  public:
    AxonScene(const fs::path& folder, std::size_t readers, std::size_t stalled)
        : server_(folder),
          readers_(folder, "reader", readers, server_.entityAddress()),
          stalled_(folder, "stalled", stalled, server_.entityAddress()),
          target_("axon", axonOf(server_, folder, "target", 1, Variant::Relayed)),
          stream_((folder / "stream.board").string(), 1, true),
          streamer_(ourselves("axon-stream", {(folder / "stream.board").string(), server_.clientAddress(),
                                              std::to_string(readers), std::to_string(stalled)}),
                    folder / "stream.log") {
        streamer_.waitUntil([this] { return stream_.ready() > 0; }, "the sender of data did not start",
                            std::chrono::seconds{60});
    }
    Contender& target() override { return target_; }
    Board& readers() override { return readers_.board(); }
    Board& stalled() override { return stalled_.board(); }
    const Child& stalledProcess() override { return stalled_.process(); }
    StreamBoard& stream() override { return stream_; }
    std::string ended() override {
        return whichHasEnded({{"axon-server", &server_.process()},
                              {"the readers' process", &readers_.process()},
                              {"the sender of data", &streamer_}});
    }

  private:
    AxonServer server_;
    Entities readers_, stalled_;
    Contender target_;
    StreamBoard stream_;
    Child streamer_;
};

/// One receiver of a broker that has others.
class MosquittoTarget final : public Subject {
  public:
    MosquittoTarget(const fs::path& folder, const MosquittoBroker& broker, std::size_t topic)
        : topic_(topic),
          board_((folder / "target.board").string(), 1, true),
          receiver_(
              ourselves("mosquitto-receivers", {(folder / "target.board").string(), "1",
                                                std::to_string(broker.port()), "0", std::to_string(topic)}),
              folder / "target.log") {
        receiver_.waitUntil([this] { return board_.ready() > 0; }, "mosquitto's receiver did not start",
                            std::chrono::seconds{60});
        sender_ = std::make_unique<MosquittoSender>(broker.port(), 0);
    }
    Board& board() override { return board_; }
    void send(Message message, const std::string& bytes, std::vector<std::int64_t>& called) override {
        called[0] = nowNs();
        sender_->send(topic_, kindOf(message), bytes);
    }
    std::string ended() const override { return whichHasEnded({{"the receiver's process", &receiver_}}); }

  private:
    std::size_t topic_;
    Board board_;
    Child receiver_;
    std::unique_ptr<MosquittoSender> sender_;
};

class MosquittoScene final : public Scene {
  public:
    MosquittoScene(const fs::path& folder, std::size_t readers, std::size_t stalled)
        : broker_(folder, true),
          readers_((folder / "readers.board").string(), readers, true),
          stalled_((folder / "stalled.board").string(), stalled, true),
          readers_process_(receivers(folder, "readers", readers, 0)),
          stalled_process_(receivers(folder, "stalled", stalled, readers)),
          target_("mosquitto-qos0", std::make_unique<MosquittoTarget>(folder, broker_, readers + stalled)),
          stream_((folder / "stream.board").string(), 1, true),
          streamer_(ourselves("mosquitto-stream",
                              {(folder / "stream.board").string(), std::to_string(broker_.port()),
                               std::to_string(readers + stalled)}),
                    folder / "stream.log") {
        streamer_.waitUntil(
            [this] {
                return stream_.ready() > 0 && readers_.ready() >= readers_.size() &&
                       stalled_.ready() >= stalled_.size();
            },
            "mosquitto's clients did not start", std::chrono::seconds{60});
    }
    Contender& target() override { return target_; }
    Board& readers() override { return readers_; }
    Board& stalled() override { return stalled_; }
    const Child& stalledProcess() override { return stalled_process_; }
    StreamBoard& stream() override { return stream_; }
    std::string ended() override {
        return whichHasEnded({{"mosquitto", &broker_.process()},
                              {"the readers' process", &readers_process_},
                              {"the sender of data", &streamer_}});
    }

  private:
    Child receivers(const fs::path& folder, const std::string& name, std::size_t n, std::size_t first) {
        return {
            ourselves("mosquitto-receivers", {(folder / (name + ".board")).string(), std::to_string(n),
                                              std::to_string(broker_.port()), "0", std::to_string(first)}),
            folder / (name + ".log")};
    }

    MosquittoBroker broker_;
    Board readers_, stalled_;
    Child readers_process_, stalled_process_;
    Contender target_;
    StreamBoard stream_;
    Child streamer_;
};

/// Of the thread that stops, whichever system it is: who stops in earnest has its own thread scheduled like
/// the rest of the lane, and one that waits for the processor would measure nothing else. Nothing where it is
/// not permitted; what it starts meanwhile is ordinary.
class StopperPriority {
  public:
    StopperPriority() { become(SCHED_RR, transport::kStopPriority); }
    ~StopperPriority() { become(SCHED_OTHER, 0); }
    StopperPriority(const StopperPriority&) = delete;
    StopperPriority& operator=(const StopperPriority&) = delete;

  private:
    static void become(int policy, int priority) {
        sched_param wish{};
        wish.sched_priority = priority;
        ::sched_setscheduler(0, policy | SCHED_RESET_ON_FORK, &wish);
    }
};

struct Measured {
    std::vector<Figures> idle{{0, 1, {}, {}}}, loaded{{0, 1, {}, {}}};
    double loaded_seconds = 0;
    std::uint64_t received = 0, sent = 0, refused = 0, gaps = 0, corrupt = 0;
    std::string ended;
};

void measure(Scene& scene, const Wish& wish, int round, Measured& to) {
    auto bytes = content(bytesOf(Message::Stop));
    const Pace pace{kPeriod_ns, std::max(1, static_cast<int>(wish.seconds * 1e9 / kPeriod_ns)), kWarmUp, 0};
    const auto say = [&](const char* what) {
        progress("saturation: " + scene.target().name + ": " + what + ", round " + std::to_string(round + 1) +
                 " of " + std::to_string(wish.rounds));
    };
    const StopperPriority stopper;
    say("idle");
    measurePaced(scene.target(), Message::Stop, bytes, pace, to.idle);
    if (interrupted) return;
    say("loaded");
    ::kill(scene.stalledProcess().pid(), SIGSTOP);
    scene.stream().go() = 1;
    const auto begin = nowNs();
    const auto before = scene.received();
    measurePaced(scene.target(), Message::Stop, bytes, pace, to.loaded);
    to.received += scene.received() - before;
    to.loaded_seconds += static_cast<double>(nowNs() - begin) / 1e9;
    scene.stream().go() = 0;
    sleepUntil(nowNs() + 500'000'000);  // what waits for the readers reaches them
    to.sent += scene.stream()[0].sent;
    to.refused += scene.stream()[0].refused;
    to.gaps += scene.gaps();
    to.corrupt += scene.corrupt();
    if (to.ended.empty()) to.ended = scene.ended();
    if (to.ended.empty()) to.ended = scene.target().ended();
}

int run(const Wish& wish) {
    Report report(wish.json, "saturation",
                  {{"entities", wish.entities},
                   {"seconds", wish.seconds},
                   {"rounds", wish.rounds},
                   {"period_ms", kPeriod_ns / 1e6},
                   {"warm_up", kWarmUp},
                   {"bytes", kDataBytes}});
    const auto stalled = std::max<std::size_t>(1, wish.entities / 10);
    const auto readers = wish.entities > stalled ? wish.entities - stalled : 1;
    const WorkFolder work;
    const bool mosquitto = !findProgram("mosquitto").empty();
    std::vector<std::pair<std::string, Measured>> systems;
    systems.emplace_back("axon", Measured{});
    if (mosquitto) systems.emplace_back("mosquitto-qos0", Measured{});
    reportPeers(report, {"mosquitto-qos0"});
    carryOut([&] {
        // A scene of its own for each round: those that are halted were there when it began. One at a time,
        // the systems in turns.
        for (int round = 0; round < wish.rounds && !interrupted; ++round)
            for (std::size_t k = 0; k < systems.size() && !interrupted; ++k) {
                auto& [name, its] = systems[(k + static_cast<std::size_t>(round)) % systems.size()];
                progress("saturation: starting " + name);
                const auto folder = work.sub(name + "-" + std::to_string(round));
                std::unique_ptr<Scene> scene;
                if (name == "axon") {
                    scene = std::make_unique<AxonScene>(folder, readers, stalled);
                } else {
                    scene = std::make_unique<MosquittoScene>(folder, readers, stalled);
                }
                measure(*scene, wish, round, its);
            }
    });
    std::printf(
        "A stop every 50 ms to one entity, while %zu others take data as fast as they can and %zu more have "
        "stopped reading; ms from when it was due.\n",
        readers, stalled);
    std::printf("%-15s %-7s %7s %9s %9s %9s %9s %6s %9s %6s\n", "", "", "n", "mean", "p50", "p99", "max",
                "lost", "MB/s", "gaps");
    bool sound = true;
    for (auto& [name, its] : systems) {
        const double rate = its.loaded_seconds > 0
                                ? static_cast<double>(its.received) * kDataBytes / its.loaded_seconds / 1e6
                                : 0;
        const auto idle = its.idle[0].from_batch.json(), loaded = its.loaded[0].from_batch.json();
        for (const auto& [what, figures] : {std::pair{"idle", &idle}, std::pair{"loaded", &loaded}}) {
            std::printf("%-15s %-7s %7zu %s %s %s %s %6zu", name.c_str(), what,
                        (*figures)["n"].get<std::size_t>(), figure(*figures, "mean").c_str(),
                        figure(*figures, "p50").c_str(), figure(*figures, "p99").c_str(),
                        figure(*figures, "max").c_str(), (*figures)["lost"].get<std::size_t>());
            if (figures == &loaded)
                std::printf(" %9.1f %6llu", rate, static_cast<unsigned long long>(its.gaps));
            std::printf("\n");
        }
        nlohmann::json row{{"system", name},
                           {"idle", idle},
                           {"loaded", loaded},
                           {"idle_from_call", its.idle[0].from_call.json()},
                           {"loaded_from_call", its.loaded[0].from_call.json()},
                           {"mb_per_s", rate},
                           {"loaded_seconds", its.loaded_seconds},
                           {"sent", its.sent},
                           {"arrived", its.received},
                           {"refused", its.refused},
                           {"gaps_of_readers", its.gaps},
                           {"corrupt", its.corrupt}};
        if (idle.contains("p99") && loaded.contains("p99") && idle["p99"].is_number() &&
            loaded["p99"].is_number()) {
            row["p99_loaded_by_idle"] = loaded["p99"].get<double>() / idle["p99"].get<double>();
            std::printf("%-15s p99 loaded / idle: %.2f\n", "", row["p99_loaded_by_idle"].get<double>());
        }
        if (!its.ended.empty()) {
            row["ended"] = its.ended;
            std::printf("%-15s %s. What was sent to it from then on is lost.\n", name.c_str(),
                        its.ended.c_str());
        }
        if (name == "axon")
            sound = its.corrupt == 0 && its.ended.empty() && idle["lost"] == 0 && loaded["lost"] == 0;
        report.add(std::move(row));
    }
    return conclude(report, sound ? "" : "SOMETHING OF AXON'S WAS LOST OR CORRUPT.");
}

}  // namespace

Experiment declareSaturation(CLI::App& app) {
    const auto wish = std::make_shared<Wish>();
    auto* command = app.add_subcommand(
        "saturation", "Latency of a stop, idle and while others take data as fast as they can");
    command->footer(
        "A tenth of the entities (at least one) has stopped reading: their processes are suspended. Data and "
        "stops come from two processes. The\nentity that is stopped has a process of its own, as a robot has "
        "a computer of its own.\n\nExample:\n  axon-bench saturation --entities 20 --rounds 10 --json "
        "saturation.json\n");
    command->add_option("--entities", wish->entities, "Number of entities that take data [20]")
        ->check(CLI::Range(2, 1024).description(""))
        ->type_name("S");
    command
        ->add_option("--seconds", wish->seconds,
                     "Seconds idle, and then loaded, in each round; at most 6, so that no entity is given up "
                     "in that time [6]")
        ->check(CLI::Range(0.2, kSecondsAtMost).description(""))
        ->type_name("S");
    command
        ->add_option("--rounds", wish->rounds,
                     "Number of rounds, the systems in turns, each round with newly started programs [3]")
        ->check(CLI::Range(1, 1000).description(""))
        ->type_name("COUNT");
    command
        ->add_option("--json", wish->json,
                     "Write the results, with a description of the machine, to this file (JSON)")
        ->type_name("FILE");
    return {command, [wish] { return run(*wish); }};
}

}  // namespace axon::bench
