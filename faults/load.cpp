// SPDX-License-Identifier: GPL-2.0-or-later
#include "load.hpp"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <memory>
#include <optional>
#include <stdexcept>
#include <thread>
#include <vector>

#include "board.hpp"
#include "client/axon/client.hpp"
#include "robots.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;
using namespace axon::client;
using Clock = std::chrono::steady_clock;

/// A login is mostly waiting for round trips.
constexpr std::size_t kLoginsAtOnce = 16;
/// Batches under way to all robots that read, and to one of them. Beyond that their clients wait, so that
/// together they fill the processors and not the queues: where more is under way than a busy host carries
/// within kPatience, the clients would send what can only be dropped, and nothing would arrive whole.
constexpr std::size_t kAheadTogether = 640;
constexpr std::size_t kAheadMax = 16;
constexpr std::size_t kAheadMin = 2;
/// The same for the robots that stop reading: enough to fill the queues to each of them within the time for
/// which it does not read.
constexpr std::size_t kAheadOfStalled = 64;
/// What has not arrived for this long is not waited for any longer: it was dropped, or refused after a stop.
constexpr auto kPatience = 2s;
/// A robot that has stopped reading must not slow the load down.
constexpr auto kPatienceOfStalled = 200ms;

std::int32_t share(std::size_t together, std::size_t clients) {
    return static_cast<std::int32_t>(
        std::clamp(together / std::max<std::size_t>(1, clients), kAheadMin, kAheadMax));
}

/// How often a client looks whether it is to rearm, and whether there is room again: hundreds of threads that
/// look often would be a load of their own.
constexpr auto kLook = 50ms;
constexpr auto kNoRoom = 20ms;

/// One client with its robot; used by one thread at a time.
class Loader {
  public:
    Loader(const std::string& server, std::string name, Slot& slot, std::int32_t ahead,
           std::chrono::milliseconds patience)
        : name_(std::move(name)), slot_(slot), ahead_(ahead), patience_(patience) {
        Options options;
        options.server = server;
        options.timeout = 30s;
        options.direct = false;
        auto connected = Client::connect(options);
        if (!connected) throw std::runtime_error(name_ + ": " + connected.refusal().message);
        client_ = std::move(connected).value();
        client_->onConnection(
            [&its = slot_](bool there, const std::string&) { its.disconnected += there ? 0 : 1; });
        client_->onEntity([this](Presence presence, const Entity& entity) {
            if (presence == Presence::Left && entity.name == name_) ++slot_.left;
        });
        if (const auto there = client_->waitFor(name_, Seconds{30}); !there)
            throw std::runtime_error(name_ + ": " + there.refusal().message);
        if (!hold()) throw std::runtime_error(name_ + " was not granted");
    }

    /// Sends a batch where there is room for one.
    void turn() {
        const auto now = Clock::now();
        if (now >= look_at_) {
            look_at_ = now + kLook;
            look();
        }
        const auto under_way = static_cast<std::int32_t>(slot_.sent - slot_.received - given_up_);
        if (slot_.received != received_) {
            received_ = slot_.received;
            since_ = now;
        }
        if (under_way >= ahead_) {
            if (now - since_ >= patience_) {
                given_up_ = slot_.sent - slot_.received;
                since_ = now;
            } else {
                std::this_thread::sleep_for(kNoRoom);
            }
            return;
        }
        if (held_->sendRaw(bytes_, Seconds{1})) {
            ++slot_.sent;
        } else {
            ++slot_.refused;
            std::this_thread::sleep_for(kNoRoom);
        }
    }

  private:
    bool hold() {
        auto granted = client_->checkOut(name_);
        if (!granted) return false;
        held_ = std::move(granted).value();
        lost_ = false;
        held_->onLost([this](const Refusal&) {
            ++slot_.leases_lost;
            lost_ = true;
        });
        return true;
    }
    /// A stop latches, and what is sent to a latched robot is refused.
    void look() {
        if (lost_ && !hold()) return;
        const auto entity = client_->find(name_);
        if (!entity || !entity->latched) return;
        if (client_->rearm(name_))
            given_up_ = slot_.sent - slot_.received;  // what was under way is refused
        else
            ++slot_.refused;
    }

    const std::string name_;
    Slot& slot_;
    const std::int32_t ahead_;
    const std::chrono::milliseconds patience_;
    const std::string bytes_ = std::string(kBatchBytes, 'x');
    std::atomic<bool> lost_{false};
    std::unique_ptr<Client> client_;
    std::optional<CheckOut> held_;
    Clock::time_point look_at_{}, since_ = Clock::now();
    std::uint32_t received_ = 0;  // when last looked at
    std::uint32_t given_up_ = 0;  // sent, and not to be waited for
};

}  // namespace

int runLoad(const std::string& board_file, std::size_t entities, const std::string& server) {
    Board board(board_file, entities, false);
    auto& desk = board.desk();
    const auto parent = ::getppid();
    const auto reading = lastTenthOf(entities);
    const auto make = [&](std::size_t i) {
        if (i < reading)
            return std::make_unique<Loader>(server, robotName(i), board[i], share(kAheadTogether, reading),
                                            kPatience);
        return std::make_unique<Loader>(server, robotName(i), board[i],
                                        share(kAheadOfStalled, entities - reading), kPatienceOfStalled);
    };
    std::vector<std::unique_ptr<Loader>> loaders(entities);
    std::atomic<std::size_t> next{0};
    std::atomic<bool> failed{false};
    std::vector<std::thread> threads;
    for (std::size_t k = 0; k < kLoginsAtOnce; ++k)
        threads.emplace_back([&] {
            for (auto i = next++; i < entities && !failed; i = next++) {
                try {
                    loaders[i] = make(i);
                    ++desk.loaders;
                } catch (const std::exception& problem) {
                    std::fprintf(stderr, "%s\n", problem.what());
                    failed = true;
                }
            }
        });
    for (auto& thread : threads) thread.join();
    if (failed) ::_exit(2);
    threads.clear();
    for (auto& loader : loaders)
        threads.emplace_back([&desk, &loader = *loader, parent] {
            while (::getppid() == parent) {
                if (desk.load == 0)
                    std::this_thread::sleep_for(
                        100ms);  // hundreds of threads: looking more often would be a load
                else
                    loader.turn();
            }
        });
    while (::getppid() == parent) std::this_thread::sleep_for(200ms);
    ::_exit(0);
}

}  // namespace axon::faults
