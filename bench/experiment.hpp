// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <CLI/CLI.hpp>
#include <functional>

/// One file for each experiment. It declares its subcommand, with examples, and gives what runs it and
/// returns the exit status as conclude() gives it: 0 done, 1 something of Axon's was lost, corrupt,
/// disconnected or has ended, something did not start, or it was interrupted. What it throws makes the status
/// 1, too.
namespace axon::bench {

struct Experiment {
    CLI::App* command;
    std::function<int()> run;
};

Experiment declarePeers(CLI::App& app);
Experiment declareChapter5(CLI::App& app);
Experiment declareSaturation(CLI::App& app);
Experiment declareGrowth(CLI::App& app);
Experiment declareRuns(CLI::App& app);

/// Processes that an experiment starts: the receiving side of each system, and the like. Not shown in the
/// help.
std::vector<Experiment> declareProcesses(CLI::App& app);

}  // namespace axon::bench
