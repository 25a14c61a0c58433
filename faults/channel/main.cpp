// SPDX-License-Identifier: GPL-2.0-or-later
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>

#include "channel/stop_measurement.hpp"
#include "channel/two_sides.hpp"

namespace {

using namespace axon;
using namespace axon::faults;

constexpr int kNotPermitted = 77;  // a test that cannot run here is skipped

Duration milliseconds(double value) {
    return std::chrono::duration_cast<Duration>(std::chrono::duration<double, std::milli>(value));
}

int exitStatus(int status) {
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

void print(const TwoSides::Report& report) {
    for (const auto& [name, its] :
         {std::pair{"left to right", report.to_right}, {"right to left", report.to_left}})
        std::fprintf(
            stderr,
            "axon-channel: %s: %llu passed, %llu lost, %llu in an outage, %llu found the queue full\n", name,
            static_cast<unsigned long long>(its.passed), static_cast<unsigned long long>(its.lost),
            static_cast<unsigned long long>(its.in_outage), static_cast<unsigned long long>(its.queue_full));
}

int run(const ChannelSettings& settings, std::uint64_t seed, const std::string& left,
        const std::string& right) {
    TwoSides sides(settings, seed);
    const pid_t first = left.empty() ? -1 : sides.start(Side::Left, left);
    const pid_t second = sides.start(Side::Right, right);
    int status = 0;
    ::waitpid(second, &status, 0);
    if (first > 0) {
        ::kill(-first, SIGTERM);
        int its_status = 0;
        ::waitpid(first, &its_status, 0);
    }
    print(sides.finish());
    return exitStatus(status);
}

int measure(const ChannelSettings& settings, std::uint64_t seed, const Workload& workload,
            const std::string& json_file) {
    TwoSides sides(settings, seed);
    const Sending sendings[] = {{"TCP as it is", false, false},
                                {"TCP with the lane's options", true, false},
                                {"the same and datagrams", true, true}};
    nlohmann::json rows = nlohmann::json::array();
    std::printf("%-28s %7s %10s %10s %10s %7s %8s\n", "way", "n", "p50 ms", "p99 ms", "max ms", "never",
                "copies");
    std::size_t never = 0;
    for (const auto& sending : sendings) {
        const auto figures = measureStops(sides, sending, workload, seed);
        std::printf("%-28s %7zu %10.1f %10.1f %10.1f %7zu %8.2f\n", sending.name.c_str(), figures.n,
                    figures.p50_ms, figures.p99_ms, figures.max_ms, figures.never, figures.copies);
        std::fflush(stdout);
        never += figures.never;
        rows.push_back({{"way", sending.name},
                        {"n", figures.n},
                        {"p50_ms", figures.p50_ms},
                        {"p99_ms", figures.p99_ms},
                        {"max_ms", figures.max_ms},
                        {"never_arrived", figures.never},
                        {"copies", figures.copies}});
    }
    const auto report = sides.finish();
    print(report);
    if (!json_file.empty()) {
        std::ofstream(json_file)
            << nlohmann::json{{"seed", seed}, {"outages", report.outages}, {"rows", rows}}.dump(2) << '\n';
    }
    return never == 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app{
        "Emulates a lossy radio link between two network namespaces, which it makes for the run (as root, or "
        "as a user who may have user namespaces).\n\n  axon-channel --loss 2.2 --delay 2 run --left 'iperf3 "
        "-s' --right 'iperf3 -c $AXON_CHANNEL_THERE'\n  axon-channel --loss 10 --outage 60 --outage-every "
        "1000 measure\n\nExit status: that of the right side's command; for measure, 1 if a stop never "
        "arrived; 2 called wrongly; 77 if\nthis machine does not permit namespaces or TUN devices."};
    double loss = 0, bad_loss = 100, to_bad = 0, to_good = 0, outage = 0, every = 0, delay = 0, jitter = 0,
           rate = 0;
    std::uint64_t seed = 1;
    app.add_option("--loss", loss, "Percent of packets lost, each independently")
        ->check(CLI::Range(0.0, 100.0));
    app.add_option("--to-bad", to_bad,
                   "Loss in bursts (Gilbert-Elliott): percent of packets after which the bad state begins")
        ->check(CLI::Range(0.0, 100.0));
    app.add_option("--to-good", to_good, "Percent of packets after which the bad state ends")
        ->check(CLI::Range(0.0, 100.0));
    app.add_option("--bad-loss", bad_loss, "Percent of packets lost in the bad state [100]")
        ->check(CLI::Range(0.0, 100.0));
    app.add_option("--outage", outage, "Outage during which nothing passes, in milliseconds")
        ->check(CLI::NonNegativeNumber);
    app.add_option("--outage-every", every, "Mean time between outages, in milliseconds")
        ->check(CLI::NonNegativeNumber);
    app.add_option("--delay", delay, "Delay one way, in milliseconds")->check(CLI::NonNegativeNumber);
    app.add_option("--jitter", jitter,
                   "Additional random delay, at most this many milliseconds; packets keep their order")
        ->check(CLI::NonNegativeNumber);
    app.add_option("--rate", rate, "Rate in kbit/s; 0 = unlimited")->check(CLI::NonNegativeNumber);
    app.add_option("--seed", seed, "Seed of losses, outages and jitter [1]");

    std::string left, right, json;
    Workload workload;
    auto* const run_it =
        app.add_subcommand("run", "Run a shell command on each side; the run ends with the right one");
    run_it->add_option("--left", left,
                       "Command that is started first and ended with SIGTERM. AXON_CHANNEL_HERE and "
                       "AXON_CHANNEL_THERE are the addresses of its own and the other side");
    run_it->add_option("--right", right)->required();
    auto* const measure_it = app.add_subcommand(
        "measure", "Measure how long isolated stops take: with TCP, with TCP options, with datagrams");
    measure_it->add_option("--stops", workload.stops, "Stops for each way [2000]")
        ->check(CLI::Range(1, 1'000'000));
    measure_it->add_option("--flows", workload.flows, "Connections among which they are shared [100]")
        ->check(CLI::Range(1, 1000));
    measure_it->add_option("--json", json, "Write the figures to this file");
    auto* const probe_it = app.add_subcommand("probe", "Say whether this machine permits it");
    app.require_subcommand(1);
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        return app.exit(error) == 0 ? 0 : 2;
    }
    ChannelSettings settings;
    settings.loss = loss / 100;
    settings.to_bad = to_bad / 100;
    settings.to_good = to_good / 100;
    settings.bad_loss = bad_loss / 100;
    settings.outage = milliseconds(outage);
    settings.outage_every = milliseconds(every);
    settings.delay = milliseconds(delay);
    settings.jitter = milliseconds(jitter);
    settings.bytes_per_s = rate * 125;
    try {
        if (run_it->parsed()) return run(settings, seed, left, right);
        if (measure_it->parsed()) return measure(settings, seed, workload, json);
        if (probe_it->parsed()) TwoSides sides(settings, seed);
        std::cout << "permitted" << std::endl;
        return 0;
    } catch (const NotPermitted& error) {
        std::cerr << "axon-channel: not permitted on this machine: " << error.what() << std::endl;
        return kNotPermitted;
    } catch (const std::exception& error) {
        std::cerr << "axon-channel: " << error.what() << std::endl;
        return 2;
    }
}
