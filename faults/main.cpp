// SPDX-License-Identifier: GPL-2.0-or-later
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>

#include "kinds.hpp"
#include "load.hpp"
#include "operator.hpp"
#include "robots.hpp"

namespace {

using namespace axon::faults;
namespace fs = std::filesystem;

void list() {
    std::printf("%-19s %-5s  %s\n", "kind", "trial", "what is done; what is promised");
    for (const auto& kind : kinds())
        std::printf("%-19s %5s  %s\n%27s%s\n", kind.name.c_str(),
                    kind.trial == kNoTrial ? "" : std::to_string(kind.trial).c_str(), kind.what.c_str(), "",
                    kind.promise.text.c_str());
    std::printf("%-19s %5s  %s\n", "all", "",
                "each of them but cut-master, in one laboratory with the relay in every hop");
}

/// The progress line is for a person at a terminal, and for nobody else.
void showProgress(const std::string& kind, std::size_t done, std::size_t of) {
    static const bool terminal = ::isatty(2) == 1;
    if (!terminal) return;
    if (kind.empty())
        std::fputs("\r\033[K", stderr);
    else
        std::fprintf(stderr, "\r%s: %zu of %zu \033[K", kind.c_str(), done, of);
}

Report carryOut(const Kind& kind, Laboratory& lab, const Wishes& wishes, std::size_t trials, double seconds) {
    Report report;
    report.kind = kind.name;
    report.promise = kind.promise;
    report.measured = kind.measured;
    report.trials_wanted = trials;
    report.busy = wishes.busy;
    const auto begin = nowNs();
    Run run{
        lab,    report,  axon::SeededRandom(wishes.seed),
        trials, seconds, [&kind](std::size_t done, std::size_t of) { showProgress(kind.name, done, of); }};
    try {
        kind.run(run);
    } catch (const std::exception&) {
        if (!interrupted()) throw;  // else a program was just being started: what was counted before stands
    }
    showProgress("", 0, 0);
    report.seconds = static_cast<double>(nowNs() - begin) / 1e9;
    for (const auto& stall : lab.probe().stalls()) {
        if (stall.end <= begin) continue;
        ++report.host_stalls;
        report.longest_stall_ms =
            std::max(report.longest_stall_ms, static_cast<double>(stall.end - stall.begin) / 1e6);
    }
    report.partial = interrupted();
    return report;
}

int runKinds(const std::vector<std::string>& names, const Wishes& wishes, std::size_t trials, double seconds,
             const std::string& json_file) {
    const bool every = names == std::vector<std::string>{"all"};
    std::vector<const Kind*> chosen;
    for (const auto& name : names) {
        if (every) break;
        if (const auto* kind = findKind(name)) {
            chosen.push_back(kind);
            continue;
        }
        std::string known;
        for (const auto& kind : kinds()) known += " " + kind.name;
        std::cerr << "axon-faults: no kind '" << name << "'; expected all, or one of" << known << "\n";
        return 2;
    }
    catchInterrupts();
    // Children are killed with the thread that made them: this one, which outlives them.
    std::vector<Report> reports;
    bool not_run = false;
    const auto run = [&](const Kind& kind, Laboratory& lab) {
        const auto count = trials == 0 ? kind.usual_trials : every ? trials * kind.short_factor : trials;
        reports.push_back(
            carryOut(kind, lab, wishes, count, seconds > 0 ? seconds : static_cast<double>(count)));
        std::printf("%s", toText(reports.back()).c_str());
        std::fflush(stdout);
        if (!reports.back().broken().empty()) lab.keepLogs();
    };
    if (every) {
        const Needs in_every_hop{true, true, true, true};
        Laboratory lab(wishes, in_every_hop);
        for (const auto& kind :
             kinds())  // the cable of a first master would be missing in the faults of all managers
            if (!interrupted() && !kind.needs.first_master) run(kind, lab);
    }
    for (const auto* kind : chosen) {
        if (interrupted()) break;
        try {
            Laboratory lab(wishes, kind->needs);
            run(*kind, lab);
        } catch (const std::exception& problem) {  // what the others have found is worth telling
            std::cerr << "axon-faults: " << kind->name << ": " << problem.what() << "\n";
            not_run = true;
        }
    }
    if (!json_file.empty()) {
        std::ofstream out(json_file);
        out << "{\"machine\": " << machineJson() << ", \"seed\": " << wishes.seed
            << ", \"entities\": " << wishes.entities
            << ", \"partial\": " << (interrupted() ? "true" : "false") << ", \"results\": [";
        for (std::size_t i = 0; i < reports.size(); ++i) out << (i ? ",\n" : "\n") << toJson(reports[i]);
        out << "\n]}\n";
        if (!out.flush()) {
            std::cerr << "axon-faults: " << json_file
                      << " cannot be written; fix: choose another file for --json\n";
            return 2;
        }
    }
    const bool kept = std::all_of(reports.begin(), reports.end(),
                                  [](const Report& report) { return report.broken().empty(); });
    if (interrupted()) std::printf("interrupted; the results so far are above\n");
    if (not_run) return 2;
    return kept && !interrupted() ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app{
        "Injects faults into and between real Axon processes, and measures whether the robots stop as "
        "promised\n(docs/explanation/safety.md).\n\n  axon-faults --list\n  axon-faults kill-client --trials "
        "100 --entities 8\n  axon-faults cut-manager --trials 300 --entities 8 --seed 7 --json result.json\n "
        " axon-faults steady --entities 64 --seconds 60 --busy\n  axon-faults all --trials 2 --entities "
        "4\n\nExit status: 0 every promise was kept; 1 a promise was broken or the run was interrupted; 2 it "
        "could not be run.\n"};
    std::vector<std::string> names;
    std::string json_file, programs;
    Wishes wishes;
    std::size_t trials = 0;
    double seconds = 0;
    bool show_list = false;
    app.add_option("kind", names,
                   "Faults to inject, one kind after the other, each in a laboratory of its own. all = every "
                   "kind except cut-master, in one laboratory");
    app.add_flag("--list", show_list, "List every kind with its promise");
    app.add_option("--trials", trials, "Number of faults, commands or sequences [depends on the kind]")
        ->check(CLI::Range(1, 10'000'000));
    app.add_option("--entities", wishes.entities, "Number of robots")
        ->check(CLI::Range(1, 4000))
        ->capture_default_str();
    app.add_option("--seed", wishes.seed, "Seed that chooses moments and victims")->capture_default_str();
    app.add_option("--seconds", seconds, "Duration of `steady` in seconds [the number of trials]")
        ->check(CLI::Range(1, 1'000'000));
    app.add_flag("--busy", wishes.busy, "Saturate every core at ordinary priority while the faults happen");
    app.add_flag("--keep-logs", wishes.keep_logs,
                 "Keep the logs of all processes, in the folder that is named at the end");
    app.add_option("--json", json_file, "Write the results, with machine and seed, to this file (JSON)");
    app.add_option("--programs", programs,
                   "Folder of axon-server and axon-entity-manager [that of this program]");

    RobotsPlan plan;
    std::string client_server;
    const auto robots = [&](const char* role) {
        auto* sub = app.add_subcommand(role, "(internal)")->group("");
        sub->add_option("board", plan.board)->required();
        sub->add_option("folder", plan.folder)->required();
        sub->add_option("entities", plan.entities)->required();
        sub->add_option("address", plan.address)->required();
        sub->add_option("server", plan.server)->required();
        sub->add_option("first", plan.first);
        sub->add_option("count", plan.count);
        return sub;
    };
    const auto* application = robots("application");
    const auto* managers = robots("managers");
    auto* client = app.add_subcommand("operator", "(internal)")->group("");
    client->add_option("board", plan.board)->required();
    client->add_option("entities", plan.entities)->required();
    client->add_option("server", plan.server)->required();
    auto* load = app.add_subcommand("load", "(internal)")->group("");
    load->add_option("board", plan.board)->required();
    load->add_option("entities", plan.entities)->required();
    load->add_option("server", plan.server)->required();
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& problem) {
        return app.exit(problem) == 0 ? 0 : 2;
    }

    try {
        if (application->parsed()) return runApplication(plan);
        if (managers->parsed()) return runManagers(plan);
        if (client->parsed()) return runOperator(plan.board, plan.entities, plan.server);
        if (load->parsed()) return runLoad(plan.board, plan.entities, plan.server);
        if (show_list) {
            list();
            return 0;
        }
        if (names.empty()) {
            std::cerr << "axon-faults: expected a kind; fix: axon-faults --list shows them\n";
            return 2;
        }
        wishes.programs =
            programs.empty() ? fs::canonical("/proc/self/exe").parent_path() : fs::path(programs);
        return runKinds(names, wishes, trials, seconds, json_file);
    } catch (const std::exception& problem) {
        std::cerr << "axon-faults: " << problem.what() << "\n";
        return 2;
    }
}
