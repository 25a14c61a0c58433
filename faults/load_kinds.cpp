// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <deque>
#include <optional>
#include <stdexcept>
#include <thread>

#include "entity_interfacer/axon/entity_interfacer.hpp"
#include "kinds.hpp"
#include "load.hpp"
#include "raw_client.hpp"
#include "transport/ice/communicator.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;

constexpr double kBound_ms = 350;
constexpr double kNever_ms = 3000;
constexpr auto kPeriod = 25ms;
/// Shorter than the ten seconds after which a peer that says nothing is given up: who has stopped reading
/// stays there.
constexpr auto kStalledFor = 8s;
constexpr auto kReadsFor = 1500ms;
constexpr auto kStart = 300s;

/// A client for each robot, each sending as fast as its robot takes it; the last tenth of the robots stops
/// reading. Meanwhile a client stops one healthy robot after the other.
class Saturation {
  public:
    explicit Saturation(Run& run)
        : run_(run),
          lab_(run.lab),
          board_(run.lab.board()),
          healthy_(run.lab.lastTenth()),
          seen_(healthy_, 0) {
        if (healthy_ == 0)
            throw std::runtime_error(
                "saturate: found 1 robot; expected at least 2, one of which stops reading; fix: --entities 2 "
                "or more");
    }

    void carryOut() {
        start();
        RawClient stopper(lab_.clientAddress(), "stopper@faults");
        for (std::size_t i = 0; i < board_.size(); ++i) {
            ids_.push_back(stopper.entity(robotName(i), 20s));
            if (ids_.back().empty()) throw std::runtime_error(robotName(i) + " did not become available");
        }
        std::vector<Counts> before;
        for (std::size_t i = 0; i < board_.size(); ++i) before.push_back(countsOf(i));
        const auto begin = nowNs();
        board_.desk().load = 1;
        std::this_thread::sleep_for(500ms);  // the load comes up
        // As the rest of the signal lane; a thread of its own, because children inherit what the main one is.
        std::thread([&] {
            transport::requestRealTime(transport::kStopPriority);
            stops(stopper);
        }).join();
        board_.desk().load = 0;
        const double seconds = static_cast<double>(nowNs() - begin) / 1e9;
        judge(before, seconds);
        if (!stopper.connected()) run_.report.violation("the client that stops was dropped");
        comeBack(stopper);
        lab_.endLoad();
    }

  private:
    struct Counts {
        std::uint32_t received, sent, refused, disconnected, leases_lost, left;
    };
    struct Open {
        std::size_t robot;
        std::uint32_t before;
        std::int64_t at;
    };

    Counts countsOf(std::size_t i) {
        const auto& slot = board_[i];
        return {slot.received, slot.sent, slot.refused, slot.disconnected, slot.leases_lost, slot.left};
    }

    void start() {
        lab_.endClient();
        lab_.startAll();
        lab_.startLoad();
        const auto all = [&] { return board_.desk().loaders == board_.size() || !lab_.load().running(); };
        if (!waitUntil(all, kStart) || !lab_.load().running()) {
            lab_.keepLogs();
            throw std::runtime_error("only " + std::to_string(board_.desk().loaders) + " of " +
                                     std::to_string(board_.size()) +
                                     " clients hold their robot; the logs are in " + lab_.folder().string());
        }
    }

    void stops(RawClient& stopper) {
        for (std::size_t i = 0; i < healthy_; ++i) seen_[i] = board_[i].stops;
        bool stalled = false;
        auto turn_at = std::chrono::steady_clock::now();
        auto due = turn_at;
        while (run_.goOn()) {
            if (due >= turn_at) {
                stalled = !stalled;
                for (auto* process : lab_.managersOfLastTenth())
                    stalled ? process->freeze() : process->thaw();
                turn_at = due + (stalled ? std::chrono::milliseconds(kStalledFor) : kReadsFor);
            }
            std::this_thread::sleep_until(due);
            due += kPeriod;
            collect();
            const auto chosen = nextRobot();
            if (!chosen) continue;  // each waits for its stop: what is missing is counted when its time is up
            const auto i = *chosen;
            open_.push_back({i, board_[i].stops, nowNs()});
            stopper.stop(ids_[i]);
            ++run_.report.trials;
        }
        const auto patience = std::chrono::milliseconds(static_cast<int>(kBound_ms + kNever_ms));
        waitUntil(
            [this] {
                collect();
                return open_.empty();
            },
            patience + 100ms);
        if (stalled)
            for (auto* process : lab_.managersOfLastTenth()) process->thaw();
    }

    /// One that has no stop under way, so that each callback belongs to one order.
    std::optional<std::size_t> nextRobot() {
        const auto first = static_cast<std::size_t>(run_.among(0, healthy_ - 1));
        for (std::size_t k = 0; k < healthy_; ++k) {
            const auto i = (first + k) % healthy_;
            if (std::none_of(open_.begin(), open_.end(), [i](const Open& one) { return one.robot == i; }))
                return i;
        }
        return std::nullopt;
    }

    /// Whoever is stopped by anything but an order of ours was dropped. One order may call back twice: again
    /// when a callback that was inside has returned.
    void lookAtCauses() {
        for (std::size_t i = 0; i < healthy_; ++i) {
            const auto& slot = board_[i];
            const std::uint32_t stops = slot.stops;
            for (; seen_[i] != stops; ++seen_[i]) {
                const std::uint32_t number = slot.marks[seen_[i] % Slot::kMarks].cause;
                const auto cause = static_cast<StopSignal::Cause>(number);
                const std::string name = toString(cause);
                ++run_.report.causes[name];
                if (cause != StopSignal::Cause::Requested)
                    run_.report.violation(robotName(i) + ", which reads, was stopped: " + name);
            }
        }
    }

    void collect() {
        lookAtCauses();
        const auto now = nowNs();
        std::erase_if(open_, [&](const Open& one) {
            const auto* stop = board_[one.robot].firstStop(one.before, one.at);
            if (!stop) {
                if (static_cast<double>(now - one.at) / 1e6 < kBound_ms + kNever_ms) return false;
                run_.report.latency.addNever();
                lab_.keepLogs();
                return true;
            }
            const auto at = stop->at.load();
            const double ms = static_cast<double>(at - one.at) / 1e6;
            run_.report.latency.add(ms);
            const auto host = static_cast<double>(lab_.probe().overlap(one.at, at)) / 1e6;
            if (host > 0) ++run_.report.trials_beside_stall;
            if (ms > kBound_ms) {
                ++run_.report.late;
                run_.report.late_beside_stall += ms - host <= kBound_ms ? 1 : 0;
            }
            return true;
        });
    }

    void judge(const std::vector<Counts>& before, double seconds) {
        auto& report = run_.report;
        std::uint64_t received = 0, sent = 0, refused = 0, given_up = 0, least = UINT64_MAX;
        for (std::size_t i = 0; i < board_.size(); ++i) {
            const auto now = countsOf(i);
            const auto& then = before[i];
            sent += now.sent - then.sent;
            refused += now.refused - then.refused;
            // A client is healthy whatever its robot does.
            if (now.disconnected != then.disconnected)
                report.violation("the client of " + robotName(i) + " was dropped");
            if (i >= healthy_) {
                given_up += now.left - then.left;
                continue;
            }
            received += now.received - then.received;
            least = std::min<std::uint64_t>(least, now.received - then.received);
            if (now.left != then.left) report.violation(robotName(i) + ", which reads, was dropped");
            if (now.leases_lost != then.leases_lost)
                report.violation("the lease of " + robotName(i) + ", which reads, was lost");
            if (now.received == then.received)
                report.violation(robotName(i) + ", which reads, received nothing");
        }
        report.counts["clients"] = board_.size();
        report.counts["robots that stop reading"] = board_.size() - healthy_;
        report.counts["of these, times given up"] = given_up;
        report.counts["batches sent"] = sent;
        report.counts["batches refused to their sender"] = refused;
        report.counts["batches received by those that read"] = received;
        report.counts["batches received by the one that got least"] = least;
        report.counts["MB/s received"] =
            static_cast<std::size_t>(static_cast<double>(received) * kBatchBytes / seconds / 1e6);
        if (!report.violations.empty()) lab_.keepLogs();
    }

    /// Everybody, those that had stopped reading too.
    void comeBack(RawClient& stopper) {
        const auto all = [&] {
            return std::all_of(ids_.begin(), ids_.end(),
                               [&](const std::string& id) { return stopper.available(id); });
        };
        // With hundreds of robots what two cores could not carry meanwhile lies in the sockets, and is read
        // first.
        const auto begin = std::chrono::steady_clock::now();
        const bool back = waitUntil(all, 120s);
        run_.report.counts["seconds until everybody was back"] = static_cast<std::size_t>(
            std::chrono::ceil<std::chrono::seconds>(std::chrono::steady_clock::now() - begin).count());
        if (back) return;
        ++run_.report.not_recovered;
        lab_.keepLogs();
    }

    Run& run_;
    Laboratory& lab_;
    Board& board_;
    const std::size_t healthy_;        // those before it read
    std::vector<std::uint32_t> seen_;  // of its stops, those that were looked at
    std::vector<std::string> ids_;
    std::deque<Open> open_;
};

}  // namespace

std::vector<Kind> loadKinds() {
    std::vector<Kind> all;
    all.push_back(
        {"saturate",
         5,
         "a client for each robot sends batches of 35,137 bytes as fast as they are taken; a tenth of the "
         "robots stops reading; meanwhile one of the others is stopped every 25 ms",
         {.bound_ms = kBound_ms,
          .text = "nobody healthy is dropped; p99.9 within 20 ms, every stop within 350 ms",
          .p999_ms = 20},
         {.tenth_apart = true},
         "stops",
         2000,
         20,
         [](Run& run) { Saturation(run).carryOut(); }});
    return all;
}

}  // namespace axon::faults
