// SPDX-License-Identifier: GPL-2.0-or-later
// A repeater and a sentry with a network between them that drops, duplicates, delays and reorders, and
// somebody who records every datagram and sends it again, changed or not, at any later time. Claims: each
// stop is executed at most once, and only if its client gave it; what is acknowledged was executed; with a
// network that lets anything through at all, every stop arrives.
#include <gtest/gtest.h>

#include <cstdlib>
#include <map>
#include <set>

#include "datagrams/stop_repeater.hpp"
#include "datagrams/stop_sentry.hpp"

namespace axon::datagrams {
namespace {

using namespace std::chrono_literals;

constexpr Endpoint kManager{0x7f000001, 4000};

class World {
  public:
    explicit World(std::uint64_t seed) : random_(seed), loss_percent_(below(80)) { grant(); }

    void run(int steps) {
        for (int i = 0; i < steps; ++i) {
            switch (below(12)) {
                case 0:
                    give();
                    break;
                case 1:
                    replay();
                    break;
                case 2:
                    forge();
                    break;
                case 3:
                    if (below(10) == 0) resume();
                    break;
                case 4:
                    if (below(20) == 0) grant();
                    break;
                default:
                    pass();
                    break;
            }
            if (::testing::Test::HasFatalFailure()) return;
        }
    }
    std::size_t executed() const { return executed_.size(); }
    std::size_t given() const { return given_.size(); }
    int acknowledged() const { return acknowledged_; }

  private:
    using Stop = std::tuple<std::int32_t, std::string, std::int64_t>;  // lease, sender, sequence
    struct Flying {
        TimePoint at;
        bool to_manager;
        std::string bytes;
    };

    std::uint64_t below(std::uint64_t bound) { return random_.next() % bound; }

    void grant() {
        sentry_.end();
        ++lease_.number;
        key_ = Id128::random(random_).bytes();
        sequence_ = 0;
        newSession();
    }
    /// The same lease under another session, whose numbers begin at 1 as those of another process.
    void resume() {
        sequence_ = 0;
        newSession();
    }
    void newSession() {
        sender_ = {Id128::uuid(random_).toString(), "client1", Role::Operator};
        sentry_.hold(lease_, key_, sender_);
        repeater_.admit("left", {kManager, lease_, key_, Id128::parse(sender_.id).value()});
    }
    void give() {
        ++sequence_;
        given_.insert({lease_.number, sender_.id, sequence_});
        repeater_.stop("left", sequence_, 0);
        collect();
    }
    void collect() {
        for (const auto& out : repeater_.take()) launch(true, {out.bytes.data(), out.bytes.size()});
    }
    void launch(bool to_manager, const std::string& bytes) {
        recorded_.push_back(bytes);
        if (recorded_.size() > 200) recorded_.erase(recorded_.begin());
        for (int copy = below(10) == 0 ? 2 : 1; copy > 0; --copy) {
            if (below(100) < loss_percent_) continue;
            air_.push_back({clock_.now() + std::chrono::milliseconds(below(40)), to_manager, bytes});
        }
    }
    void replay() {
        if (recorded_.empty()) return;
        air_.push_back({clock_.now(), below(4) != 0, recorded_[below(recorded_.size())]});
    }
    void forge() {
        if (recorded_.empty()) return;
        auto bytes = recorded_[below(recorded_.size())];
        bytes[below(bytes.size())] ^= static_cast<char>(1U << below(8));
        if (below(4) == 0) bytes.resize(below(bytes.size() + 1));
        air_.push_back({clock_.now(), true, bytes});
    }
    void pass() {
        clock_.advance(std::chrono::milliseconds(1 + below(8)));
        auto due = std::exchange(air_, {});
        while (!due.empty()) {  // in any order
            const auto at = due.begin() + static_cast<std::ptrdiff_t>(below(due.size()));
            const auto flying = *at;
            due.erase(at);
            if (flying.at > clock_.now()) {
                air_.push_back(flying);
            } else if (flying.to_manager) {
                manager(flying.bytes);
            } else if (const auto ack = repeater_.onDatagram(kManager, flying.bytes)) {
                ++acknowledged_;
                ASSERT_TRUE(executed_.contains({lease_.number, sender_.id, ack->sequence}))
                    << "acknowledged and not executed";
            }
        }
        repeater_.onTimer();
        collect();
    }
    void manager(const std::string& bytes) {
        const auto judged = sentry_.judge(bytes);
        if (judged.verdict == StopSentry::Verdict::Refused) return;
        const Stop stop{judged.datagram.lease.number, judged.sender.id, judged.datagram.sequence};
        if (judged.verdict == StopSentry::Verdict::New) {
            ASSERT_TRUE(given_.contains(stop)) << "nobody gave it";
            ASSERT_EQ(std::get<0>(stop), lease_.number) << "of an earlier lease";
            ASSERT_TRUE(executed_.insert(stop).second) << "executed twice";
        } else {
            ASSERT_TRUE(executed_.contains(stop));
        }
        auto ack = judged.datagram;
        ack.kind = StopDatagram::Kind::Ack;
        const auto answer = encode(ack, judged.key);
        launch(false, {answer.data(), answer.size()});
    }

    SeededRandom random_;
    const std::uint64_t loss_percent_;
    ManualClock clock_;
    StopSentry sentry_;
    StopRepeater repeater_{clock_};
    LeaseNumber lease_{1, 0};
    std::string key_;
    Sender sender_;
    std::int64_t sequence_ = 0;
    std::vector<Flying> air_;
    std::vector<std::string> recorded_;
    std::set<Stop> given_, executed_;
    int acknowledged_ = 0;
};

TEST(StopByDatagram, IsExecutedAtMostOnceAndOnlyWhenGiven) {
    const char* const wish = std::getenv("AXON_SEEDS");
    const int seeds = wish != nullptr ? std::atoi(wish) : 40;
    std::size_t given = 0, executed = 0;
    int acknowledged = 0;
    for (int seed = 1; seed <= seeds; ++seed) {
        SCOPED_TRACE("seed " + std::to_string(seed));
        World world(static_cast<std::uint64_t>(seed));
        world.run(3000);
        if (HasFatalFailure()) return;
        given += world.given();
        executed += world.executed();
        acknowledged += world.acknowledged();
    }
    // Between 0 and 79 % of the datagrams are lost, and nine copies are sent.
    EXPECT_GT(executed, given * 9 / 10);
    EXPECT_GT(acknowledged, 0);
}

}  // namespace
}  // namespace axon::datagrams
