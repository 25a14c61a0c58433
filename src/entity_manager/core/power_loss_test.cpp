// SPDX-License-Identifier: GPL-2.0-or-later
// What the next life of an Entity Manager makes of the state folder, wherever the power was lost between two
// writes.
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <string>
#include <vector>

#include "support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

using test::CoreRig;
using test::MemoryStorage;
using Values = decltype(MemoryStorage::values);

void carryOut(Values& disk, const MemoryStorage::Write& write) {
    if (write.value)
        disk[write.key] = *write.value;
    else
        disk.erase(write.key);
}

/// What FileStorage's thread does of these, in its order: of each key the last, deletions first. What was
/// waited for is there already.
std::vector<MemoryStorage::Write> inOrderOfTheThread(const MemoryStorage::Write* begin,
                                                     const MemoryStorage::Write* end) {
    std::map<std::string, MemoryStorage::Write> waiting;
    for (; begin != end; ++begin) {
        if (!begin->waited) waiting[begin->key] = *begin;
    }
    std::vector<MemoryStorage::Write> order;
    for (const auto& [key, write] : waiting) order.push_back(write);
    std::stable_partition(order.begin(), order.end(), [](const auto& write) { return !write.value; });
    return order;
}

/// A life of the rig, event by event: how many writes each had caused when it was over, and whether a robot
/// that comes up after it must be latched.
class Life {
  public:
    explicit Life(std::uint64_t seed) : rig_(seed), random_(seed) {
        over();
        for (int i = 0; i < 40; ++i) {
            event();
            over();
        }
    }

    struct Event {
        std::size_t writes;
        bool latches;  ///< held or latched
    };
    const std::vector<Event>& events() const { return events_; }
    const std::vector<MemoryStorage::Write>& writes() const { return rig_.storage.writes; }

  private:
    void over() {
        events_.push_back(
            {rig_.storage.writes.size(), rig_.core().held() != nullptr || rig_.core().latched()});
    }
    std::string next(const char* what) { return what + std::to_string(++number_); }
    void event() {
        const std::string client = random_.next() % 3 == 0 ? "client2" : "client1";
        switch (random_.next() % 14) {
            case 0:
                return rig_.makeIdle();
            case 1:
            case 2:
                return rig_.take(client, next("take"));
            case 3:
                return rig_.task(client, next("task"), "Turning");
            case 4:
                rig_.stop(client);
                return;
            case 5:
                if (!rig_.stops.empty()) rig_.stopDone(rig_.stops.back().first);
                return;
            case 6:
            case 7:
                return rig_.rearm(client, next("rearm"));
            case 8: {
                proto::ToEntity release;
                release.mutable_release();
                return rig_.send(client, release);
            }
            case 9:
                return rig_.stop(client, StopCause::ClientLost);
            case 10:
            case 11: {  // taken over, or waited for
                proto::ToEntity take;
                take.mutable_check_out()->set_request_id(std::string(12, 'x') +
                                                         std::to_string(1000 + number_++));
                take.mutable_check_out()->set_phase(proto::TAKE);
                const bool force = random_.next() % 2 == 0;
                (force ? take.mutable_check_out()->set_force(true)
                       : take.mutable_check_out()->set_wait(true));
                return rig_.send(force ? "admin1" : client, take);
            }
            case 12:
                rig_.restart();
                return;
            default:
                return rig_.advance(std::chrono::milliseconds{random_.next() % 2000},
                                    random_.next() % 4 != 0);
        }
    }

    CoreRig rig_;
    SeededRandom random_;
    int number_ = 0;
    std::vector<Event> events_;
};

std::string told(const Life& life) {
    std::string text = ":";
    std::size_t at = 0;
    for (const auto& event : life.events()) {
        for (; at < event.writes; ++at) {
            const auto& write = life.writes()[at];
            text += " " + write.key + (!write.value ? " deleted" : write.waited ? " saved" : " kept");
        }
        text += event.latches ? " |" : " | free and unlatched";
    }
    return text;
}

TEST(PowerLoss, AtNoWriteDoesItUnlatchARobotThatWasHeldOrStoppedSinceWhatTheDiskHasWhole) {
    constexpr std::size_t kWaiting = 5;  // writes behind which the disk may be
    std::size_t cuts = 0, must = 0, may = 0;
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
        const Life life(seed);
        const auto& writes = life.writes();
        const auto& events = life.events();
        for (std::size_t wanted = 1; wanted <= writes.size(); ++wanted) {
            for (std::size_t whole = wanted - std::min(wanted, kWaiting); whole <= wanted; ++whole) {
                Values disk;
                for (std::size_t i = 0; i < wanted; ++i) {
                    if (i < whole || writes[i].waited) carryOut(disk, writes[i]);
                }
                const auto waiting = inOrderOfTheThread(writes.data() + whole, writes.data() + wanted);
                for (std::size_t done = 0;; ++done) {
                    // From the last event that the disk has whole to the one in which the power was lost.
                    const auto has = done == waiting.size() ? wanted : whole;
                    auto event = std::find_if(events.begin(), events.end(),
                                              [&](const auto& one) { return one.writes > has; });
                    if (event != events.begin()) --event;
                    bool latches = event->writes <= has;
                    for (; latches && event != events.end(); ++event) {
                        latches = event->latches;
                        if (event->writes >= wanted) break;
                    }
                    CoreRig next(99);
                    next.storage.values = disk;
                    ASSERT_NO_THROW(next.restart())
                        << "seed " << seed << ", write " << wanted << " of " << writes.size();
                    if (latches) {
                        EXPECT_TRUE(next.core().latched())
                            << "seed " << seed << ", " << wanted << " writes, of which the disk has " << whole
                            << " and " << done << " more" << told(life);
                    }
                    ++cuts;
                    ++(latches ? must : may);
                    if (HasFailure()) return;
                    if (done == waiting.size()) break;
                    carryOut(disk, waiting[done]);
                }
            }
        }
    }
    EXPECT_GT(must, cuts / 4);
    EXPECT_GT(may, 0U);
    RecordProperty("cuts", static_cast<int>(cuts));
}

}  // namespace
}  // namespace axon::entity_manager
