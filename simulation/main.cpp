// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <atomic>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <map>
#include <mutex>
#include <stdexcept>
#include <thread>

#include "common/planted_bug_names.hpp"
#include "simulation/world.hpp"

namespace {

using namespace axon::simulation;

constexpr const char* kUsage =
    R"(axon-simulate runs the product's own cores on virtual time and a simulated network, and checks its promises.
  --seeds A..B     play these seeds, both included (default 1..1000)
  --faults PROFILE faults to inject: none, delay, loss, duplication, reorder, partition, crash, pause, slow,
                   drift, direct, lies, all (default: all); "each" takes another one for each seed, in turn
  --story SEED     play this one seed and print what happens in it
  --json FILE      write the figures to this file
  --jobs N         number of threads (default: the number of cores)
  --keep-going     do not end at the first broken promise
  --list           print the profiles and the invariants
Every seed is a laboratory of its own: 2 or 3 clients, 3 or 4 entities, 60 virtual seconds.
Exit status: 0 no promise was broken; 1 a promise was broken; 2 called wrongly.
)";

struct Options {
    std::uint64_t first = 1, last = 1000;
    std::optional<Faults> faults = Faults::All;  ///< none = each in turn
    std::optional<std::uint64_t> story;
    std::string json;
    unsigned jobs = std::max(1U, std::thread::hardware_concurrency());
    bool keep_going = false;
    bool list = false;
    bool help = false;
    bool bugs_listed = false;
};

#ifdef AXON_PLANTED_BUGS
axon::PlantedBug plantedBug(const std::string& wanted) {
    if (const auto bug = axon::plantedBugOf(wanted)) return *bug;
    throw std::invalid_argument("--bug: there is no \"" + wanted + "\"; fix: --list-bugs shows them");
}
#endif

std::uint64_t numberOf(const std::string& option, std::string_view text) {
    std::uint64_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc{} || end != text.data() + text.size() || text.empty())
        throw std::invalid_argument(option + ": expected a number, found \"" + std::string(text) + "\"");
    return number;
}

Options parse(int argc, char** argv) {
    Options options;
    for (int i = 1; i < argc; ++i) {
        const std::string option = argv[i];
        const auto value = [&]() -> std::string {
            if (i + 1 >= argc) throw std::invalid_argument(option + ": expected a value after it");
            return argv[++i];
        };
        if (option == "--seeds") {
            const auto text = value();
            const auto dots = text.find("..");
            options.first = numberOf(option, std::string_view(text).substr(0, dots));
            options.last = dots == std::string::npos
                               ? options.first
                               : numberOf(option, std::string_view(text).substr(dots + 2));
            if (options.last < options.first)
                throw std::invalid_argument("--seeds: expected A..B with A not above B");
        } else if (option == "--faults") {
            const auto name = value();
            options.faults = faultsOf(name);
            if (!options.faults && name != "each")
                throw std::invalid_argument("--faults: there is no profile \"" + name +
                                            "\"; fix: --list shows them");
        } else if (option == "--story") {
            options.story = numberOf(option, value());
        } else if (option == "--json") {
            options.json = value();
        } else if (option == "--jobs") {
            options.jobs =
                static_cast<unsigned>(std::clamp<std::uint64_t>(numberOf(option, value()), 1, 256));
        } else if (option == "--keep-going") {
            options.keep_going = true;
        } else if (option == "--list") {
            options.list = true;
#ifdef AXON_PLANTED_BUGS
        } else if (option == "--bug") {
            axon::planted_bug = plantedBug(value());
        } else if (option == "--list-bugs") {
#define AXON_PRINT(name, what) std::printf("%-28s %s\n", #name, what);
            AXON_EACH_PLANTED_BUG(AXON_PRINT)
#undef AXON_PRINT
            options.bugs_listed = true;
#endif
        } else if (option == "--help" || option == "-h") {
            options.help = true;
        } else {
            throw std::invalid_argument("there is no option \"" + option +
                                        "\"; fix: --help shows the options");
        }
    }
    return options;
}

Faults faultsFor(const Options& options, std::uint64_t seed) {
    return options.faults ? *options.faults : static_cast<Faults>(seed % kFaults);
}

void tell(std::uint64_t seed, Faults faults, const Outcome& outcome, std::size_t lines) {
    const auto from = outcome.story.size() > lines ? outcome.story.size() - lines : 0;
    if (from > 0) std::printf("  … %zu lines before\n", from);
    for (auto i = from; i < outcome.story.size(); ++i) std::printf("  %s\n", outcome.story[i].c_str());
    std::printf(
        "seed %llu, faults %s: %llu events, digest %016llx: %s\n", static_cast<unsigned long long>(seed),
        toString(faults), static_cast<unsigned long long>(outcome.events),
        static_cast<unsigned long long>(outcome.digest),
        outcome.violation
            ? (std::string(toString(outcome.violation->invariant)) + ": " + outcome.violation->what).c_str()
            : "no promise was broken");
}

struct Totals {
    std::uint64_t seeds = 0, events = 0;
    Counts counts;
    std::map<std::string, std::uint64_t> broken;
    std::optional<std::uint64_t> first_broken;
};

void writeJson(const std::string& file, const Options& options, const Totals& totals, double seconds) {
    std::ofstream out(file);
    if (!out) throw std::invalid_argument("--json: expected a file that can be written: " + file);
    out << "{\n  \"first_seed\": " << options.first << ",\n  \"last_seed\": " << options.last
        << ",\n  \"faults\": \"" << (options.faults ? toString(*options.faults) : "each")
        << "\",\n  \"jobs\": " << options.jobs << ",\n  \"seeds\": " << totals.seeds
        << ",\n  \"seconds\": " << seconds
        << ",\n  \"seeds_per_minute\": " << static_cast<double>(totals.seeds) * 60 / seconds
        << ",\n  \"events\": " << totals.events;
    for (const auto& each : kCounts) out << ",\n  \"" << each.name << "\": " << totals.counts.*each.count;
    out << ",\n  \"broken\": {";
    bool first = true;
    for (const auto& [name, count] : totals.broken) {
        out << (first ? "" : ", ") << '"' << name << "\": " << count;
        first = false;
    }
    out << "},\n  \"first_broken_seed\": "
        << (totals.first_broken ? std::to_string(*totals.first_broken) : "null") << "\n}\n";
}

int simulate(const Options& options) {
    const auto began = std::chrono::steady_clock::now();
    std::atomic<std::uint64_t> next{options.first};
    std::atomic<bool> ended{false};
    std::mutex mutex;
    Totals totals;
    const auto work = [&] {
        Totals mine;
        while (!ended.load(std::memory_order_relaxed)) {
            const auto seed = next.fetch_add(1, std::memory_order_relaxed);
            if (seed > options.last) break;
            const auto faults = faultsFor(options, seed);
            const auto outcome = World(seed, faults).run();
            ++mine.seeds;
            mine.events += outcome.events;
            mine.counts.add(outcome.counts);
            if (!outcome.violation) continue;
            ++mine.broken[toString(outcome.violation->invariant)];
            const std::lock_guard lock(mutex);
            const bool is_first = !totals.first_broken;
            if (!totals.first_broken || seed < *totals.first_broken) totals.first_broken = seed;
            if (options.keep_going) {
                std::printf("seed %llu, faults %s: %s: %s\n", static_cast<unsigned long long>(seed),
                            toString(faults), toString(outcome.violation->invariant),
                            outcome.violation->what.c_str());
            } else if (is_first) {
                tell(seed, faults, World(seed, faults).run(true), 60);
                ended = true;
            }
        }
        const std::lock_guard lock(mutex);
        totals.seeds += mine.seeds;
        totals.events += mine.events;
        totals.counts.add(mine.counts);
        for (const auto& [name, count] : mine.broken) totals.broken[name] += count;
    };
    std::vector<std::thread> threads;
    for (unsigned i = 1; i < options.jobs; ++i) threads.emplace_back(work);
    work();
    for (auto& thread : threads) thread.join();
    const auto seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
    std::printf("%llu seeds, %llu events in %.2f s: %.0f seeds a minute, %.0f events a second\n",
                static_cast<unsigned long long>(totals.seeds), static_cast<unsigned long long>(totals.events),
                seconds, static_cast<double>(totals.seeds) * 60 / seconds,
                static_cast<double>(totals.events) / seconds);
    for (const auto& each : kCounts)
        std::printf("%s%s %llu", &each == kCounts.begin() ? "" : ", ", each.name,
                    static_cast<unsigned long long>(totals.counts.*each.count));
    std::printf("\n");
    for (const auto& [name, count] : totals.broken)
        std::printf("broken: %s, in %llu seeds\n", name.c_str(), static_cast<unsigned long long>(count));
    if (totals.first_broken)
        std::printf("again: axon-simulate --story %llu --faults %s\n",
                    static_cast<unsigned long long>(*totals.first_broken),
                    toString(faultsFor(options, *totals.first_broken)));
    if (!options.json.empty()) writeJson(options.json, options, totals, seconds);
    return totals.broken.empty() ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
    try {
        const auto options = parse(argc, argv);
        if (options.bugs_listed) return 0;
        if (options.help) {
            std::fputs(kUsage, stdout);
            return 0;
        }
        if (options.list) {
            for (std::size_t i = 0; i < kFaults; ++i)
                std::printf("%-12s %s\n", toString(static_cast<Faults>(i)), describe(static_cast<Faults>(i)));
            std::printf("invariants:");
            for (std::size_t i = 0; i < kInvariants; ++i)
                std::printf(" %s", toString(static_cast<Invariant>(i)));
            std::printf("\n");
            return 0;
        }
        if (options.story) {
            const auto faults = faultsFor(options, *options.story);
            const auto outcome = World(*options.story, faults).run(true);
            tell(*options.story, faults, outcome, outcome.story.size());
            return outcome.violation ? 1 : 0;
        }
        return simulate(options);
    } catch (const std::invalid_argument& error) {
        std::cerr << "axon-simulate: " << error.what() << '\n';
        return 2;
    }
}
