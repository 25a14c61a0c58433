// SPDX-License-Identifier: GPL-2.0-or-later
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <iostream>

#include "child.hpp"
#include "experiment.hpp"
#include "report.hpp"

int main(int argc, char** argv) {
    using namespace axon::bench;
    // Standard output is for results and answers.
    spdlog::set_default_logger(spdlog::stderr_logger_mt("axon-bench"));
    CLI::App app{
        "Measures Axon on this machine, over loopback, next to other systems that do the same work in the "
        "same run.",
        "axon-bench"};
    app.footer(
        "\nTo begin:\n  axon-bench peers --entities 1,64 --batches 10        half a minute: Axon, Mosquitto, "
        "NATS, CycloneDDS, a raw router\n  axon-bench chapter5 --table 5.2 --entities 1,64      stops, "
        "beside what the thesis printed\n  axon-bench peers --json peers.json --plot peers.png  the whole "
        "comparison, with a picture\naxon-bench EXPERIMENT --help shows its options. An experiment starts "
        "all programs that it needs and ends them. Run nothing else at\nthe same time. Compare only ratios "
        "within one run, never times of two machines. If this is permitted, the threads of Axon's\nsignal "
        "lane and heartbeats have a real-time priority (SCHED_RR) and its memory is locked, as in operation; "
        "the other systems have neither.\nCtrl-C ends it early; the results so far are printed and written "
        "to the "
        "file of --json, marked as partial.\nExit status: 0 done; 1 Axon lost, corrupted or disconnected "
        "something, a process ended, something could not be measured or written,\nor the run was "
        "interrupted; 2 called wrongly.");
    app.get_formatter()->column_width(16);
    app.require_subcommand(1, 1);
    const std::vector<Experiment> experiments{declarePeers(app), declareChapter5(app), declareSaturation(app),
                                              declareGrowth(app), declareRuns(app)};
    const auto processes = declareProcesses(app);
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        if (argc > 1) return app.exit(error) == 0 ? 0 : 2;
        std::cout << app.help();
        return 2;
    }
    try {
        for (const auto& one : processes)
            if (one.command->parsed()) return one.run();
        takeInterrupts();
        descriptorsPermitted();  // before the first process is started, which has the limit of this one
        for (const auto& one : experiments)
            if (one.command->parsed()) return one.run();
    } catch (const std::exception& problem) {
        progress("");
        std::cerr << "axon-bench: " << problem.what() << "\n";
    }
    return 1;
}
