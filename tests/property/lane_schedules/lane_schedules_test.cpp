// SPDX-License-Identifier: GPL-2.0-or-later
// The direct path with its real data lane under random schedules: sockets on loopback, the client's readers,
// callbacks, links and sender, the Entity Manager's port, desk and inbox. The servers and the signal lane are
// queues that the driver delivers as late as it likes. At random: bursts in both directions, of 1 byte to
// nearly 4 MiB; callbacks that do not return; an inbox that is full and has room again; connections that are
// reset, closed, half closed and paused on either side, also inside a frame; late acknowledgements; leases
// and sessions that end; paths that are opened again.
//
// Claims: every message that may not be lost comes once, in the order of sending and with its content, unless
// the session with the servers was lost; all others come at most once and in the same order; what is kept,
// held back and queued stays within its bounds; each side is told once that a lane is over; callbacks run one
// at a time and in order; nothing hangs; no thread and no descriptor is left.
//
// The seed says what is done, and the threads when: AXON_SEED=n plays that one alone, AXON_TIMES=n so often.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <iterator>
#include <memory>
#include <string>

#include "common/planted_bug.hpp"
#include "lane_schedules/between.hpp"
#include "lane_schedules/book.hpp"
#include "lane_schedules/client_end.hpp"
#include "lane_schedules/manager_end.hpp"
#include "support/loopback.hpp"
#include "support/moved_clock.hpp"

namespace axon::schedules {
namespace {

using namespace std::chrono_literals;

std::size_t entriesOf(const char* folder) {
    return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder), {}));
}

/// Threads and descriptors of this process.
struct Owned {
    std::size_t threads = entriesOf("/proc/self/task"), descriptors = entriesOf("/proc/self/fd");
    bool operator==(const Owned&) const = default;
};

/// How often the trials got to the places where something can go wrong.
struct Reached {
    long messages = 0, by_path = 0, held_back = 0, left_out = 0, sent_again = 0, paths = 0, breaks = 0,
         inside_a_frame = 0, stalls = 0, blocked = 0, sessions_lost = 0, leases_ended = 0, refused = 0,
         marks_refused = 0, large = 0, in_the_middle = 0;

    void print() const {
        std::cout << messages << " messages came, " << by_path << " by a path; " << held_back
                  << " held back, " << left_out << " left out, " << sent_again
                  << " sent again by the Entity Manager, " << refused << " refused; " << paths << " paths, "
                  << breaks << " breaks, " << inside_a_frame << " at a chosen byte, " << stalls << " stalls, "
                  << blocked << " blocked callbacks, " << sessions_lost << " sessions lost, " << leases_ended
                  << " leases ended, " << marks_refused << " marks refused, " << large
                  << " messages above 1 MiB, " << in_the_middle << " ended in the middle\n";
    }
};

class Trial {
  public:
    Trial(std::uint64_t seed, Reached& reached)
        : seed_(seed),
          random_(seed),
          reached_(reached),
          largest_(largest()),
          burst_(1 + below(below(6) == 0 ? 300 : 20)),
          trouble_(3 + below(20)),
          relay_speed_(1 + below(6)),
          signal_speed_(1 + below(6)),
          moving_(below(2) == 0),
          cabled_(below(4) != 0),
          budget_(below(20) == 0 ? 40'000'000 : 6'000'000) {
        manager_ = std::make_shared<ManagerEnd>(clock_, activity_, relay_, claims_, to_manager_, to_client_,
                                                inbox(), spin());
        manager_->start();
        client_ = std::make_shared<ClientEnd>(clock_, activity_, relay_, signals_, claims_, to_manager_,
                                              to_client_, manager_, outbox(), below(4) != 0, spin());
        if (cabled_) cable_.emplace(manager_->endpoint, below(2) == 0 ? 4096 : 0);
        begin();
    }

    void play() {
        if (below(8) != 0) calm(400);
        for (auto steps = 20 + below(60); steps-- > 0 && !broken();) step();
        if (!broken() && below(3) != 0) {
            settle();
        } else {
            ++reached_.in_the_middle;
        }
        end();
    }
    std::string verdict() const {
        for (const auto& one : {to_manager_.verdict(), to_client_.verdict(), claims_.verdict(), hangs_})
            if (!one.empty()) return one;
        return {};
    }

  private:
    std::uint64_t below(std::uint64_t bound) { return random_.next() % bound; }
    bool broken() const { return !verdict().empty(); }
    std::size_t largest() {
        switch (below(16)) {
            case 0:
                return Content::kMost;
            case 1:
            case 2:
                return 400'000;  // more than one read brings
            case 3:
            case 4:
            case 5:
                return 40'000;
            default:
                return below(2) == 0 ? 200 : 3000;
        }
    }
    entity_manager::Inbox::Bounds inbox() {
        entity_manager::Inbox::Bounds bounds;
        if (below(3) == 0) return bounds;
        bounds.control_events = 4 + below(200);
        bounds.control_bytes = 4096U << below(10);
        bounds.data_events = 2 + below(100);
        bounds.data_bytes = 4096U << below(10);
        return bounds;
    }
    transport::OutboxLimits outbox() {
        transport::OutboxLimits limits;
        limits.data_bytes = 17U << 20U;
        limits.control_bytes = 32U << 20U;
        if (below(4) != 0) return limits;
        limits.window_bytes = 2048U << below(6);
        limits.data_bytes = 8192U << below(6);
        limits.control_bytes = 65536U << below(6);
        return limits;
    }
    /// Of the threads that read: from seed to seed they sleep, or look for the next message first.
    Duration spin() const { return seed_ % 2 == 0 ? Duration{50us} : Duration{}; }
    std::size_t size() {
        const auto most = below(3) == 0 ? largest_ : std::min<std::size_t>(largest_, 2000);
        return 1 + below(below(8) == 0 ? most : std::max<std::size_t>(most / 4, 1));
    }

    /// The client joins the servers and is granted the entity.
    void begin() {
        const auto name = Id128::uuid(random_).toString();
        relay_.join(name);
        client_->join(name);
        offer(manager_->resume(name));
    }
    void offer(const entity_manager::LeaseBook::Held& held) {
        client_->offer(held, cable_ ? cable_->address() : manager_->endpoint);
    }

    void step() {
        switch (below(20)) {
            case 0:
            case 1:
            case 2:
            case 3:
                clientSends(1 + below(burst_));
                break;
            case 4:
            case 5:
            case 6:
            case 7:
                managerSends(1 + below(burst_));
                break;
            case 8:
                relay(1 + below(10 * relay_speed_));
                break;
            case 9:
            case 10:
                signal(1 + below(4 * signal_speed_));
                break;
            case 11:
                client_->turn(below(4) != 0, moving_);
                break;
            case 12:
                manager_->timer();
                break;
            case 13:
                clock_.advance(Duration{1ms} * (1 + below(30)));
                break;
            case 14:
                client_->gate.shut(below(2) == 0);
                break;
            case 15:
                manager_->shut(below(2) == 0);
                break;
            case 16:
                if (cable_)
                    (below(2) == 0 ? cable_->to_client_paused : cable_->to_manager_paused) = below(2) == 0;
                break;
            case 17:
                if (below(4) == 0) calm(60);
                break;
            default:
                activity_.await();
                break;
        }
        if (cable_ && below(3) != 0) cable_->pump(1 + below(below(4) == 0 ? 1'000'000 : 5000));
        if (below(3) == 0) relay(1 + below(relay_speed_));
        if (below(3) == 0) signal(1 + below(signal_speed_));
        if (below(trouble_) == 0) trouble();
    }
    void clientSends(std::uint64_t times) {
        const auto keeping = below(4) == 0 ? Keeping::Droppable : Keeping::Kept;
        const auto bytes = afforded(times);
        const auto answer = below(8) == 0 ? static_cast<std::int32_t>(1 + below(500)) : 0;
        const bool here = below(3) != 0;
        for (; times > 0 && bytes > 0; --times)
            if (!client_->send(keeping, bytes, answer, keeping == Keeping::Kept ? kMsgText : kMsgStream,
                               here))
                ++reached_.refused;
    }
    void managerSends(std::uint64_t times) {
        const auto keeping = below(4) == 0 ? Keeping::Droppable : Keeping::Kept;
        const auto bytes = afforded(times);
        const auto answer = below(8) == 0 ? static_cast<std::int32_t>(1 + below(500)) : 0;
        if (bytes > 0) manager_->send(keeping, bytes, answer, static_cast<int>(times));
    }
    /// A size that so many messages of this trial may have. Large ones are fewer than wanted.
    std::size_t afforded(std::uint64_t& times) {
        const auto bytes = size();
        if (bytes > 100'000) times = std::min<std::uint64_t>(times, 3);
        if (bytes * times > budget_) return 0;
        budget_ -= bytes * times;
        if (bytes > 1'000'000) ++reached_.large;
        return bytes;
    }
    /// Whether something came.
    bool relay(std::uint64_t most) {
        bool some = false;
        for (auto left = most; left > 0; --left) {
            auto item = relay_.nextToManager();
            if (!item) break;
            if (refuses_mark_ && item->head.msg_type == kMsgWay) {
                refuses_mark_ = false;
                ++reached_.marks_refused;
                client_->refuseMark();
                continue;
            }
            some = true;
            if (manager_->relayed(*item)) continue;
            relay_.backToManager(std::move(*item));
            break;
        }
        for (auto left = most; left > 0; --left) {
            const auto item = relay_.nextToClient();
            if (!item) break;
            client_->relayed(*item);
            some = true;
        }
        return some;
    }
    bool signal(std::uint64_t most) {
        bool some = false;
        for (auto left = most; left > 0; --left) {
            if (signals_.deliverToManager()) some = true;
            if (signals_.deliverToClient()) some = true;
        }
        return some;
    }
    /// Everybody has a turn. Whether something happened that this thread knows of.
    bool everybody() {
        const bool pumped = cable_ && cable_->pump(2'000'000);
        const bool relayed = relay(100), signalled = signal(20);
        client_->turn(true, moving_);
        manager_->timer();
        return pumped || relayed || signalled;
    }
    /// Until the path stands, or for so many turns.
    void calm(int turns) {
        for (; turns > 0 && !broken() && !(client_->direct() && manager_->direct()); --turns) {
            if (!everybody()) activity_.await();
            clock_.advance(5ms);
        }
    }

    void trouble() {
        ++reached_.breaks;
        const auto what = static_cast<Break>(below(static_cast<std::uint64_t>(Break::Count)));
        switch (below(16)) {
            case 0:
            case 1:
            case 2:
                if (cable_) cable_->breakAll(what);
                break;
            case 3:
            case 4:
            case 5:
                if (cable_) cable_->breakAfter(1 + below(largest_ + 60), below(2) == 0, what);
                break;
            case 6:
                if (const auto path = client_->path()) path->close("this end is killed");
                break;
            case 7:
                manager_->breakLane();
                break;
            case 8:
                if (const auto path = client_->path(); path && path->isOpen()) path->breakSignals();
                break;
            case 9:
                clock_.advance(below(4) == 0 ? 11s : 300ms);
                break;
            case 10:
                clock_.advance(Duration{1100ms});
                calm(60);
                break;
            case 11:
                ++reached_.leases_ended;  // released
                client_->send(Keeping::Kept, 1, 0, kMsgRelease, true);
                client_->withdraw();
                if (below(2) == 0) relay(1000);
                offer(manager_->grant(client_->name()));
                break;
            case 12:
                ++reached_.leases_ended;  // taken
                manager_->endLease();
                if (below(2) == 0) client_->withdraw();
                client_->turn(true, moving_);
                offer(manager_->grant(client_->name()));
                break;
            case 13:
                if (below(2) == 0) loseSession();
                break;
            case 14:
                refuses_mark_ = true;
                break;
            default:
                clientSends(burst_);
                managerSends(burst_);
                manager_->breakLane();
                break;
        }
    }
    void loseSession() {
        ++reached_.sessions_lost;
        const bool client_first = below(2) == 0;
        if (client_first) client_->lose();
        relay_.lose();
        manager_->loseHolder();
        if (!client_first) client_->lose();
        begin();
    }

    /// All that stands in the way goes, and all that may not be lost comes.
    void settle() {
        client_->gate.shut(false);
        manager_->shut(false);
        if (cable_) cable_->to_client_paused = cable_->to_manager_paused = false;
        refuses_mark_ = false;
        const auto until = std::chrono::steady_clock::now() + 30s;
        while (!broken()) {
            const bool some = everybody();
            // Twice, since an answer may be sent by what has just come.
            if (!some && complete()) {
                manager_->onStrand([] {});
                client_->turn(true, moving_);
                if (complete()) return;
            }
            if (std::chrono::steady_clock::now() > until) {
                hangs_ = "it hangs: " + to_manager_.state() + "; " + to_client_.state();
                return;
            }
            if (!some) activity_.await();
            clock_.advance(2ms);
        }
    }
    bool complete() {
        return relay_.empty() && to_manager_.allHasCome() && to_client_.allHasCome() &&
               client_->allCalledBack();
    }

    void end() {
        client_->gate.shut(false);
        reached_.messages += static_cast<long>(to_manager_.keptCame() + to_client_.keptCame() +
                                               to_manager_.droppableCame() + to_client_.droppableCame());
        reached_.by_path += client_->by_path + manager_->by_path;
        reached_.held_back += client_->held;
        reached_.left_out += manager_->left_out;
        reached_.sent_again += manager_->again;
        reached_.paths += client_->begun;
        reached_.stalls += manager_->stalls;
        reached_.blocked += client_->gate.waited();
        reached_.inside_a_frame += cable_ ? cable_->broken_inside : 0;
        if (below(2) == 0) {
            client_->end();
            manager_->stop();
        } else {
            manager_->stop();
            client_->end();
        }
        signals_.clear();
        claims_.hold(LanePath::lanes == LanePath::overs, "the client is told of the end of each data lane");
        const std::weak_ptr<ManagerEnd> manager = manager_;
        const std::weak_ptr<ClientEnd> client = client_;
        client_ = nullptr;
        manager_ = nullptr;
        claims_.hold(manager.expired() && client.expired(), "nothing keeps an end that is no longer used");
    }

    const std::uint64_t seed_;
    SeededRandom random_;
    Reached& reached_;
    const std::size_t largest_;
    const std::uint64_t burst_, trouble_, relay_speed_, signal_speed_;
    const bool moving_, cabled_;
    std::uint64_t budget_;  // bytes that may still be sent
    test::MovedClock clock_;
    Activity activity_;
    Relay relay_;
    Signals signals_;
    Claims claims_;
    Book to_manager_{"to the Entity Manager"}, to_client_{"to the client"};
    std::shared_ptr<ManagerEnd> manager_;
    std::shared_ptr<ClientEnd> client_;
    std::optional<Cable> cable_;
    bool refuses_mark_ = false;
    std::string hangs_;
};

std::uint64_t setting(const char* name, std::uint64_t otherwise) {
    const char* given = std::getenv(name);
    return given != nullptr ? std::strtoull(given, nullptr, 10) : otherwise;
}

/// AXON_BUG=NAME, of a program that has them (tools/planted_bugs). False: there is no such bug.
bool plantBug() {
    const char* wanted = std::getenv("AXON_BUG");
    if (wanted == nullptr) return true;
#ifdef AXON_PLANTED_BUGS
#define AXON_MATCH(name, what)               \
    if (wanted == std::string_view(#name)) { \
        planted_bug = PlantedBug::name;      \
        return true;                         \
    }
    AXON_EACH_PLANTED_BUG(AXON_MATCH)
#undef AXON_MATCH
#endif
    return false;
}

TEST(LaneSchedules, NothingIsLostDoubledOrOutOfOrderWhateverHappens) {
    ASSERT_TRUE(plantBug()) << "this program has no bug of that name";
    const auto only = setting("AXON_SEED", 0);
    const auto first = std::max<std::uint64_t>(only, 1);
    const auto last = only != 0 ? only : 10 * setting("AXON_SEEDS", 30);  // ./check --full: 1000
    const auto times = setting("AXON_TIMES", 1);
    Reached reached;
    for (auto seed = first; seed <= last; ++seed) {
        for (std::uint64_t time = 0; time < times; ++time) {
            const Owned before;
            std::string verdict;
            {
                Trial trial(seed, reached);
                trial.play();
                verdict = trial.verdict();
            }
            ASSERT_EQ(verdict, "") << "again: AXON_SEED=" << seed << " AXON_TIMES=100";
            // A thread that was joined is in the list for a moment.
            ASSERT_TRUE(test::waitUntil([&] { return Owned() == before; })) << "AXON_SEED=" << seed;
        }
    }
    reached.print();
    if (only != 0) return;
    // Trials that never get there would find nothing.
    const auto seeds = static_cast<long>(last);
    EXPECT_GT(reached.by_path, 20 * seeds);
    EXPECT_GT(reached.held_back, seeds);
    EXPECT_GT(reached.left_out, seeds);
    EXPECT_GT(reached.sent_again, seeds);
    EXPECT_GT(reached.paths, seeds);
    EXPECT_GT(reached.inside_a_frame, seeds / 30);
    EXPECT_GT(reached.stalls, seeds / 50);
    EXPECT_GT(reached.blocked, seeds / 10);
    EXPECT_GT(reached.sessions_lost, seeds / 20);
    EXPECT_GT(reached.marks_refused, seeds / 50);
    EXPECT_GT(reached.large, seeds / 100);
}

}  // namespace
}  // namespace axon::schedules
