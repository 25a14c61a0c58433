// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <cstdio>
#include <iostream>
#include <thread>

#include "axon_crowd.hpp"
#include "experiment.hpp"
#include "report.hpp"
#include "subject.hpp"

namespace axon::bench {

namespace {

using namespace std::chrono_literals;
constexpr int kWarmUp = 3;

client::GlobalService serviceOf(std::size_t entities, int levels) {
    client::GlobalService service;
    service.name = "benchmark";
    for (int level = 0; level < levels; ++level)
        for (std::size_t i = 0; i < entities; ++i) {
            client::GlobalStep step;
            step.role = static_cast<int>(i);
            step.category = "MACHINE";
            step.type = "STATIONARY";
            step.service_global_id = "nothing";
            step.preced = level;
            service.steps.push_back(std::move(step));
        }
    return service;
}

/// Global services over `entities`, each with one step in each of `levels` levels: the time from the end of a
/// level's last step to the entry of each handler of the next, beside the relayed one-way latency of a
/// client's task in the same run.
int run(std::size_t entities, int levels, int rounds, const std::string& json_file) {
    Report results(json_file, "runs",
                   {{"entities", entities}, {"levels", levels}, {"runs", rounds}, {"warm_up", kWarmUp}});
    const WorkFolder folder;
    AxonCrowd crowd(folder.sub("axon"), entities);
    auto& board = crowd.board();
    const auto service = serviceOf(entities, levels);
    reportPeers(results, {});
    Series single, batch, dispatched, steps, last;
    std::size_t failed = 0;
    const auto waitForTasks = [&](const std::vector<std::uint32_t>& before, std::size_t of) {
        const auto give_up = nowNs() + 5'000'000'000LL;
        for (std::size_t i = 0; i < of; ++i)
            while (board[i].tasks.next == before[i] && nowNs() < give_up && !interrupted)
                std::this_thread::sleep_for(50us);
    };
    const auto marks = [&] {
        std::vector<std::uint32_t> all(entities);
        for (std::size_t i = 0; i < entities; ++i) all[i] = board[i].tasks.next;
        return all;
    };
    for (int round = -kWarmUp; round < rounds && !interrupted; ++round) {
        progress("runs: round " + std::to_string(std::max(round + 1, 0)) + " of " + std::to_string(rounds));
        // What one relayed message takes: a task of the client, alone and in a batch to all.
        for (const std::size_t count : {std::size_t{1}, entities}) {
            const auto before = marks();
            std::vector<client::Task> tasks;
            const auto begin = nowNs();
            for (std::size_t i = 0; i < count; ++i) tasks.push_back(crowd.held()[i].run("nothing"));
            waitForTasks(before, count);
            for (const auto& task : tasks)
                if (!interrupted) task.wait(client::Seconds{5});
            for (std::size_t i = 0; i < count && round >= 0 && !interrupted; ++i) {
                auto& to = count == 1 ? single : batch;
                if (board[i].tasks.next != before[i]) {
                    to.add(static_cast<double>(board[i].tasks.of(before[i]) - begin) / 1e6);
                } else {
                    to.lose();
                }
            }
        }
        const auto before = marks();
        const auto master = static_cast<std::size_t>(round + kWarmUp) % entities;
        // The master's own step is the first of each level, and reaches its handler without a message: what
        // the others take from there is, and no less, what they take from their dispatch.
        client::Bindings bindings;
        for (std::size_t i = 0; i < entities; ++i)
            bindings[static_cast<int>(i)] = crowd.names()[(master + i) % entities];
        const auto run = crowd.client().runGlobal(service, bindings, crowd.names()[master]);
        if (!run) {
            progress("");
            std::cerr << run.refusal().message << "\n";
            ++failed;
            break;
        }
        const auto report = run->wait(client::Seconds{30});
        if (report.state != client::RunState::Succeeded) {
            progress("");
            std::cerr << "a run ended " << client::toString(report.state) << ": " << report.reason.message
                      << "\n";
            ++failed;
            continue;
        }
        if (round < 0) continue;
        std::int64_t ended = 0;  // the last step of the level before: its handler ends as it is entered
        for (int level = 0; level < levels; ++level) {
            std::int64_t newest = 0;
            const auto enteredBy = [&](std::size_t i) {
                return board[i].tasks.of(before[i] + static_cast<std::uint32_t>(level));
            };
            for (std::size_t i = 0; i < entities; ++i) {
                const auto at = enteredBy(i);
                newest = std::max(newest, at);
                if (i != master) dispatched.add(static_cast<double>(at - enteredBy(master)) / 1e6);
                if (level > 0) steps.add(static_cast<double>(at - ended) / 1e6);
            }
            if (level > 0) last.add(static_cast<double>(newest - ended) / 1e6);
            ended = newest;
        }
    }
    progress("");
    const auto one = single.json(), many = batch.json(), order = dispatched.json(), step = steps.json(),
               level = last.json();
    std::printf("%zu entities, %d levels, %d runs; ms. One way = client to handler, relayed.\n", entities,
                levels, rounds);
    std::printf("%-44s %8s %6s %8s %8s %8s %8s\n", "", "n", "lost", "mean", "p50", "p99", "max");
    const auto row = [](const char* what, const nlohmann::json& of) {
        if (!of.contains("mean")) return;
        std::printf("%-44s %8zu %6zu %s %s %s %s\n", what, of["n"].get<std::size_t>(),
                    of["lost"].get<std::size_t>(), figure(of, "mean", 8).c_str(),
                    figure(of, "p50", 8).c_str(), figure(of, "p99", 8).c_str(), figure(of, "max", 8).c_str());
    };
    row("one way, a single task", one);
    row("one way, a batch of one to each", many);
    row("dispatch of a step to its handler", order);
    row("end of a level to a handler of the next", step);
    row("end of a level to the last of the next", level);
    nlohmann::json ratios;
    const auto known = [](const nlohmann::json& of) { return of.contains("mean") && of["mean"].is_number(); };
    if (known(step) && known(order) && known(many)) {
        const auto batches = [&](const nlohmann::json& of) {
            return of["mean"].get<double>() / many["mean"].get<double>();
        };
        ratios = {{"dispatch / one way of a batch", batches(order)},
                  {"step / one way of a batch", batches(step)}};
        std::printf(
            "In one-way latencies of a batch of this size: dispatch to handler %.2f (bound: 3), end of a "
            "level to the next %.2f.\n",
            batches(order), batches(step));
    }
    results.set("failed", failed);
    results.set("ratios", ratios);
    for (const auto& [what, its] : {std::pair{"single", &one},
                                    {"batch", &many},
                                    {"dispatch", &order},
                                    {"step", &step},
                                    {"level", &level}})
        results.add({{"what", what}, {"ms", *its}});
    const auto lost = single.lost() + batch.lost();
    return conclude(results, failed + lost == 0 ? ""
                                                : std::to_string(failed) + " RUNS FAILED, " +
                                                      std::to_string(lost) + " TASKS NEVER ARRIVED.");
}

}  // namespace

Experiment declareRuns(CLI::App& app) {
    struct Wish {
        std::size_t entities = 64;
        int levels = 10, rounds = 20;
        std::string json;
    };
    const auto wish = std::make_shared<Wish>();
    auto* command = app.add_subcommand(
        "runs", "How long a step of a global service takes to begin, compared with a client's task");
    command->footer("Example:\n  axon-bench runs --entities 16 --rounds 50 --json runs.json\n");
    command->add_option("--entities", wish->entities, "Number of entities that take part [64]")
        ->check(CLI::Range(2, 256).description(""))
        ->type_name("N");
    command->add_option("--levels", wish->levels, "Steps of each entity, one after the other [10]")
        ->check(CLI::Range(2, static_cast<int>(Arrivals::kRemembered)).description(""))
        ->type_name("L");
    command->add_option("--rounds", wish->rounds, "Number of runs to measure [20]")
        ->check(CLI::Range(1, 10000).description(""))
        ->type_name("COUNT");
    command
        ->add_option("--json", wish->json,
                     "Write the results, with a description of the machine, to this file (JSON)")
        ->type_name("FILE");
    return {command, [wish] { return run(wish->entities, wish->levels, wish->rounds, wish->json); }};
}

}  // namespace axon::bench
