// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <condition_variable>
#include <cstdio>
#include <iostream>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <numeric>
#include <optional>
#include <random>

#include "contender.hpp"
#include "ddsperf.hpp"
#include "experiment.hpp"
#include "picture.hpp"
#include "placement.hpp"
#include "raw_router.hpp"
#include "report.hpp"

// The same work for Axon and for each peer, in the same run, in turns: one sender, N receivers, a message to
// each of them back to back, latency of each from the start of the batch; all on one core, and on two.
// Method: docs/reference/benchmarks.md.

namespace axon::bench {

namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

/// Not counted: caches, connections and the scheduler settle.
constexpr int kWarmUp = 3;
/// Between two batches, so that what the one left behind is not in the other.
constexpr std::int64_t kPause_ns = 20'000'000;
/// More a client does not open by itself.
const auto kDirectPaths = static_cast<std::size_t>(client::Options{}.direct_paths);
/// Of the order within the rounds.
constexpr std::uint64_t kSeed = 1;

struct Wish {
    std::vector<std::size_t> sizes{1, 64, 256, 1024, 2048};
    int batches = 30;
    double seconds = 0;
    std::vector<std::string> only, of;
    std::vector<std::string> cores;  // empty: one, and two where there are two
    std::vector<std::string> beside;
    int pair_rounds = 3;
    std::int64_t spin = directSpin().count();
    std::string json, plot;
};

bool isAxon(const std::string& name) {
    return name == "axon" || name == "axon-direct" || name == "other";
}
/// What the ratios of this row to the peers are called.
const char* ratioOf(const std::string& axon) {
    return axon == "axon-direct" ? "ratio_direct" : "ratio";
}

/// Sends one batch, and waits until all of it has arrived or can be in nobody's way any more. Of a system
/// that has ended it is lost.
void runBatch(Contender& contender, Message message, std::string& bytes, bool counts) {
    if (!contender.ended().empty()) {
        if (!counts) return;
        contender.series.beginBatch();
        for (std::size_t i = 0; i < contender.board().size(); ++i) contender.series.lose();
        return;
    }
    const auto batch = contender.send(message, bytes, nowNs());
    contender.await(batch, batch.begin + kPatience_ns + kLate_ns);
    if (!counts || interrupted) return;
    contender.series.beginBatch();
    contender.collect(batch, contender.series);
    contender.lookAtPaths();
}

class Comparison {
  public:
    Comparison(const Wish& wish, Report& report, const WorkFolder& work, Placement& placement)
        : wish_(wish), report_(report), work_(work), placement_(placement) {}

    void run() {
        std::printf(
            "Latency in ms from the start of a batch of one message to each of N; %s for each, in turns, %d "
            "to warm up.\n",
            wish_.seconds > 0 ? "a while" : (std::to_string(wish_.batches) + " batches").c_str(), kWarmUp);
        std::printf(
            "%6s %-5s %-5s %-15s %9s %9s %9s %9s %9s %9s %6s   Axon / it: mean, last (10 to 90 %% of the "
            "batches); by direct paths\n",
            "N", "what", "cores", "", "mean", "p50", "p99", "p99.9", "max", "last", "lost");
        for (const auto n : wish_.sizes) {
            if (interrupted) return;
            placement_.apply(Cores::Any);  // who starts is not measured
            const auto all = start(n);
            if (all.empty()) continue;
            for (const auto message :
                 {Message::Small, Message::Data, Message::Stop}) {  // a stopped entity refuses data
                if (!wish_.of.empty() &&
                    std::find(wish_.of.begin(), wish_.of.end(), nameOf(message)) == wish_.of.end())
                    continue;
                for (const auto& cores : wish_.cores) {
                    if (interrupted) break;
                    placement_.apply(coresOf(cores));
                    measure(n, message, all);
                }
            }
            for (const auto& one : all) {
                bad_[one->name] += one->bad();
                corrupt_[one->name] += one->corrupt();
                if (one->ended().empty()) continue;
                ended_.push_back({{"system", one->name}, {"n", n}, {"reason", one->ended()}});
                if (isAxon(one->name)) sound_ = false;
                std::printf("%6zu %s: %s. What was sent to it from then on is lost.\n", n, one->name.c_str(),
                            one->ended().c_str());
            }
        }
    }

    /// {cores: {peer: {message: {"mean", "last", "n": {"mean": […], "last": […]}}}}}: over which N. Null
    /// where one of them has no finite ratio.
    nlohmann::json geometric(const std::string& axon) const {
        nlohmann::json all = nlohmann::json::object();
        for (const auto& [key, its] : ratios_) {
            const auto& [of, cores, peer, message, what] = key;
            if (of != axon) continue;
            auto& to = all[cores][peer][message];
            to["n"][what] = its.n();
            to[what] = its.mean();
        }
        return all;
    }
    const std::map<std::string, std::uint64_t>& bad() const { return bad_; }
    const std::map<std::string, std::uint64_t>& corrupt() const { return corrupt_; }
    const nlohmann::json& ended() const { return ended_; }
    /// Nothing of Axon's was lost or has ended, no direct path was missing, and everything has started that
    /// this machine permits.
    bool sound() const { return sound_; }

  private:
    std::vector<std::unique_ptr<Contender>> start(std::size_t n) {
        std::vector<std::unique_ptr<Contender>> all;
        const auto add = [&](const std::string& name, auto&& make) {
            progress("peers: " + std::to_string(n) + " receivers: starting " + name);
            try {
                all.push_back(
                    std::make_unique<Contender>(name, make(work_.sub(name + "-" + std::to_string(n)))));
            } catch (const std::exception& problem) {
                if (interrupted) throw;
                reportSkipped(report_, name, "", std::to_string(n) + " receivers: " + problem.what());
                if (dynamic_cast<const NotPermitted*>(&problem) == nullptr) sound_ = false;
            }
        };
        for (const auto& peer : peers()) {
            if (!wish_.beside.empty() && peer.name != "axon") break;
            const bool named = std::find(wish_.only.begin(), wish_.only.end(), peer.name) != wish_.only.end();
            if (!peer.missing.empty() || (!wish_.only.empty() && peer.name != "axon" && !named)) continue;
            // Thousands of direct paths beat while the others are measured, and no client has as many unless
            // it is told to.
            if (peer.name == "axon-direct" && n > kDirectPaths && !named) continue;
            add(peer.name, [&](const fs::path& folder) { return peer.start(folder, n); });
        }
        if (!wish_.beside.empty())
            add("other", [&](const fs::path& folder) {
                return axonThrough({wish_.beside[0], wish_.beside[1]}, folder, n);
            });
        return all;
    }

    void measure(std::size_t n, Message message, const std::vector<std::unique_ptr<Contender>>& all) {
        auto bytes = content(bytesOf(message));
        const std::string cores = nameOf(placement_.applied());
        for (const auto& one : all) {
            one->series = {};
            one->relayed = 0;
        }
        std::vector<std::size_t> order(all.size());
        std::iota(order.begin(), order.end(), std::size_t{0});
        const auto end = wish_.seconds > 0 ? nowNs() + static_cast<std::int64_t>(wish_.seconds * 1e9) : 0;
        for (int round = -kWarmUp;
             !interrupted && (round <= 0 || (end != 0 ? nowNs() < end : round < wish_.batches)); ++round) {
            progress("peers: " + std::to_string(n) + " receivers, " + nameOf(message) + ", " + cores +
                     " cores: batch " + std::to_string(std::max(round + 1, 0)) +
                     (end != 0 ? "" : " of " + std::to_string(wish_.batches)));
            // In another order each time: nobody is always behind the same one.
            std::shuffle(order.begin(), order.end(), random_);
            for (std::size_t k = 0; k < order.size() && !interrupted; ++k) {
                runBatch(*all[order[k]], message, bytes, round >= 0);
                sleepUntil(nowNs() + kPause_ns);
            }
        }
        progress("");
        nlohmann::json row{{"n", n}, {"what", nameOf(message)}, {"cores", cores}, {"bytes", bytes.size()}};
        for (const auto& one : all) {
            auto its = one->series.json();
            std::printf("%6zu %-5s %-5s %-15s %s %s %s %s %s %s %6zu", n, nameOf(message), cores.c_str(),
                        one->name.c_str(), figure(its, "mean").c_str(), figure(its, "p50").c_str(),
                        figure(its, "p99").c_str(), figure(its, "p99.9").c_str(), figure(its, "max").c_str(),
                        figure(its, "last").c_str(), one->series.lost());
            if (isAxon(one->name) && one->series.lost() > 0) sound_ = false;
            if (variantOf(one->name) == Variant::Direct) its["relayed"] = one->relayed;
            for (const auto& axon : all) {
                if (!isAxon(axon->name) || (isAxon(one->name) && (axon != all.front() || one == axon)))
                    continue;
                if (axon != all.front()) std::printf("  |");
                for (const auto& [what, ours, theirs] :
                     {std::tuple{"mean", &axon->series.means(), &one->series.means()},
                      std::tuple{"last", &axon->series.lasts(), &one->series.lasts()}}) {
                    const auto ratio = spread(ratios(*ours, *theirs));
                    its[ratioOf(axon->name)][what] = ratio;
                    if (ours->empty() || theirs->empty()) continue;  // interrupted before
                    ratios_[{axon->name, cores, one->name, nameOf(message), what}].add(n, ratio);
                    std::printf("   %s (%s to %s)", figure(ratio, "median", 0).c_str(),
                                figure(ratio, "p10", 0).c_str(), figure(ratio, "p90", 0).c_str());
                }
            }
            std::printf("\n");
            if (one->relayed > 0) {
                std::printf("%6zu %-5s %s: UP TO %zu WERE REACHED THROUGH THE SERVERS.\n", n, nameOf(message),
                            one->name.c_str(), one->relayed);
                sound_ = false;
            }
            row[one->name] = std::move(its);
        }
        std::fflush(stdout);
        report_.add(std::move(row));
    }

    const Wish& wish_;
    Report& report_;
    const WorkFolder& work_;
    Placement& placement_;
    std::map<std::tuple<std::string, std::string, std::string, std::string, std::string>, MeanOverN>
        ratios_;  // Axon's, cores, peer, message, mean or last
    std::map<std::string, std::uint64_t> bad_, corrupt_;
    nlohmann::json ended_ = nlohmann::json::array();
    bool sound_ = true;
    std::mt19937_64 random_{kSeed};
};

/// Round trips of one pair: CycloneDDS's ping and pong, those of two processes that do nothing else, and of
/// Axon, by the servers and by a direct path, a text that the robot application sends back, and a drill,
/// which goes all ways of a stop to the application and back. In turns.
struct Pairs {
    nlohmann::json figures;
    bool lost = false;        ///< something of Axon's
    bool relayed = false;     ///< what was to go by the direct path
    std::string no_dds, bad;  ///< why CycloneDDS's are not there, or not all; what Axon refused
};

constexpr auto kNever = std::numeric_limits<double>::infinity();

/// Times in us, kNever of those that were lost, are added; what Axon refused, empty if nothing.
std::string drills(AxonCrowd& axon, int count, std::vector<double>& times) {
    const auto drill = axon.client().drill(axon.names(), count, client::Seconds{0});
    if (!drill) {
        times.insert(times.end(), static_cast<std::size_t>(count), kNever);
        return drill.refusal().message;
    }
    for (const auto& time : drill->front().callback) times.push_back(time ? time->count() * 1e6 : kNever);
    return {};
}

/// Likewise: a text of so many bytes there and back, one after the other, the next one sent by the callback
/// of the one before, as ddsperf does. Each has its number; what does not come back as the one that is under
/// way ends them, and the rest is lost.
std::string texts(AxonCrowd& axon, std::size_t bytes, std::size_t count, std::vector<double>& times) {
    struct Game {
        Game(client::CheckOut whom, std::size_t bytes, std::size_t how_many)
            : held(std::move(whom)), count(how_many), text(content(bytes)) {}
        const client::CheckOut held;
        const std::size_t count;
        std::mutex mutex;  // of all below
        std::condition_variable over;
        std::string text;
        std::int64_t sent = 0;
        std::vector<double> times;
        std::string bad;
        bool ended = false;

        void serve() {
            setNumber(text, static_cast<std::uint32_t>(times.size()));
            sent = nowNs();
            if (const auto done = held.sendText(text); !done) end(done.refusal().message);
        }
        void take(std::int64_t now, const std::string& back) {
            if (ended) return;
            if (back != text) return end("a text came back altered, or twice");
            times.push_back(static_cast<double>(now - sent) / 1e3);
            if (times.size() == count) return end({});
            serve();
        }
        void end(std::string why) {
            ended = true;
            bad = std::move(why);
            over.notify_one();
        }
    };
    const auto game = std::make_shared<Game>(axon.held().front(), bytes, count);
    game->held.onText([game](const std::string& back) {
        const auto now = nowNs();
        const std::lock_guard lock(game->mutex);
        game->take(now, back);
    });
    {
        std::unique_lock lock(game->mutex);
        game->serve();
        for (const auto late = nowNs() + kPatience_ns + static_cast<std::int64_t>(count) * 10'000'000;
             !game->ended && !interrupted;) {
            if (nowNs() > late) game->end("a text did not come back");
            game->over.wait_for(lock, 50ms, [&] { return game->ended; });
        }
        game->ended = true;
        times.insert(times.end(), game->times.begin(), game->times.end());
    }
    game->held.onText({});
    if (!interrupted) times.insert(times.end(), count - game->times.size(), kNever);
    return game->bad;
}

/// The systems of which pairs are measured, each started once.
struct PairsUnderTest {
    explicit PairsUnderTest(const WorkFolder& work)
        : relayed(work.sub("axon-pair"), 1),
          direct(work.sub("axon-direct-pair"), 1, Variant::Direct),
          robots(work.sub("axon-robots-pair"), 1, Variant::Robots),
          direct_robots(work.sub("axon-direct-robots-pair"), 1, Variant::DirectRobots),
          raw(work.sub("raw-pair")) {}
    AxonCrowd relayed, direct, robots, direct_robots;
    RawPair raw;
};

constexpr int kPairSeconds = 2, kTrips = 500, kWarmTrips = 100;

/// Round trips of one placement: in microseconds, and ddsperf's seconds.
struct Trips {
    std::map<std::string, std::vector<double>> times;
    std::map<std::size_t, std::vector<DdsperfSecond>> dds;
};

std::string bytesName(std::size_t bytes) {
    return std::to_string(bytes) + " bytes";
}

void measurePairs(PairsUnderTest& systems, const WorkFolder& work, const Placement& placement, bool with_dds,
                  Trips& trips, Pairs& out) {
    for (const auto bytes : {kSmallBytes, kDataBytes}) {
        if (interrupted || !with_dds || !out.no_dds.empty()) break;
        try {
            const auto seconds = pingPong(work.sub("ddsperf"), bytes, kPairSeconds, placement);
            trips.dds[bytes].insert(trips.dds[bytes].end(), seconds.begin(), seconds.end());
        } catch (const std::exception& problem) {
            out.no_dds = problem.what();
        }
    }
    for (const auto bytes : {kSmallBytes, kDataBytes}) {
        std::vector<double> warm;
        systems.raw.trips(bytes, kWarmTrips, warm);
        systems.raw.trips(bytes, kTrips, trips.times["raw, " + bytesName(bytes)]);
    }
    for (const auto& [way, crowd] :
         {std::pair{"axon", &systems.relayed}, std::pair{"axon-direct", &systems.direct},
          std::pair{"axon-robots", &systems.robots},
          std::pair{"axon-direct-robots", &systems.direct_robots}}) {
        if (interrupted || !out.bad.empty()) break;
        const std::string name = way;
        std::vector<double> warm;
        for (const auto bytes : {kSmallBytes, kDataBytes}) {
            if (out.bad.empty()) out.bad = texts(*crowd, bytes, kWarmTrips, warm);
            if (out.bad.empty())
                out.bad = texts(*crowd, bytes, kTrips, trips.times[name + " text, " + bytesName(bytes)]);
        }
        if (out.bad.empty()) out.bad = drills(*crowd, kWarmTrips, warm);
        if (out.bad.empty()) out.bad = drills(*crowd, kTrips, trips.times[name + " drill"]);
        if (std::count(warm.begin(), warm.end(), kNever) > 0) out.lost = true;
        if (crowd->relayed() > 0) out.relayed = true;
    }
}

/// {system and content: {"n", "p50_us", "p99_us", "lost", "by_cyclonedds"}}.
nlohmann::json figuresOf(Trips& trips, Pairs& out) {
    nlohmann::json all = nlohmann::json::object();
    const auto row = [&](const std::string& name, std::size_t n, double p50, double p99) -> nlohmann::json& {
        return all[name] = {{"n", n}, {"p50_us", p50}, {"p99_us", p99}};
    };
    for (const auto& [bytes, seconds] : trips.dds) {
        std::vector<double> p50, p99;
        double busy = 0;
        std::size_t count = 0;
        for (const auto& second : seconds) {
            p50.push_back(2 * second.p50_us);  // what it prints are halves
            p99.push_back(2 * second.p99_us);
            busy += 2 * second.mean_us * static_cast<double>(second.count) / 1e6;
            count += static_cast<std::size_t>(second.count);
        }
        if (p50.empty()) continue;
        std::sort(p50.begin(), p50.end());
        std::sort(p99.begin(), p99.end());
        auto& its = row("cyclonedds, " + bytesName(bytes), count, quantile(p50, 0.5), quantile(p99, 0.5));
        // One round trip after the other: together they take the time that has passed, or these are not round
        // trips.
        its["seconds"] = seconds.size();
        its["busy_seconds"] = busy;
    }
    const auto to = "cyclonedds, " + bytesName(kSmallBytes), to_data = "cyclonedds, " + bytesName(kDataBytes);
    for (auto& [name, times] : trips.times) {
        std::sort(times.begin(), times.end());
        auto& its = row(name, times.size(), quantile(times, 0.5), quantile(times, 0.99));
        its["lost"] = std::count(times.begin(), times.end(), kNever);
        if (its["lost"] > 0) out.lost = true;
        const auto& beside = name.ends_with(bytesName(kDataBytes)) ? to_data : to;
        if (all.contains(beside))
            its["by_cyclonedds"] = its["p50_us"].get<double>() / all[beside]["p50_us"].get<double>();
    }
    return all;
}

void print(const nlohmann::json& figures, const std::string& cores) {
    std::printf("Round trip of one pair, us; cores: %-5s         p50       p99   it / CycloneDDS, p50\n",
                cores.c_str());
    for (const auto& [name, its] : figures.items()) {
        std::printf("%-42s %9.1f %9.1f", name.c_str(), its["p50_us"].get<double>(),
                    its["p99_us"].get<double>());
        if (its.contains("by_cyclonedds")) std::printf("   %.2f", its["by_cyclonedds"].get<double>());
        std::printf("\n");
    }
}

/// In turns: in each round every system on the first choice of cores, then on the next.
Pairs pairs(const WorkFolder& work, const Wish& wish, Placement& placement, bool with_dds) {
    Pairs out;
    placement.apply(Cores::Any);
    PairsUnderTest systems(work);
    std::map<std::string, Trips> trips;
    for (int round = 0; round < wish.pair_rounds && !interrupted && out.bad.empty(); ++round)
        for (const auto& cores : wish.cores) {
            progress("peers: round trips of a pair, " + cores + " cores: round " + std::to_string(round + 1) +
                     " of " + std::to_string(wish.pair_rounds));
            placement.apply(coresOf(cores));
            measurePairs(systems, work, placement, with_dds, trips[cores], out);
        }
    placement.apply(Cores::Any);
    if (interrupted) out.bad.clear();
    progress("");
    for (const auto& cores : wish.cores) {
        out.figures[cores] = figuresOf(trips[cores], out);
        print(out.figures[cores], cores);
    }
    return out;
}

/// The choices of cores, where those of the default that this machine does not have are left out.
std::vector<std::string> choicesOf(const Wish& wish, const Placement& placement) {
    if (!wish.cores.empty()) {
        for (const auto& cores : wish.cores)
            if (!placement.permits(coresOf(cores)))
                throw NotPermitted("--cores " + cores +
                                   " needs two cores, and this process may use one; fix: --cores one");
        return wish.cores;
    }
    if (placement.permits(Cores::Two)) return {nameOf(Cores::One), nameOf(Cores::Two)};
    std::printf("Only one core is permitted here, so nothing is measured on two.\n");
    return {nameOf(Cores::One)};
}

int run(Wish wish) {
    Placement placement;
    wish.cores = choicesOf(wish, placement);
    setDirectSpin(std::chrono::microseconds(wish.spin));
    Report report(wish.json, "peers",
                  {{"entities", wish.sizes},
                   {"cores", wish.cores},
                   {"direct_spin_us", wish.spin},
                   {"batches", wish.batches},
                   {"seconds", wish.seconds},
                   {"warm_up", kWarmUp},
                   {"patience_s", 2},
                   {"seed", kSeed}});
    const auto wants = [&wish](const std::string& name) {
        return wish.beside.empty() &&
               (wish.only.empty() || std::find(wish.only.begin(), wish.only.end(), name) != wish.only.end());
    };
    std::vector<std::string> wanted;
    for (const auto& peer : peers())
        if (wants(peer.name)) wanted.push_back(peer.name);
    const bool wants_pairs = wish.pair_rounds > 0 && wants("cyclonedds");
    if (wants_pairs) wanted.emplace_back("cyclonedds");
    reportPeers(report, wanted);

    const WorkFolder work;
    Comparison comparison(wish, report, work, placement);
    carryOut([&] { comparison.run(); });
    bool sound = comparison.sound();
    if (wants_pairs && !interrupted) {
        try {
            const auto its = pairs(work, wish, placement, report.all().at("versions").contains("cyclonedds"));
            report.set("pairs", its.figures);
            if (!its.no_dds.empty()) reportSkipped(report, "cyclonedds", "cyclonedds-tools", its.no_dds);
            if (!its.bad.empty()) std::cerr << "round trips of a pair: " << its.bad << "\n";
            if (its.lost) std::printf("SOME ROUND TRIPS OF AXON'S WERE LOST.\n");
            if (its.relayed) std::printf("SOME ROUND TRIPS OF AXON-DIRECT'S WENT THROUGH THE SERVERS.\n");
            if (its.lost || its.relayed || !its.bad.empty()) sound = false;
        } catch (const std::exception& problem) {
            if (!interrupted) {
                std::cerr << "round trips of a pair: " << problem.what() << "\n";
                sound = false;
            }
        }
    }
    progress("");
    for (const std::string axon : {"axon", "axon-direct"}) {
        const auto geometric = comparison.geometric(axon);
        report.set(axon == "axon" ? "geometric_mean_over_n" : "geometric_mean_over_n_direct", geometric);
        for (const auto& [cores, peers_there] : geometric.items())
            for (const auto& [name, of] : peers_there.items())
                for (const auto& [what, its] : of.items())
                    std::printf(
                        "%-11s / %-15s %-5s cores: %-3s geometric mean over N: mean %s, last %s; of N in "
                        "%s\n",
                        axon.c_str(), name.c_str(), what.c_str(), cores.c_str(),
                        figure(its, "mean", 5).c_str(), figure(its, "last", 5).c_str(),
                        its["n"]["last"].dump().c_str());
    }
    std::uint64_t axon_bad = 0;
    for (const auto& [name, count] : comparison.bad()) {
        if (count > 0)
            std::printf("%s: %llu messages were corrupt, doubled, lost or out of order.\n", name.c_str(),
                        static_cast<unsigned long long>(count));
        if (isAxon(name)) axon_bad += count;
    }
    report.set("corrupt_or_misplaced", comparison.bad());
    report.set("corrupt", comparison.corrupt());
    report.set("ended", comparison.ended());
    std::printf("Below 1 Axon is faster. %s\n", axon_bad == 0
                                                    ? "Every byte of what Axon brought was as it was sent."
                                                    : "SOME CONTENT ARRIVED CORRUPT OR OUT OF ORDER.");
    if (axon_bad > 0) sound = false;
    const int status = conclude(report, sound ? ""
                                              : "SOMETHING OF AXON'S WAS LOST OR CORRUPT, WENT ANOTHER WAY "
                                                "OR HAS ENDED, OR A SYSTEM DID NOT START.");
    if (!wish.plot.empty()) drawPeers(report.all(), wish.plot);
    return status;
}

}  // namespace

Experiment declarePeers(CLI::App& app) {
    const auto wish = std::make_shared<Wish>();
    auto* command = app.add_subcommand(
        "peers", "The same work for Axon, Mosquitto, NATS, CycloneDDS and a raw router, in turns");
    std::vector<std::string> names{"cyclonedds"};
    std::string list;
    for (const auto& peer : peers()) {
        if (peer.name != "axon") names.push_back(peer.name);
        list += "  " + peer.name + std::string(16 - std::min<std::size_t>(15, peer.name.size()), ' ') +
                peer.what + "\n";
    }
    command->footer("Systems, each started by the benchmark:\n" + list +
                    "  cyclonedds       ddsperf's ping and pong: round trips of one pair\nMessages: small "
                    "(60 bytes), data (35,000 bytes), stop (60 bytes; for Axon, one call stops all of "
                    "them).\n\nExamples:\n  axon-bench peers --entities 1,64 --batches 20\n  axon-bench "
                    "peers --only mosquitto-qos0 --of stop --json stop.json\n  axon-bench peers --entities "
                    "1,8 --of data --beside client.cfg entitygl2client.cfg\n");
    command
        ->add_option("--entities", wish->sizes,
                     "Numbers of receivers, one run after the other [1,64,256,1024,2048]")
        ->delimiter(',')
        ->check(CLI::Range(1, 4096).description(""))
        ->type_name("N,…");
    command->add_option("--batches", wish->batches, "Number of batches of each kind for each system [30]")
        ->check(CLI::Range(1, 100000).description(""))
        ->type_name("COUNT");
    command
        ->add_option("--seconds", wish->seconds,
                     "Instead of --batches: seconds for each N and kind, all systems together")
        ->check(CLI::Range(0.1, 1e6).description(""))
        ->type_name("S");
    command->add_option("--of", wish->of, "Measure only these messages: small, data, stop")
        ->delimiter(',')
        ->check(CLI::IsMember({"small", "data", "stop"}).description(""))
        ->type_name("KIND,…");
    command
        ->add_option("--cores", wish->cores,
                     "Where everything runs: on one core; the sender on one and the rest on another; any "
                     "[one,two]")
        ->delimiter(',')
        ->check(CLI::IsMember({"one", "two", "any"}).description(""))
        ->type_name("WHERE,…");
    command->add_option("--only", wish->only, "Measure only these systems")
        ->delimiter(',')
        ->check(CLI::IsMember(names).description(""))
        ->type_name("SYSTEM,…");
    command
        ->add_option("--pair-rounds", wish->pair_rounds,
                     "Rounds of round trips next to ddsperf; 0 = none [3]")
        ->check(CLI::Range(0, 1000).description(""))
        ->type_name("COUNT");
    command
        ->add_option(
            "--direct-spin", wish->spin,
            "How long the threads that read direct paths may spin before they sleep, at both ends, in "
            "microseconds; 0 = not [" +
                std::to_string(wish->spin) + "]")
        ->check(CLI::Range(0, 250).description(""))
        ->type_name("US");
    command
        ->add_option(
            "--beside", wish->beside,
            "Instead of the other systems: Axon through servers that are already running. The two files are "
            "the configurations of a client and of an Entity Manager, as axon-cluster writes them")
        ->expected(2)
        ->check(CLI::ExistingFile.description(""))
        ->type_name("FILE FILE");
    command
        ->add_option("--json", wish->json,
                     "Write the results, with a description of the machine, to this file (JSON)")
        ->type_name("FILE");
    command->add_option("--plot", wish->plot, "Draw the results with gnuplot (PNG)")->type_name("FILE");
    return {command, [wish] { return run(*wish); }};
}

}  // namespace axon::bench
