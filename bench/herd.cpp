// SPDX-License-Identifier: GPL-2.0-or-later
#include "herd.hpp"

#include <unistd.h>

#include <atomic>
#include <future>
#include <random>
#include <thread>

namespace axon::bench {

namespace {

using namespace std::chrono_literals;
constexpr std::int64_t kPeriod_ns = 500'000'000;
/// A login is mostly waiting for round trips.
constexpr int kLoginsAtOnce = 16;
constexpr std::chrono::seconds kJoinTime{300};

/// A standard client: its thread.
class StandardClient {
  public:
    StandardClient(const std::string& server, std::vector<std::string> names, HerdSlot& slot,
                   std::uint64_t seed, bool open)
        : open_(open), names_(std::move(names)), numbers_(names_.size(), 0), slot_(slot), random_(seed) {
        client_ = connectClient(server);
        client_->onConnection([&its = slot_](bool connected, const std::string&) {
            if (!connected) ++its.disconnected;
        });
        if (!names_.empty()) held_ = holdAll(*client_, names_);
        for (const auto& entity : held_) {
            entity.onLost([&its = slot_](const Refusal&) { ++its.leases_lost; });
            entity.onRaw([&its = slot_](auto&&) { ++its.received; });
        }
    }

    void tick() {
        for (std::size_t i = 0; i < held_.size(); ++i) {
            if (random_() % 2 == 0) {
                setNumber(bytes_, numbers_[i]);
                if (count(held_[i].sendRaw(bytes_, client::Seconds{1}), slot_.data)) ++numbers_[i];
            } else {
                signal(i);
            }
        }
    }
    /// When its first tick is due, so that they do not all send at the same time.
    std::int64_t phase() { return static_cast<std::int64_t>(random_() % kPeriod_ns); }

  private:
    template <class Done>
    bool count(const Done& done, std::atomic<std::uint32_t>& sent) {
        ++(done ? sent : slot_.refused);
        return static_cast<bool>(done);
    }
    void signal(std::size_t i) {
        switch (random_() % 3) {
            case 0:
                count(held_[i].reset(), slot_.signals);
                break;
            case 1:
                count(held_[i].clear(), slot_.signals);
                break;
            default:
                // A stop latches; without the second call every later datum would be refused.
                if (count(client_->stop({names_[i]}), slot_.signals) && !open_ && !client_->rearm(names_[i]))
                    ++slot_.refused;
        }
    }

    const bool open_;
    std::vector<std::string> names_;
    std::vector<std::uint32_t> numbers_;
    HerdSlot& slot_;
    std::mt19937_64 random_;
    std::string bytes_ = content(kDataBytes);
    std::unique_ptr<client::Client> client_;
    std::vector<client::CheckOut> held_;
};

}  // namespace

int runHerd(const std::string& board_file, std::size_t clients, const std::string& server,
            const std::string& prefix, std::size_t entities, std::uint64_t seed, bool open) {
    HerdBoard board(board_file, clients, false);
    const auto parent = ::getppid();
    std::vector<std::unique_ptr<StandardClient>> all(clients);
    std::atomic<std::size_t> next{0};
    std::vector<std::future<void>> logins;
    for (int k = 0; k < kLoginsAtOnce; ++k)
        logins.push_back(std::async(std::launch::async, [&] {
            for (std::size_t i = next++; i < clients; i = next++) {
                std::vector<std::string> names;
                for (auto its = open ? 0 : i; its < entities; its += open ? 1 : clients)
                    names.push_back(prefix + "-" + std::to_string(its));
                all[i] = std::make_unique<StandardClient>(server, std::move(names), board[i], seed + i, open);
                ++board.ready();
            }
        }));
    for (auto& login : logins) login.get();
    while (board.go() == 0 && ::getppid() == parent) std::this_thread::sleep_for(5ms);
    std::vector<std::thread> threads;
    for (const auto& client : all)
        threads.emplace_back([&client = *client, parent] {
            for (auto due = nowNs() + client.phase(); ::getppid() == parent; due += kPeriod_ns) {
                if (const auto left = due - nowNs(); left > 0)
                    std::this_thread::sleep_for(std::chrono::nanoseconds(left));
                client.tick();
            }
        });
    for (auto& thread : threads) thread.join();
    return 0;
}

Herd::Herd(const std::filesystem::path& folder, std::size_t clients, const AxonServer& server,
           const std::string& prefix, std::size_t entities, bool open)
    : board_((folder / "herd.board").string(), clients, true),
      child_(ourselves("herd",
                       {(folder / "herd.board").string(), std::to_string(clients), server.clientAddress(),
                        prefix, std::to_string(entities), "1", open ? "open" : "partitioned"}),
             folder / "herd.log") {
    try {
        child_.waitUntil([this] { return board_.ready() >= board_.size(); }, "the clients did not start",
                         kJoinTime);
    } catch (const std::exception& problem) {
        if (interrupted || !child_.running()) throw;
        throw std::runtime_error("only " + std::to_string(board_.ready()) + " of " +
                                 std::to_string(board_.size()) + " clients were there within " +
                                 std::to_string(kJoinTime.count()) + " s");
    }
}

Herd::Sums Herd::sums() {
    Sums sums;
    for (std::size_t i = 0; i < board_.size(); ++i) {
        sums.data += board_[i].data;
        sums.signals += board_[i].signals;
        sums.refused += board_[i].refused;
        sums.disconnected += board_[i].disconnected;
        sums.leases_lost += board_[i].leases_lost;
        sums.received += board_[i].received;
    }
    return sums;
}

}  // namespace axon::bench
