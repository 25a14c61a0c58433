// SPDX-License-Identifier: GPL-2.0-or-later
// A data lane over pairs of real sockets, opened by its frames, with both halves of one direction above it
// and a relayed way beside it. At random: writes and reads in pieces, a reader that pauses, floods, cuts at
// any byte, an opening that nobody ends. Claims: every message that may not be lost comes once, in the order
// of sending, with its content; data comes at most once and in order; a path is opened by the right key only.
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "common/frame.hpp"
#include "direct/lane/lane_outbox.hpp"
#include "direct/lane/lane_socket.hpp"
#include "direct/lane/opening.hpp"
#include "direct/outgoing_way.hpp"
#include "support/setting.hpp"

namespace axon::direct::lane {
namespace {

struct Message {
    Keeping keeping = Keeping::Kept;
    std::int64_t sequence = 0;
    std::shared_ptr<const std::string> content;
};

/// Takes of what it is given as much as it likes.
class Moody final : public Wire {
  public:
    Moody(LaneSocket& socket, SeededRandom& random) : socket_(socket), random_(random) {}
    std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
        if (random_.next() % 3 != 0) return socket_.write(pieces);
        if (random_.next() % 3 == 0) return 0;
        const auto part = pieces[0].substr(0, 1 + random_.next() % 40);
        return socket_.write({&part, 1});
    }

  private:
    LaneSocket& socket_;
    SeededRandom& random_;
};

transport::OutboxLimits limits() {
    transport::OutboxLimits its;
    its.window_bytes = 2000;
    its.data_bytes = 4000;
    its.control_bytes = 30'000;
    return its;
}

struct End {
    End(int fd, SeededRandom& random) : socket(Descriptor(fd)), moody(socket, random) {}
    LaneSocket socket;
    Moody moody;
    FrameReader reader{kOpeningMax};
};

/// One path: the client's end, and the Entity Manager's.
struct Path {
    Path(const std::array<int, 2>& fds, SeededRandom& random, const Id128& its_number)
        : number(its_number),
          client(fds[0], random),
          manager(fds[1], random),
          outbox(limits(), client.moody),
          hears(Id128::random(random)) {
        const int small = 4096;
        for (const int fd : fds) ::setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &small, sizeof small);
    }
    const Id128 number;
    End client, manager;
    LaneOutbox outbox;
    ManagerOpening hears;
    std::unique_ptr<ClientOpening> asks;
    Claim claim;
    std::string to_client, to_manager;  // of the opening, not written yet
    bool greeted = false, open_at_client = false, over = false;
};

class World {
  public:
    explicit World(std::uint64_t seed)
        : random_(seed),
          out_({static_cast<std::size_t>(2 + below(40)), static_cast<std::size_t>(2000 + below(40'000))}),
          trouble_(5 + below(200)),
          pause_(1 + below(10)),
          flood_(1 + below(12)),
          largest_(1 + below(6000)) {}

    void run(int steps) {
        for (int i = 0; i < steps && !::testing::Test::HasFatalFailure(); ++i) {
            if (below(3) == 0)
                for (auto more = below(flood_); more-- > 0;) send();
            if (below(2) == 0) relayArrives();
            if (path_) turn();
            if (below(6) == 0) acknowledge();
            if (below(trouble_) == 0) trouble();
        }
        if (path_ && below(2) == 0)
            for (int i = 0; i < 500 && path_; ++i) turn();
        notice();
        while (!relay_.empty()) relayArrives();
    }
    void judge() const {
        std::size_t next = 0;
        std::int64_t last = 0;
        for (const auto& message : passed_) {
            ASSERT_GT(message.sequence, last) << "one order for all, and nothing twice";
            last = message.sequence;
            ASSERT_EQ(*message.content, contentOf(message.sequence, message.content->size()));
            if (message.keeping != Keeping::Kept) continue;
            ASSERT_LT(next, sent_.size());
            ASSERT_EQ(message.sequence, sent_[next++]);
        }
        ASSERT_EQ(next, sent_.size()) << "not everything has come";
    }
    int by_lane = 0, opened = 0, waited = 0, breaks = 0, strangers = 0;

  private:
    struct Relayed {
        bool is_mark = false;
        Id128 path;
        Message message;
    };
    std::uint64_t below(std::uint64_t bound) { return random_.next() % bound; }
    static std::string contentOf(std::int64_t sequence, std::size_t size) {
        std::string content(size, '\0');
        for (std::size_t i = 0; i < size; ++i)
            content[i] = static_cast<char>(static_cast<std::size_t>(sequence) * 31 + i);
        return content;
    }

    void send() {
        Message message;
        message.keeping = below(4) == 0 ? Keeping::Droppable : Keeping::Kept;
        message.sequence = sequence_ += 1 + static_cast<std::int64_t>(below(3));
        message.content = std::make_shared<const std::string>(contentOf(message.sequence, below(largest_)));
        const bool keeps = message.keeping == Keeping::Kept;
        if (keeps) {
            sent_.push_back(message.sequence);
            if (out_.direct() && !out_.hasRoom(message.content->size())) notice();
        }
        if (!out_.direct()) {
            relay_.push_back({false, {}, message});
            return;
        }
        if (keeps) out_.keep(message.sequence, message.content->size(), message);
        if (!path_ || path_->over) return;
        Header head;
        head.sequence = message.sequence;
        head.msg_type = below(2) == 0 ? kMsgText : "";
        if (path_->outbox.post(message.keeping, head, message.content) != LaneOutbox::Outcome::Taken)
            path_->over = true;
        if (path_->outbox.waiting()) ++waited;
    }
    void relayArrives() {
        if (relay_.empty()) return;
        const auto item = std::move(relay_.front());
        relay_.pop_front();
        if (item.is_mark)
            in_.mark(item.path, [&](Message message) { passed_.push_back(std::move(message)); });
        else if (in_.relayed(item.message.keeping, item.message.sequence) == Verdict::Pass)
            passed_.push_back(item.message);
    }

    /// Both ends do what a reading and writing thread would.
    void turn() {
        auto& path = *path_;
        if (!path.greeted) {
            path.greeted = true;
            path.to_client = path.hears.greeting();
        }
        put(path.manager, path.to_client);
        put(path.client, path.to_manager);
        if (path.open_at_client && path.outbox.waiting() && path.outbox.flush() != LaneOutbox::Outcome::Taken)
            path.over = true;
        if (below(pause_) == 0) read(path.client, [&](std::string_view frame) { toClient(frame); });
        if (below(pause_) == 0) read(path.manager, [&](std::string_view frame) { toManager(frame); });
        if (path.over) notice();
    }
    void put(End& end, std::string& bytes) {
        if (bytes.empty()) return;
        const std::string_view piece(bytes);
        const auto taken = end.moody.write({&piece, 1});
        if (!taken) path_->over = true;
        bytes.erase(0, taken.value_or(0));
    }
    template <class Frame>
    void read(End& end, Frame frame) {
        const auto room = end.reader.room();
        const auto came = end.socket.read(room.subspan(0, std::min(room.size(), 1 + below(9000))));
        end.reader.filled(came.bytes);
        while (!path_->over) {
            const auto next = end.reader.nextView();
            if (!next) break;
            frame(*next);
        }
        if (end.reader.failed() || came.end != LaneSocket::Read::End::No) path_->over = true;
    }
    void toClient(std::string_view frame) {
        auto& path = *path_;
        auto answer = path.asks->onFrame(frame);
        if (answer.index() == 1) {
            path.over = true;
            return;
        }
        path.to_manager += std::get<0>(answer);
        if (path.asks->state() != ClientOpening::State::Open) return;
        ++opened;
        path.open_at_client = true;
        path.client.reader.setLimit(kMessageFrameMax);
        relay_.push_back({true, path.number, {}});
        out_.begin();
    }
    void toManager(std::string_view frame) {
        auto& path = *path_;
        if (path.hears.state() != ManagerOpening::State::Open) {
            auto claimed = path.hears.onFrame(frame);
            ASSERT_EQ(claimed.index(), 0U);
            const auto& [claim, proof] = std::get<0>(claimed);
            const bool right = proves(proof, claim, Prover::Client, kKey);
            ASSERT_EQ(right, !wrong_key_);
            if (right) {
                in_.open(claim.path);
                path.manager.reader.setLimit(kMessageFrameMax);
                path.to_client = path.hears.admit(proofOf(claim, Prover::EntityManager, kKey));
            } else {
                ++strangers;
                path.to_client = path.hears.refuse({RefusalCode::PermissionDenied, "no", {}});
            }
            return;
        }
        const auto view = messageIn(frame);
        ASSERT_TRUE(view);
        Message message{view->keeping, view->sequence, std::make_shared<const std::string>(view->content)};
        auto held = message;
        switch (in_.direct(path.number, view->keeping, view->sequence, view->content.size(), held)) {
            case Verdict::Pass:
                ++by_lane;
                passed_.push_back(message);
                return;
            case Verdict::Overflow:
                path.over = true;
                return;
            default:
                return;
        }
    }
    void acknowledge() {
        const auto seen = below(2) == 0 ? in_.passed() : acknowledged_;
        acknowledged_ = in_.passed();
        out_.acknowledged(seen);
    }
    void trouble() {
        if (!path_) return openAnew();
        switch (below(3)) {
            case 0:
                path_->manager.socket.shut();
                return;
            case 1:
                in_.close(path_->number);
                path_->over = true;
                return;
            default:
                return notice();
        }
    }
    /// The sender knows that its path is over.
    void notice() {
        if (path_) ++breaks;
        path_ = nullptr;
        for (auto& kept : out_.end()) relay_.push_back({false, {}, std::move(kept.message)});
    }
    void openAnew() {
        std::array<int, 2> fds{};
        ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, fds.data()), 0);
        path_ = std::make_unique<Path>(fds, random_, Id128::random(random_));
        wrong_key_ = below(10) == 0;
        auto& claim = path_->claim;
        claim = {Lane::Data, {1, 2}, Id128::random(random_), path_->number, {}};
        const std::string key = wrong_key_ ? "another key of 16" : kKey;
        path_->asks = std::make_unique<ClientOpening>(
            claim,
            [&claim, key = key.substr(0, 16)](const Id128& nonce) {
                claim.nonce = nonce;
                return proofOf(claim, Prover::Client, key);
            },
            [&claim](std::string_view proof) { return proves(proof, claim, Prover::EntityManager, kKey); });
    }

    static inline const std::string kKey = "0123456789abcdef";
    SeededRandom random_;
    OutgoingWay<Message> out_;
    IncomingWay<Message> in_;
    const std::uint64_t trouble_, pause_, flood_, largest_;
    std::deque<Relayed> relay_;
    std::unique_ptr<Path> path_;
    std::vector<std::int64_t> sent_;
    std::vector<Message> passed_;
    std::int64_t sequence_ = 0, acknowledged_ = 0;
    bool wrong_key_ = false;
};

TEST(LaneProperty, EveryMessageComesOnceAndInOrderWhateverTheConnectionDoes) {
    const auto only = test::setting("AXON_SEED", 0);
    const auto first = std::max<std::uint64_t>(only, 1);
    const auto last = only != 0 ? only : 10 * test::setting("AXON_SEEDS", 100);  // ./check --full: 1000
    int by_lane = 0, opened = 0, waited = 0, breaks = 0, strangers = 0;
    for (auto seed = first; seed <= last; ++seed) {
        SCOPED_TRACE("AXON_SEED=" + std::to_string(seed));
        World world(seed);
        world.run(300);
        world.judge();
        if (HasFatalFailure()) return;
        by_lane += world.by_lane;
        opened += world.opened;
        waited += world.waited;
        breaks += world.breaks;
        strangers += world.strangers;
    }
    if (only != 0) return;
    // A model that never gets there would find nothing.
    const int seeds = static_cast<int>(last);
    EXPECT_GT(by_lane, seeds);
    EXPECT_GT(opened, seeds / 2);
    EXPECT_GT(waited, seeds / 10);
    EXPECT_GT(breaks, seeds / 2);
    EXPECT_GT(strangers, seeds / 100);
}

}  // namespace
}  // namespace axon::direct::lane
