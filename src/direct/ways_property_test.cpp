// SPDX-License-Identifier: GPL-2.0-or-later
// Both halves of one direction with two ways between them: a relayed one that is slow, keeps its order and
// may drop data, and direct paths that are opened, delayed, cut at any moment on either side, and lose what
// is under way then. Claims: every message that may not be lost comes once, in the order of sending, with its
// content; data comes at most once and never behind newer data; nothing overtakes what was sent before; what
// is acknowledged has come.
#include <gtest/gtest.h>

#include <cstdlib>
#include <deque>
#include <string>
#include <vector>

#include "direct/incoming_way.hpp"
#include "direct/outgoing_way.hpp"

namespace axon::direct {
namespace {

struct Message {
    Keeping keeping = Keeping::Kept;
    std::int64_t sequence = 0;
    std::string content;
};

class World {
  public:
    explicit World(std::uint64_t seed)
        : random_(seed),
          out_({static_cast<std::size_t>(2 + below(40)), static_cast<std::size_t>(200 + below(4000))}),
          in_({static_cast<std::size_t>(2 + below(40)), static_cast<std::size_t>(200 + below(4000))}),
          relay_speed_(1 + below(8)),
          direct_speed_(1 + below(8)),
          trouble_(1 + below(60)) {}

    void run(int steps) {
        for (int i = 0; i < steps; ++i) {
            if (below(3) == 0) send();
            if (below(8) < relay_speed_) relayArrives();
            if (below(8) < direct_speed_) directArrives();
            if (below(6) == 0) acknowledge();
            if (below(trouble_) == 0) trouble();
            if (::testing::Test::HasFatalFailure()) return;
        }
        // In the end the direct path is over in some way, and the relayed one delivers what it has.
        if (below(2) == 0) senderNotices();
        while (!direct_.empty() && open_at_receiver_) directArrives();
        senderNotices();
        while (!relay_.empty()) relayArrives();
    }
    void judge() const {
        std::size_t next = 0;
        for (const auto& message : passed_) {
            if (message.keeping != Keeping::Kept) continue;
            ASSERT_LT(next, sent_.size());
            ASSERT_EQ(message.sequence, sent_[next].sequence);
            ASSERT_EQ(message.content, sent_[next].content);
            ++next;
        }
        ASSERT_EQ(next, sent_.size()) << "not everything has come";
        std::int64_t last = 0;
        for (const auto& message : passed_) {  // one order for all
            ASSERT_GT(message.sequence, last);
            last = message.sequence;
        }
    }
    std::size_t sent() const { return sent_.size(); }
    int by_direct = 0, left_out = 0, held_back = 0, given_up = 0, breaks = 0;

  private:
    struct Relayed {
        bool is_mark = false;
        Id128 path;
        Message message;
    };
    struct Direct {
        Id128 path;
        Message message;
    };
    std::uint64_t below(std::uint64_t bound) { return random_.next() % bound; }

    void send() {
        Message message;
        message.keeping = below(4) == 0 ? Keeping::Droppable : Keeping::Kept;
        message.sequence = sequence_ += 1 + static_cast<std::int64_t>(below(3));
        message.content = std::to_string(random_.next());
        const auto bytes = 10 + below(200);
        if (message.keeping == Keeping::Kept) {
            sent_.push_back(message);
            if (out_.direct() && !out_.hasRoom(bytes)) {
                ++given_up;
                senderNotices();
            }
        }
        if (!out_.direct()) {
            relay_.push_back({false, {}, message});
            return;
        }
        if (message.keeping == Keeping::Kept) out_.keep(message.sequence, bytes, message);
        if (intact_) direct_.push_back({sender_path_, message});
    }
    void relayArrives() {
        if (relay_.empty()) return;
        const auto item = std::move(relay_.front());
        relay_.pop_front();
        if (item.is_mark) {
            in_.mark(item.path, [&](Message message) { pass(std::move(message), true); });
            return;
        }
        if (item.message.keeping == Keeping::Droppable && below(5) == 0)
            return;  // a server had too much of it
        if (in_.relayed(item.message.keeping, item.message.sequence) == Verdict::Pass)
            pass(item.message, false);
        else
            ++left_out;
    }
    void directArrives() {
        if (direct_.empty()) return;
        auto item = std::move(direct_.front());
        direct_.pop_front();
        auto message = item.message;
        switch (in_.direct(item.path, item.message.keeping, item.message.sequence, 100, message)) {
            case Verdict::Pass:
                return pass(item.message, true);
            case Verdict::HeldBack:
                ++held_back;
                return;
            case Verdict::LeftOut:
                ++left_out;
                return;
            case Verdict::Overflow:
                open_at_receiver_ = false;
                cut();
                return;
        }
    }
    void pass(Message message, bool direct) {
        if (direct) ++by_direct;
        passed_.push_back(std::move(message));
    }
    void acknowledge() {
        // Seen now, or a while ago.
        const auto seen = below(2) == 0 ? in_.passed() : acknowledged_;
        acknowledged_ = in_.passed();
        out_.acknowledged(seen);
    }
    void trouble() {
        switch (below(5)) {
            case 0:  // the connection is cut: what is under way is lost, from some message on
                cut();
                return;
            case 1:  // the receiver gives it up first
                in_.close(receiver_path_);
                open_at_receiver_ = false;
                return cut();
            case 2:
                return senderNotices();
            default:
                return openAnew();
        }
    }
    void cut() {
        intact_ = false;
        while (!direct_.empty() && below(3) != 0) direct_.pop_back();
    }
    void senderNotices() {
        if (!out_.direct()) return;
        ++breaks;
        intact_ = false;
        for (auto& kept : out_.end()) relay_.push_back({false, {}, std::move(kept.message)});
    }
    void openAnew() {
        if (out_.direct()) return;  // the sender tries again when it knows that the path before is over
        const auto path = Id128::random(random_);
        if (below(4) != 0) direct_.clear();  // else stragglers of the old one come in between
        in_.open(path);
        receiver_path_ = path;
        open_at_receiver_ = true;
        if (below(5) == 0) return;  // the answer did not arrive: the sender never takes it
        relay_.push_back({true, path, {}});
        sender_path_ = path;
        intact_ = true;
        out_.begin();
    }

    SeededRandom random_;
    OutgoingWay<Message> out_;
    IncomingWay<Message> in_;
    const std::uint64_t relay_speed_, direct_speed_, trouble_;
    std::deque<Relayed> relay_;
    std::deque<Direct> direct_;
    std::vector<Message> sent_, passed_;
    std::int64_t sequence_ = 0, acknowledged_ = 0;
    Id128 sender_path_, receiver_path_;
    bool intact_ = false, open_at_receiver_ = false;
};

TEST(WaysProperty, EveryMessageComesOnceAndInOrderWhateverTheDirectPathDoes) {
    const char* given = std::getenv("AXON_SEED");
    const std::uint64_t first = given != nullptr ? std::strtoull(given, nullptr, 10) : 1;
    const std::uint64_t last = given != nullptr ? first : 4000;
    std::size_t sent = 0;
    int by_direct = 0, left_out = 0, held_back = 0, given_up = 0, breaks = 0;
    for (auto seed = first; seed <= last; ++seed) {
        SCOPED_TRACE("AXON_SEED=" + std::to_string(seed));
        World world(seed);
        world.run(400);
        world.judge();
        if (HasFatalFailure()) return;
        sent += world.sent();
        by_direct += world.by_direct;
        left_out += world.left_out;
        held_back += world.held_back;
        given_up += world.given_up;
        breaks += world.breaks;
    }
    // A model that never gets there would find nothing.
    EXPECT_GT(by_direct, 1000);
    EXPECT_GT(left_out, 1000);
    EXPECT_GT(held_back, 1000);
    EXPECT_GT(given_up, 100);
    EXPECT_GT(breaks, 1000);
    RecordProperty("messages", std::to_string(sent));
}

}  // namespace
}  // namespace axon::direct
