// SPDX-License-Identifier: GPL-2.0-or-later
// The client's end of a data lane and the two threads that read it, beside an Entity Manager's end that the
// test plays over loopback.
#include "client/direct/framed_lane.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include <condition_variable>
#include <functional>
#include <thread>
#include <vector>

#include "direct/lane/frames.hpp"
#include "direct/lane/tls_channel.hpp"
#include "support/certificate_folder.hpp"
#include "support/loopback.hpp"
#include "support/tcp_silence.hpp"

namespace axon::client {
namespace {

using namespace std::chrono_literals;
using direct::Keeping;
using direct::lane::Kind;
using direct::lane::ManagerOpening;
using test::waitUntil;

const std::string kKey = "0123456789abcdef";

/// What a path would do; what a message does in its callback is the test's.
struct Path final : FramedLane::Owner {
    void laneOpen() override { open = true; }
    void laneMessage(const direct::lane::MessageView& message) override {
        std::function<void()> callback;
        {
            const std::lock_guard lock(mutex);
            came.push_back(message.sequence);
            callback = on_message;
        }
        if (callback) callback();
    }
    void laneRead() override {
        std::function<void()> callback;
        {
            const std::lock_guard lock(mutex);
            callback = on_read;
        }
        if (callback) callback();
    }
    void laneOver(const std::string& why) override {
        const std::lock_guard lock(mutex);
        reason = why;
        over = true;
        if (on_over) on_over();
    }
    std::size_t count() {
        const std::lock_guard lock(mutex);
        return came.size();
    }
    bool inOrder() {
        const std::lock_guard lock(mutex);
        for (std::size_t i = 0; i < came.size(); ++i)
            if (came[i] != static_cast<std::int64_t>(i) + 1) return false;
        return true;
    }
    std::atomic<bool> open{false}, over{false};
    std::mutex mutex;
    std::vector<std::int64_t> came;
    std::string reason;
    std::function<void()> on_message, on_read, on_over;
};

/// Blocks whoever passes while it is shut.
struct Barrier {
    void pass() {
        std::unique_lock lock(mutex);
        ++inside;
        changed.notify_all();
        changed.wait(lock, [this] { return open; });
    }
    void letGo() {
        const std::lock_guard lock(mutex);
        open = true;
        changed.notify_all();
    }
    bool taken() {
        const std::lock_guard lock(mutex);
        return inside > 0;
    }
    std::mutex mutex;
    std::condition_variable changed;
    bool open = false;
    int inside = 0;
};

/// With threads that spin, and with some that do not.
class FramedLaneTest : public ::testing::TestWithParam<std::chrono::microseconds> {
  protected:
    FramedLaneTest() {
        address_.sin_family = AF_INET;
        address_.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        socklen_t size = sizeof address_;
        EXPECT_EQ(::bind(listens_.get(), reinterpret_cast<const sockaddr*>(&address_), size), 0);
        EXPECT_EQ(::listen(listens_.get(), 8), 0);
        ::getsockname(listens_.get(), reinterpret_cast<sockaddr*>(&address_), &size);
    }
    ~FramedLaneTest() override { readers->end(); }

    std::shared_ptr<FramedLane> begin(const std::shared_ptr<Path>& path, Duration timeout = 5s) {
        auto socket =
            direct::lane::LaneSocket::connectTo("127.0.0.1:" + std::to_string(ntohs(address_.sin_port)));
        EXPECT_TRUE(socket.ok());
        const auto its = std::make_shared<direct::Claim>(claim);
        auto lane = std::make_shared<FramedLane>(
            readers, std::move(socket).value(), speaks,
            direct::lane::ClientOpening(
                claim,
                [its](const Id128& nonce) {
                    its->nonce = nonce;
                    return direct::proofOf(*its, direct::Prover::Client, kKey);
                },
                [its](std::string_view proof) {
                    return direct::proves(proof, *its, direct::Prover::EntityManager, kKey);
                }),
            transport::OutboxLimits{}, waits, clock, path);
        lane->start(timeout);
        return lane;
    }
    Descriptor accept() { return Descriptor(::accept(listens_.get(), nullptr, nullptr)); }
    static void say(const Descriptor& socket, const std::string& bytes) {
        EXPECT_EQ(::send(socket.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL),
                  static_cast<ssize_t>(bytes.size()));
    }
    static std::string hear(const Descriptor& socket, axon::FrameReader& reader) {
        std::string frame;
        while (!reader.next(frame)) {
            char bytes[4096];
            const auto came = ::recv(socket.get(), bytes, sizeof bytes, 0);
            if (came <= 0) return {};
            reader.feed({bytes, static_cast<std::size_t>(came)});
        }
        return frame;
    }
    /// The Entity Manager's half of an opening.
    Descriptor admit() {
        auto socket = accept();
        ManagerOpening opening(Id128::random(random));
        say(socket, opening.greeting());
        axon::FrameReader reader;
        const auto heard = opening.onFrame(hear(socket, reader));
        EXPECT_EQ(heard.index(), 0U);
        if (const auto* claimed = std::get_if<ManagerOpening::Claimed>(&heard)) {
            EXPECT_TRUE(direct::proves(claimed->proof, claimed->claim, direct::Prover::Client, kKey));
            say(socket, opening.admit(direct::proofOf(claimed->claim, direct::Prover::EntityManager, kKey)));
        }
        return socket;
    }
    static std::string message(std::int64_t sequence, const std::string& content = "content") {
        Header head;
        head.sequence = sequence;
        const auto bytes = direct::lane::headOf(Keeping::Kept, head, content.size());
        return std::string(bytes.value().view()) + content;
    }

    SteadyClock clock;
    FramedLane::Speaks speaks = [](direct::lane::Wire& socket) {
        return std::make_unique<direct::lane::PlainChannel>(socket);
    };
    direct::lane::LaneOutbox::Waits waits;
    SeededRandom random{1};
    direct::Claim claim{Lane::Data, {1, 2}, Id128::random(random), Id128::random(random), {}};
    std::shared_ptr<LaneReaders> readers = std::make_shared<LaneReaders>(clock, GetParam());

  private:
    Descriptor listens_{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
    sockaddr_in address_{};
};

/// A connection on which nothing happens.
struct Quiet final : LaneReaders::Lane {
    int descriptor() const override { return sign.get(); }
    void ready(LaneReaders::Ready) override {}
    void overdue() override {}
    Descriptor sign{::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)};
};

const auto kSpins = ::testing::Values(0us, 50us);
const auto kSpinName = [](const auto& one) { return one.param == 0us ? "Sleeping" : "Spinning"; };

/// Both threads must hear of the end, although one of them may take the sign that was for the other. Without
/// that one round in some ten thousand hangs.
class LaneReadersTest : public ::testing::TestWithParam<std::chrono::microseconds> {};
TEST_P(LaneReadersTest, EndHoweverLateADeadlineWasSet) {
    const SteadyClock clock{};
    for (int round = 0; round < 2000; ++round) {
        LaneReaders readers(clock, GetParam());
        const auto number = readers.next();
        ASSERT_TRUE(readers.add(number, std::make_shared<Quiet>(), clock.now() + 1h));
        for (int i = 0; i < round % 40; ++i) std::this_thread::yield();
        readers.due(number, clock.now() + 2h);
        readers.end();
    }
}

TEST_P(FramedLaneTest, OpensAndCarriesMessagesBothWays) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    const auto manager = admit();
    ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
    std::string burst;
    for (std::int64_t i = 1; i <= 1000; ++i) burst += message(i);
    say(manager, burst);
    ASSERT_TRUE(waitUntil([&] { return path->count() == 1000; }));
    EXPECT_TRUE(path->inOrder());
    Header head;
    head.sequence = 7;
    lane->send(Keeping::Kept, head, std::make_shared<const std::string>("to the entity"));
    axon::FrameReader reader;
    const auto frame = hear(manager, reader);
    ASSERT_TRUE(direct::lane::messageIn(frame));
    EXPECT_EQ(direct::lane::messageIn(frame)->content, "to the entity");
    ::shutdown(manager.get(), SHUT_RDWR);
    ASSERT_TRUE(waitUntil([&] { return path->over.load(); }));
}

TEST_P(FramedLaneTest, WhatCameBeforeTheEndIsTold) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    {
        const auto manager = admit();
        ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
        std::string burst;
        for (std::int64_t i = 1; i <= 3000; ++i) burst += message(i, std::string(500, 'x'));
        say(manager, burst);
    }
    ASSERT_TRUE(waitUntil([&] { return path->over.load(); }));
    EXPECT_EQ(path->count(), 3000U);
    EXPECT_TRUE(path->inOrder());
}

// The other thread is the relief for that.
TEST_P(FramedLaneTest, OneLaneIsReadWhileACallbackOfAnotherDoesNotReturn) {
    const auto blocked = std::make_shared<Path>(), other = std::make_shared<Path>();
    Barrier barrier;
    blocked->on_message = [&] { barrier.pass(); };
    const auto first = begin(blocked);
    const auto manager_of_first = admit();
    const auto second = begin(other);
    const auto manager_of_second = admit();
    ASSERT_TRUE(waitUntil([&] { return blocked->open && other->open; }));
    say(manager_of_first, message(1));
    ASSERT_TRUE(waitUntil([&] { return barrier.taken(); }));
    for (std::int64_t i = 1; i <= 10; ++i) {
        say(manager_of_second, message(i));
        ASSERT_TRUE(waitUntil([&] { return other->count() == static_cast<std::size_t>(i); }));
    }
    barrier.letGo();
    readers->end();  // before what the callback uses
    EXPECT_TRUE(other->inOrder());
}

TEST_P(FramedLaneTest, WhatComesWhileTheReaderIsInACallbackIsReadByTheOtherThreadInOrder) {
    const auto path = std::make_shared<Path>();
    Barrier barrier;
    const auto lane = begin(path);
    const auto manager = admit();
    ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
    {
        const std::lock_guard lock(path->mutex);
        path->on_read = [&, first = std::make_shared<std::atomic<bool>>(true)] {
            if (first->exchange(false)) barrier.pass();
        };
    }
    say(manager, message(1));
    ASSERT_TRUE(waitUntil([&] { return barrier.taken(); }));
    for (std::int64_t i = 2; i <= 200; ++i) say(manager, message(i));
    ASSERT_TRUE(waitUntil([&] { return path->count() == 200; }));
    EXPECT_TRUE(path->inOrder());
    barrier.letGo();
    readers->end();  // before what the callback uses
}

// A thread that spins keeps the kernel from waking the other one, but only until it has found something.
TEST_P(FramedLaneTest, AReaderInACallbackIsRelievedAlsoWhileMessagesComeInQuickSuccession) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    const auto manager = admit();
    ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
    constexpr std::size_t kCount = 3000;
    std::atomic<std::size_t> answered{0};
    std::atomic<int> unrelieved{0};
    {
        const std::lock_guard lock(path->mutex);
        path->on_read = [&] {
            const auto now = path->count();
            if (answered.exchange(now) == now) return;
            Header head;
            head.sequence = static_cast<std::int64_t>(now);
            lane->send(Keeping::Kept, head, std::make_shared<const std::string>("answer"));
            // The next message is the answer's.
            if (now % 10 == 0 && now < kCount && !waitUntil([&] { return path->count() > now; }))
                ++unrelieved;
        };
    }
    axon::FrameReader reader;
    for (std::size_t i = 1; i <= kCount && unrelieved == 0; ++i) {
        say(manager, message(static_cast<std::int64_t>(i)));
        ASSERT_EQ(direct::lane::messageIn(hear(manager, reader)).value().sequence,
                  static_cast<std::int64_t>(i));
    }
    EXPECT_EQ(unrelieved, 0);
    EXPECT_TRUE(path->inOrder());
    readers->end();
}

// Of two lanes that are ready at once, one is left to the other thread.
TEST_P(FramedLaneTest, TwoLanesThatAreReadyAtOnceAreReadAlthoughTheCallbackOfOneDoesNotReturn) {
    for (int round = 0; round < 200; ++round) {
        const auto one = std::make_shared<Path>(), two = std::make_shared<Path>();
        const auto first = begin(one);
        const auto manager_of_one = admit();
        const auto second = begin(two);
        const auto manager_of_two = admit();
        ASSERT_TRUE(waitUntil([&] { return one->open && two->open; }));
        std::atomic<int> inside{0}, left{0};
        // Each returns only when the other one has been called.
        const auto both = [&] {
            ++inside;
            if (!waitUntil([&] { return inside == 2; })) inside = 100;
            ++left;
        };
        {
            const std::lock_guard lock_one(one->mutex), lock_two(two->mutex);
            one->on_message = two->on_message = both;
        }
        say(manager_of_one, message(1));
        say(manager_of_two, message(1));
        ASSERT_TRUE(waitUntil([&] { return one->count() == 1 && two->count() == 1; }));
        ASSERT_TRUE(waitUntil([&] { return left == 2; }));
        ASSERT_EQ(inside, 2) << "round " << round;
        first->end("over");
        second->end("over");
    }
}

TEST_P(FramedLaneTest, AFloodOnOneLaneLeavesTurnsToOthers) {
    const auto flooded = std::make_shared<Path>(), other = std::make_shared<Path>();
    const auto first = begin(flooded);
    const auto manager_of_first = admit();
    const auto second = begin(other);
    const auto manager_of_second = admit();
    ASSERT_TRUE(waitUntil([&] { return flooded->open && other->open; }));
    std::atomic<bool> enough{false};
    std::thread floods([&] {
        std::string burst;
        for (int i = 0; i < 500; ++i) burst += message(1);
        while (!enough)
            if (::send(manager_of_first.get(), burst.data(), burst.size(), MSG_NOSIGNAL) <= 0) return;
    });
    for (std::int64_t i = 1; i <= 20; ++i) {
        say(manager_of_second, message(i));
        EXPECT_TRUE(waitUntil([&] { return other->count() == static_cast<std::size_t>(i); }));
    }
    enough = true;
    floods.join();
}

TEST_P(FramedLaneTest, WhoDoesNotAnswerInTimeIsGivenUp) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path, 50ms);
    const auto silent = accept();
    ASSERT_TRUE(waitUntil([&] { return path->over.load(); }));
    EXPECT_EQ(path->reason, "no answer in time");

    const auto later = std::make_shared<Path>();
    const auto half = begin(later, 50ms);
    const auto manager = accept();
    say(manager, ManagerOpening(Id128::random(random)).greeting());
    ASSERT_TRUE(waitUntil([&] { return later->over.load(); }));
    EXPECT_EQ(later->reason, "no answer in time");
}

// That of the other reader: the blocked one looks at no deadline.
TEST_P(FramedLaneTest, ADeadlineOfOneLanePassesWhileACallbackOfAnotherDoesNotReturn) {
    const auto blocked = std::make_shared<Path>(), before = std::make_shared<Path>(),
               after = std::make_shared<Path>(), answered = std::make_shared<Path>();
    Barrier barrier;
    blocked->on_read = [&, first = std::make_shared<std::atomic<bool>>(true)] {
        if (blocked->count() > 0 && first->exchange(false)) barrier.pass();
    };
    const auto first = begin(blocked);
    const auto manager = admit();
    ASSERT_TRUE(waitUntil([&] { return blocked->open.load(); }));
    const auto second = begin(before, 200ms);
    const auto silent = accept();
    say(manager, message(1));
    ASSERT_TRUE(waitUntil([&] { return barrier.taken(); }));
    const auto third = begin(after, 50ms);
    const auto silent_too = accept();
    ASSERT_TRUE(waitUntil([&] { return after->over && before->over; }));
    // Between the two deadlines of an opening, too: the one that a thread waits for is no longer the next.
    const auto fourth = begin(answered, 100ms);
    const auto half = accept();
    say(half, ManagerOpening(Id128::random(random)).greeting());
    ASSERT_TRUE(waitUntil([&] { return answered->over.load(); }));
    for (const auto& path : {before, after, answered}) {
        const std::lock_guard lock(path->mutex);
        EXPECT_EQ(path->reason, "no answer in time");
    }
    EXPECT_FALSE(blocked->over);
    barrier.letGo();
    readers->end();  // before what the callback uses
}

// Nothing ends such a connection but the kernel, whose half minute is shortened here. The signal lane, which
// may live on, is not asked.
TEST_P(FramedLaneTest, AnEndThatTakesNoBytesOrHearsNothingIsGivenUpByTheKernel) {
    for (const bool deaf : {false, true}) {
        const auto path = std::make_shared<Path>();
        const auto lane = begin(path);
        const auto manager = admit();
        ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
        ASSERT_TRUE(test::losePatienceAfter(lane->descriptor(), 100ms));
        if (deaf) {
            ASSERT_TRUE(test::deafen(manager.get()));
        }
        const auto content = std::make_shared<const std::string>(deaf ? 100 : 1'000'000, 'x');
        for (std::int64_t i = 1; i <= 8; ++i) {  // more than the sockets take, less than may wait
            Header head;
            head.sequence = i;
            lane->send(Keeping::Kept, head, content);
        }
        ASSERT_TRUE(waitUntil([&] { return path->over.load(); })) << deaf;
        const std::lock_guard lock(path->mutex);
        EXPECT_EQ(path->reason.find("the connection was lost"), 0U) << path->reason;
    }
}

TEST_P(FramedLaneTest, WhateverElseAnswersEndsIt) {
    const std::string ice("IceP\1\0\1\0\3\0\16\0\0\0", 14);  // what Ice says first
    for (const auto& answer : {ice, std::string(4, '\0'), std::string("HTTP/1.1 400 Bad Request\r\n\r\n"),
                               direct::lane::frameOf(Kind::Kept, "x")}) {
        const auto path = std::make_shared<Path>();
        const auto lane = begin(path);
        const auto manager = accept();
        say(manager, answer);
        ASSERT_TRUE(waitUntil([&] { return path->over.load(); }));
        EXPECT_FALSE(path->open);
        const std::lock_guard lock(path->mutex);
        EXPECT_NE(path->reason.find("no Entity Manager of this edition"), std::string::npos) << path->reason;
    }
}

TEST_P(FramedLaneTest, ImproperFramesAfterTheOpeningEndIt) {
    const std::string too_long("\x7f\0\0\0\5", 5);
    for (const auto& wrong : {direct::lane::frameOf(Kind::Nonce, std::string(20, 'n')),
                              direct::lane::frameOf(Kind::Kept, "cut"), too_long}) {
        const auto path = std::make_shared<Path>();
        const auto lane = begin(path);
        const auto manager = admit();
        ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
        say(manager, message(1) + wrong);
        ASSERT_TRUE(waitUntil([&] { return path->over.load(); }));
        EXPECT_EQ(path->count(), 1U);
        const std::lock_guard lock(path->mutex);
        EXPECT_NE(path->reason.find("broke the protocol"), std::string::npos) << path->reason;
    }
}

TEST_P(FramedLaneTest, WhatDoesNotFitLeavesWhenTheOtherSideReads) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    const auto manager = admit();
    ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
    const auto content = std::make_shared<const std::string>(1'000'000, 'x');
    std::int64_t sent = 0;
    for (; sent < 8; ++sent) {  // as much as may wait, if the sockets take nothing
        Header head;
        head.sequence = sent + 1;
        lane->send(Keeping::Kept, head, content);
    }
    EXPECT_FALSE(path->over);
    axon::FrameReader reader(direct::lane::kMessageFrameMax);
    for (std::int64_t i = 1; i <= sent && !path->over; ++i)
        ASSERT_EQ(direct::lane::messageIn(hear(manager, reader)).value().sequence, i);
}

TEST_P(FramedLaneTest, ItEndsFromAnyThreadAndOnce) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    const auto manager = admit();
    ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
    lane->end("enough");
    lane->end("once more");
    EXPECT_TRUE(path->over);
    EXPECT_EQ(path->reason, "enough");
    axon::FrameReader reader;
    EXPECT_TRUE(hear(manager, reader).empty()) << "the other side sees it";
    lane->send(Keeping::Kept, {}, std::make_shared<const std::string>("late"));
    readers->end();
    const auto late = std::make_shared<Path>();
    const auto none = begin(late);
    EXPECT_TRUE(late->over) << "there are no readers left";
}

TEST_P(FramedLaneTest, AnOwnerThatIsLetGoOfWhileItEndsIsToldOfTheEnd) {
    auto path = std::make_shared<Path>();
    bool told = false, something_waits = false;
    path->on_over = [&] { told = true; };
    // As another thread does that closes the path: the end begins, and what waited goes, before the owner
    // is told.
    waits = [&](std::size_t) {
        something_waits = true;
        return std::shared_ptr<void>(nullptr, [&](void*) { path = nullptr; });
    };
    const auto lane = begin(path);
    const auto manager = admit();
    ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
    const auto content = std::make_shared<const std::string>(1'000'000, 'x');
    for (int i = 0; i < 40 && !something_waits; ++i) lane->send(Keeping::Kept, {}, content);
    ASSERT_TRUE(something_waits);
    ASSERT_TRUE(path);
    lane->end("enough");
    EXPECT_FALSE(path);
    EXPECT_TRUE(told);
}

INSTANTIATE_TEST_SUITE_P(Threads, LaneReadersTest, kSpins, kSpinName);
INSTANTIATE_TEST_SUITE_P(Threads, FramedLaneTest, kSpins, kSpinName);

/// An Entity Manager's end of a lane over TLS.
class TlsManager {
  public:
    TlsManager(Descriptor socket, const std::shared_ptr<const direct::lane::Tls>& tls)
        : socket_(std::move(socket)), channel_(tls->fromCaller(socket_)) {}
    /// Until the handshake is over; whether it succeeded.
    bool shakeHands() {
        while (state_ == Channel::State::Opening && receive()) {
        }
        return state_ == Channel::State::Open;
    }
    void say(std::string_view bytes) {
        while (!bytes.empty()) {
            const auto taken = channel_->write({&bytes, 1});
            ASSERT_TRUE(taken);
            bytes.remove_prefix(*taken);
        }
    }
    std::string hear() {
        std::string frame;
        while (!frames_.next(frame))
            if (!receive()) return {};
        return frame;
    }

  private:
    using Channel = direct::lane::Channel;
    bool receive() {
        pollfd one{socket_.descriptor(), POLLIN, 0};
        if (::poll(&one, 1, 5000) != 1) return false;
        const auto came = socket_.read(channel_->room(frames_));
        if (came.bytes > 0) state_ = channel_->filled(frames_, came.bytes);
        return came.end == direct::lane::LaneSocket::Read::End::No;
    }
    direct::lane::LaneSocket socket_;
    std::unique_ptr<Channel> channel_;
    axon::FrameReader frames_{direct::lane::kMessageFrameMax};
    Channel::State state_ = Channel::State::Opening;
};

class TlsLaneTest : public FramedLaneTest {
  protected:
    TlsLaneTest() {
        speaks = [this](direct::lane::Wire& socket) { return client_->toEntity("robot", socket); };
    }
    std::string reasonOf(const std::shared_ptr<Path>& path) {
        EXPECT_TRUE(waitUntil([&] { return path->over.load(); }));
        const std::lock_guard lock(path->mutex);
        return path->reason;
    }
    const test::CertificateFolder laboratory_;
    const std::shared_ptr<const direct::lane::Tls> client_ = direct::lane::Tls::of(
        laboratory_.credentials(certificates::Kind::Client, "ann"), test::CertificateFolder::now);
    const std::shared_ptr<const direct::lane::Tls> robot_ = direct::lane::Tls::of(
        laboratory_.credentials(certificates::Kind::Entity, "robot"), test::CertificateFolder::now);
};

INSTANTIATE_TEST_SUITE_P(, TlsLaneTest, ::testing::Values(std::chrono::microseconds{0}),
                         [](const auto&) { return "Sleeping"; });

TEST_P(TlsLaneTest, OpensAndCarriesMessagesBothWays) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    TlsManager manager(accept(), robot_);
    ASSERT_TRUE(manager.shakeHands());
    ManagerOpening opening(Id128::random(random));
    manager.say(opening.greeting());
    const auto heard = opening.onFrame(manager.hear());
    ASSERT_EQ(heard.index(), 0U);
    manager.say(
        opening.admit(direct::proofOf(std::get<0>(heard).claim, direct::Prover::EntityManager, kKey)));
    ASSERT_TRUE(waitUntil([&] { return path->open.load(); }));
    std::string burst;
    for (std::int64_t i = 1; i <= 1000; ++i)
        burst += message(i, std::string(static_cast<std::size_t>(i * i % 3000), 'x'));
    std::thread writes([&] {  // at the same time as the readers read
        for (std::int64_t i = 1; i <= 50; ++i) {
            Header head;
            head.sequence = i;
            lane->send(Keeping::Kept, head, std::make_shared<const std::string>(50'000, 'y'));
        }
    });
    manager.say(burst);
    for (std::int64_t i = 1; i <= 50; ++i) {
        const auto frame = manager.hear();
        ASSERT_TRUE(direct::lane::messageIn(frame));
        EXPECT_EQ(direct::lane::messageIn(frame)->sequence, i);
    }
    writes.join();
    ASSERT_TRUE(waitUntil([&] { return path->count() == 1000; }));
    EXPECT_TRUE(path->inOrder());
}

TEST_P(TlsLaneTest, AnotherEntityIsNotTalkedTo) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    TlsManager manager(accept(),
                       direct::lane::Tls::of(laboratory_.credentials(certificates::Kind::Entity, "left"),
                                             test::CertificateFolder::now));
    EXPECT_FALSE(manager.shakeHands());
    EXPECT_NE(reasonOf(path).find("the entity 'left'; expected that of the entity 'robot'"),
              std::string::npos)
        << path->reason;
}

TEST_P(TlsLaneTest, WhoeverDoesNotSpeakTlsIsNotTalkedTo) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    const auto plain = accept();
    say(plain, ManagerOpening(Id128::random(random)).greeting());
    EXPECT_NE(reasonOf(path).find("does not speak TLS"), std::string::npos) << path->reason;
}

TEST_P(TlsLaneTest, AConnectionThatClosesInTheHandshakeIsOver) {
    const auto path = std::make_shared<Path>();
    const auto lane = begin(path);
    ::shutdown(accept().get(), SHUT_RDWR);
    EXPECT_NE(reasonOf(path), "");
    const auto silent = std::make_shared<Path>();
    const auto later = begin(silent, 50ms);
    const auto manager = accept();
    EXPECT_EQ(reasonOf(silent), "no answer in time");
}

}  // namespace
}  // namespace axon::client
