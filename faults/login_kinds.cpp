// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <axon/client.hpp>
#include <memory>
#include <stdexcept>
#include <thread>

#include "host_probe.hpp"
#include "kinds.hpp"
#include "robots.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;

constexpr double kLogIn_ms = 500;
/// So often the robot that is stopped is put to work again: latched, it obeys a stop the same.
constexpr std::size_t kWorksAgain = 50;

void putToWork(Run& run) {
    if (run.lab.prepare()) return;
    ++run.report.not_recovered;
    run.lab.keepLogs();
    run.lab.startAnew();
    if (!run.lab.prepare())
        throw std::runtime_error("the robots did not begin to move; the logs are in " +
                                 run.lab.folder().string());
}

/// What `axon stop` does after its process has started: a client logs in, stops one robot, and leaves. The
/// others work.
void logInAndStop(Run& run) {
    auto& board = run.lab.board();
    run.report.busy = true;
    const Burners burners(std::max(1U, std::thread::hardware_concurrency()));
    const auto victim = board.size() - 1;
    double longest_ms = 0;
    std::uint32_t others = 0;
    const auto stopsOfOthers = [&] {
        std::uint32_t all = 0;
        for (std::size_t i = 0; i < victim; ++i) all += board[i].stops;
        return all;
    };
    for (std::uint32_t seen = stopsOfOthers(); run.goOn();) {
        if (run.report.trials % kWorksAgain == 0 || stopsOfOthers() != seen) {
            others += stopsOfOthers() - seen;
            putToWork(run);
            seen = stopsOfOthers();
        }
        std::this_thread::sleep_for(std::chrono::microseconds(run.among(0, 20'000)));
        const auto before = board[victim].stops.load();
        client::Options options;
        options.server = run.lab.clientAddress();
        options.display_name = "stopper@faults";
        options.reconnect = false;
        const auto begin = nowNs();
        const auto client = client::Client::connect(options);
        const auto logged_in_ms = static_cast<double>(nowNs() - begin) / 1e6;
        longest_ms = std::max(longest_ms, logged_in_ms);
        if (!client) {
            run.report.violation("a client could not log in within " +
                                 std::to_string(static_cast<int>(logged_in_ms)) +
                                 " ms: " + client.refusal().message);
        } else if (const auto stopped = client.value()->stop({robotName(victim)}, client::Seconds{5});
                   !stopped) {
            run.report.violation("a client that was in could not stop: " + stopped.refusal().message);
        }
        const auto* stop = board[victim].firstStop(before, begin);
        ++run.report.trials;
        const auto end = nowNs();
        const bool beside = run.lab.probe().overlap(begin, end) > 0;
        if (beside) ++run.report.trials_beside_stall;
        if (stop == nullptr) {
            run.report.latency.addNever();
            run.lab.keepLogs();
            continue;
        }
        const auto at = stop->at.load();
        const auto ms = static_cast<double>(at - begin) / 1e6;
        run.report.latency.add(ms);
        if (ms <= run.report.promise.bound_ms) continue;
        ++run.report.late;
        if (ms - static_cast<double>(run.lab.probe().overlap(begin, at)) / 1e6 <= run.report.promise.bound_ms)
            ++run.report.late_beside_stall;
    }
    run.report.counts["ms until the slowest was logged in"] = static_cast<std::size_t>(longest_ms);
    if (others > 0) run.report.counts["stops of robots that nobody had stopped"] = others;
}

}  // namespace

std::vector<Kind> loginKinds() {
    return {{"log-in",
             kNoTrial,
             "a client logs in and stops a robot, while the others work and every core computes at ordinary "
             "priority, with or without --busy",
             {kLogIn_ms, 0,
              "999 of 1,000 robots are stopped within 500 ms of the beginning of the log-in, and each is", 1},
             {},
             "log-ins with a stop",
             10'000,
             20,
             logInAndStop}};
}

}  // namespace axon::faults
