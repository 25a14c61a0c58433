// SPDX-License-Identifier: GPL-2.0-or-later
#include <signal.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <thread>

#include "axon_crowd.hpp"
#include "board.hpp"
#include "crowd.hpp"
#include "mosquitto_peer.hpp"
#include "runs.hpp"

// Relayed stop and data latency, Axon beside Mosquitto in the same run: one sender, N receivers, a message to each of
// them back to back, latency of each from the start of the batch (performance.md). Method: docs/reference/benchmarks.md.

namespace {

namespace fs = std::filesystem;
using namespace axon;
using namespace axon::bench;
using namespace std::chrono_literals;

/// One system under test: sends a batch and leaves the arrivals on its board.
class Subject {
  public:
    virtual ~Subject() = default;
    virtual Board& board() = 0;
    virtual void send(bool stop, const std::string& bytes) = 0;
};

class AxonSubject final : public Subject {
  public:
    AxonSubject(const fs::path& programs, const fs::path& folder, std::size_t n, const Running* running = nullptr)
        : crowd_(programs, folder, n, running) {}
    Board& board() override { return crowd_.board(); }
    void send(bool stop, const std::string& bytes) override {
        if (stop) {
            // Sends one stop to each and then waits for the receipts; the arrivals are on the board by then.
            if (const auto receipts = crowd_.client().stop(crowd_.names(), client::Seconds{5}); !receipts)
                std::cerr << "stop: " << receipts.refusal().message << "\n";
            return;
        }
        for (const auto& entity : crowd_.held()) {
            // The batch may be larger than what may wait for the server.
            if (const auto sent = entity.sendRaw(bytes, client::Seconds{2}); !sent) std::cerr << "data: " << sent.refusal().message << "\n";
        }
    }

  private:
    AxonCrowd crowd_;
};

class MosquittoSubject final : public Subject {
  public:
    MosquittoSubject(const fs::path& programs, const fs::path& folder, std::size_t n, std::uint16_t port)
        : board_((folder / "mosquitto.board").string(), n, true) {
        std::ofstream(folder / "mosquitto.conf") << "listener " << port << " 127.0.0.1\nallow_anonymous true\n"
                                                 << "set_tcp_nodelay true\nmax_queued_messages 0\npersistence false\n";
        const char* broker = fs::exists("/usr/sbin/mosquitto") ? "/usr/sbin/mosquitto" : "mosquitto";
        broker_ = std::make_unique<Child>(std::vector<std::string>{broker, "-c", (folder / "mosquitto.conf").string()},
                                          folder / "mosquitto.log");
        std::this_thread::sleep_for(300ms);
        receivers_ = std::make_unique<Child>(
            std::vector<std::string>{(programs / "axon-bench").string(), "mosquitto-receivers",
                                     (folder / "mosquitto.board").string(), std::to_string(n), std::to_string(port)},
            folder / "receivers.log");
        while (board_.ready() < n && !interrupted) {
            if (!receivers_->running() || !broker_->running())
                throw std::runtime_error("mosquitto or its receivers did not start; see " + folder.string());
            std::this_thread::sleep_for(10ms);
        }
        sender_ = std::make_unique<MosquittoSender>(port);
        n_ = n;
    }
    Board& board() override { return board_; }
    void send(bool stop, const std::string& bytes) override {
        for (std::size_t i = 0; i < n_; ++i) sender_->send(i, stop, bytes);
    }

  private:
    Board board_;
    std::unique_ptr<Child> broker_, receivers_;
    std::unique_ptr<MosquittoSender> sender_;
    std::size_t n_ = 0;
};

struct Series {
    std::vector<double> all_ms;   ///< every message of every batch
    std::vector<double> last_ms;  ///< the last arrival of each batch
    std::size_t lost = 0;

    nlohmann::json json() const {
        nlohmann::json out{{"n", all_ms.size()}, {"lost", lost}};
        if (all_ms.empty()) return out;
        auto sorted = all_ms;
        std::sort(sorted.begin(), sorted.end());
        // What never arrived counts as infinitely late: it belongs to the tail, not to nowhere.
        sorted.insert(sorted.end(), lost, std::numeric_limits<double>::infinity());
        const auto at = [&sorted](double q) { return sorted[static_cast<std::size_t>(q * static_cast<double>(sorted.size() - 1))]; };
        double sum = 0;
        for (double v : all_ms) sum += v;
        auto last = last_ms;
        std::sort(last.begin(), last.end());
        out.update({{"mean", sum / static_cast<double>(all_ms.size())}, {"p50", at(0.5)}, {"p99", at(0.99)},
                    {"max", sorted.back()}, {"last", last[last.size() / 2]}});
        return out;
    }
};

/// Sends one batch and waits until all have arrived, or two seconds. Never-arrived is counted, not forgotten.
void runBatch(Subject& subject, bool stop, const std::string& bytes, Series* series) {
    auto& board = subject.board();
    const auto count = [&board, stop](std::size_t i) { return (stop ? board[i].stops : board[i].data).load(); };
    std::vector<std::uint32_t> before(board.size());
    for (std::size_t i = 0; i < board.size(); ++i) before[i] = count(i);
    const auto begin = nowNs();
    subject.send(stop, bytes);
    const auto give_up = begin + 2'000'000'000LL;
    std::size_t arrived = 0;
    while (arrived < board.size() && nowNs() < give_up) {
        while (arrived < board.size() && count(arrived) != before[arrived]) ++arrived;
        if (arrived < board.size()) std::this_thread::sleep_for(200us);
    }
    if (!series) return;
    double last = 0;
    for (std::size_t i = 0; i < board.size(); ++i) {
        if (count(i) == before[i]) {
            ++series->lost;
            continue;
        }
        const double ms = static_cast<double>((stop ? board[i].stop_at : board[i].data_at).load() - begin) / 1e6;
        series->all_ms.push_back(ms);
        last = std::max(last, ms);
    }
    series->last_ms.push_back(last);
}

/// `running`: the other subject is Axon through these servers, in place of Mosquitto.
int run(const fs::path& programs, const std::vector<std::size_t>& sizes, int rounds, const std::string& only,
        const Running* running, const std::string& json_file) {
    const char* other = running ? "other" : "mosquitto";
    const fs::path root = fs::temp_directory_path() / ("axon-bench-" + std::to_string(::getpid()));
    const std::string data = batch(35137 - 137);  // chapter 5's 35,137 bytes are with the arguments
    const std::string stop_bytes = batch(60);
    nlohmann::json results = nlohmann::json::array();
    std::printf("Latency in ms from the start of a batch of one message to each of N; %d batches each, alternating.\n", rounds);
    std::printf("%6s %-5s | %9s %9s %9s %9s | %9s %9s %9s %9s | %6s %6s\n", "N", "what", "Axon mean", "p50", "p99", "last",
                (std::string(running ? "other" : "Mosq") + " mean").c_str(), "p50", "p99", "last", "mean", "last");
    bool corrupt = false;
    std::size_t lost = 0;
    for (const auto n : sizes) {
        if (interrupted) break;
        const auto folder = root / std::to_string(n);
        fs::create_directories(folder);
        AxonSubject axon(programs, folder, n);
        std::unique_ptr<Subject> peer;
        if (running) {
            fs::create_directories(folder / other);
            peer = std::make_unique<AxonSubject>(programs, folder / other, n, running);
        } else {
            peer = std::make_unique<MosquittoSubject>(programs, folder, n, static_cast<std::uint16_t>(20000 + ::getpid() % 20000));
        }
        for (const bool stop : {false, true}) {  // data first: a stopped entity refuses it
            if (!only.empty() && only != (stop ? "stop" : "data")) continue;
            const auto& bytes = stop ? stop_bytes : data;
            Series ours, theirs;
            for (int round = -3; round < rounds && !interrupted; ++round) {  // three to warm up
                std::fprintf(stderr, "\r%zu %s: batch %d of %d ", n, stop ? "stop" : "data", std::max(round + 1, 0), rounds);
                const auto one = [&](Subject& subject, Series& series) {
                    runBatch(subject, stop, bytes, round < 0 ? nullptr : &series);
                    std::this_thread::sleep_for(20ms);
                };
                if (round % 2 == 0) {
                    one(axon, ours);
                    one(*peer, theirs);
                } else {
                    one(*peer, theirs);
                    one(axon, ours);
                }
            }
            std::fprintf(stderr, "\r%40s\r", "");
            const auto a = ours.json(), m = theirs.json();
            results.push_back({{"n", n}, {"what", stop ? "stop" : "data"}, {"bytes", bytes.size()}, {"axon", a}, {other, m}});
            const auto value = [](const nlohmann::json& j, const char* key) { return j.value(key, std::nan("")); };
            std::printf("%6zu %-5s | %9.3f %9.3f %9.3f %9.3f | %9.3f %9.3f %9.3f %9.3f | %6.2f %6.2f", n, stop ? "stop" : "data",
                        value(a, "mean"), value(a, "p50"), value(a, "p99"), value(a, "last"), value(m, "mean"), value(m, "p50"),
                        value(m, "p99"), value(m, "last"), value(a, "mean") / value(m, "mean"), value(a, "last") / value(m, "last"));
            lost += ours.lost;
            if (ours.lost + theirs.lost > 0) std::printf("   lost: Axon %zu, %s %zu", ours.lost, other, theirs.lost);
            std::printf("\n");
            std::fflush(stdout);
        }
        for (std::size_t i = 0; i < n; ++i) corrupt |= axon.board()[i].corrupt > 0 || peer->board()[i].corrupt > 0;
    }
    std::printf("The last two columns are Axon / %s; below 1 Axon is faster. %s\n", other,
                corrupt ? "SOME CONTENT ARRIVED CORRUPT." : "All content arrived intact.");
    if (!json_file.empty())
        std::ofstream(json_file) << nlohmann::json{{"machine", machine()}, {"batches", rounds}, {"partial", interrupted != 0}, {"results", results}}.dump(2)
                                 << "\n";
    fs::remove_all(root);
    return corrupt || lost > 0 || interrupted ? 1 : 0;
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app{
        "Relayed stop and data latency through axon-server, beside Mosquitto (QoS 0) in the same run.\n\n"
        "  axon-bench\n  axon-bench --entities 1,64 --batches 50 --json result.json\n  axon-bench runs --entities 64\n"
        "  axon-bench --entities 1,8 --beside clientgl2.cfg entitygl2client.cfg\n\n"
        "Exit status: 0 done, 1 something of Axon's was lost, corrupt or interrupted.\n"};
    app.require_subcommand(0, 1);
    std::vector<std::size_t> sizes{1, 64, 1024};
    int batches = 30;
    std::string only, json_file;
    app.add_option("--entities", sizes, "How many receivers, one run for each number")->delimiter(',')->check(CLI::Range(1, 4096));
    app.add_option("--batches", batches, "Batches of each kind")->check(CLI::Range(1, 100000));
    app.add_option("--only", only, "One of the two, for a profiler: data or stop")->check(CLI::IsMember({"data", "stop"}));
    std::vector<std::string> beside;
    app.add_option("--beside", beside,
                   "In place of Mosquitto: Axon through servers that run already, by the configuration files of a client and of "
                   "an Entity Manager, as axon-cluster status names them")
        ->expected(2)
        ->check(CLI::ExistingFile)
        ->type_name("FILE FILE");
    app.add_option("--json", json_file, "Write the results, with the machine described, to this file");

    std::size_t together = 64;
    int levels = 10, rounds = 20;
    auto* runs = app.add_subcommand("runs", "How long a step of a global service takes to begin, beside a task of the client");
    runs->add_option("--entities", together, "How many take part")->check(CLI::Range(2, 256))->capture_default_str();
    runs->add_option("--levels", levels, "Steps of each, one after the other")->check(CLI::Range(2, kTaskMarks))->capture_default_str();
    runs->add_option("--rounds", rounds, "Runs that are measured")->check(CLI::Range(1, 10000))->capture_default_str();
    runs->add_option("--json", json_file, "Write the results, with the machine described, to this file");

    std::string board, server;
    std::size_t count = 0;
    std::uint16_t port = 0;
    auto* crowd = app.add_subcommand("crowd", "(internal) the receiving Entity Managers")->group("");
    crowd->add_option("board", board)->required();
    crowd->add_option("count", count)->required();
    crowd->add_option("server", server)->required();
    auto* receivers = app.add_subcommand("mosquitto-receivers", "(internal) the receiving MQTT clients")->group("");
    receivers->add_option("board", board)->required();
    receivers->add_option("count", count)->required();
    receivers->add_option("port", port)->required();
    CLI11_PARSE(app, argc, argv);

    try {
        if (crowd->parsed()) return runCrowd(board, count, server);
        if (runs->parsed()) {
            ::signal(SIGINT, [](int) { interrupted = 1; });
            return runRuns(fs::canonical("/proc/self/exe").parent_path(), together, levels, rounds, json_file);
        }
        if (receivers->parsed()) return runMosquittoReceivers(board, count, port);
        ::signal(SIGINT, [](int) { interrupted = 1; });
        const auto running = beside.empty() ? std::optional<Running>() : Running{beside[0], beside[1]};
        return run(fs::canonical("/proc/self/exe").parent_path(), sizes, batches, only, running ? &*running : nullptr, json_file);
    } catch (const std::exception& problem) {
        std::cerr << "axon-bench: " << problem.what() << "\n";
        return 1;
    }
}
