// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/guarded_streams.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <fstream>

#include "common/descriptor.hpp"
#include "tests/support/loopback.hpp"

namespace axon::robots {
namespace {

using namespace std::chrono_literals;
using test::waitUntil;

const std::string kStop = "STOP";

class SocketStream final : public ByteStream {
  public:
    explicit SocketStream(Descriptor socket) : socket_(std::move(socket)) {}
    int descriptor() const override { return socket_.get(); }
    int read(std::span<std::uint8_t> into) override {
        const auto got = ::recv(socket_.get(), into.data(), into.size(), MSG_DONTWAIT);
        return got > 0 ? static_cast<int>(got) : got < 0 && errno == EAGAIN ? 0 : -1;
    }
    bool write(std::span<const std::uint8_t> bytes) override {
        return ::send(socket_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL) ==
               static_cast<ssize_t>(bytes.size());
    }

  private:
    Descriptor socket_;
};

class GuardedStreamsTest : public ::testing::Test {
  protected:
    void open() {
        stream_.reset();
        auto opened = opener_(1s);
        ASSERT_TRUE(opened) << opened.refusal().message;
        stream_ = std::move(opened).value();
    }
    bool order(const std::string& bytes) {
        return stream_->write({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()});
    }
    int read() { return stream_->read(bytes_); }
    std::string heard() {
        std::array<char, 256> bytes{};
        const auto got = ::recv(device_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT);
        return got > 0 ? std::string(bytes.data(), static_cast<std::size_t>(got)) : std::string();
    }
    /// The guard's process: this one's only child.
    static int guard() {
        const auto self = std::to_string(::getpid());
        int child = 0;
        std::ifstream("/proc/" + self + "/task/" + self + "/children") >> child;
        return child;
    }

    Descriptor device_;
    std::array<std::uint8_t, 16> bytes_{};
    StreamOpener opener_ = guardedStreams(
        [this](Duration /*timeout*/) -> Result<std::unique_ptr<ByteStream>> {
            std::array<int, 2> ends{};
            if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0)
                return Refusal{RefusalCode::NotConnected, "socketpair", {}};
            device_ = Descriptor(ends[0]);
            return std::unique_ptr<ByteStream>(std::make_unique<SocketStream>(Descriptor(ends[1])));
        },
        {.device = "the test's", .stop = kStop, .silence = 100ms, .logger = [](const std::string&) {}});
    std::unique_ptr<ByteStream> stream_;
};

TEST_F(GuardedStreamsTest, CarryWhatIsSentAndNothingElse) {
    open();
    EXPECT_TRUE(order("GO"));
    EXPECT_EQ(read(), 0);
    EXPECT_EQ(heard(), "GO");
    stream_.reset();
    EXPECT_EQ(heard(), "");
}

TEST_F(GuardedStreamsTest, WithoutTheGuardTheRobotIsStoppedAndNoOrderFollowsTheStop) {
    open();
    ASSERT_EQ(::kill(guard(), SIGKILL), 0);
    EXPECT_TRUE(waitUntil([&] { return read() < 0; }));
    EXPECT_FALSE(order("GO"));
    EXPECT_LT(read(), 0);
    EXPECT_EQ(heard(), kStop) << "once, and nothing behind it";
    open();
    EXPECT_TRUE(order("GO"));
    EXPECT_EQ(read(), 0);
    EXPECT_EQ(heard(), "GO");
}

TEST_F(GuardedStreamsTest, WhoeverDoesNotReadIsStoppedAndOrdersNothingMore) {
    open();
    std::string all;
    EXPECT_TRUE(waitUntil([&] { return (all += heard()).find(kStop) == 0; }));
    EXPECT_FALSE(order("GO"));
    EXPECT_LT(read(), 0);
}

TEST(GuardedSerialLineTest, ChangesItsSpeedIsStoppedAtThatAndIsFreeAgainOnceItIsClosed) {
    const Descriptor robot(::posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
    std::array<char, 100> path{};
    ASSERT_TRUE(::grantpt(robot.get()) == 0 && ::unlockpt(robot.get()) == 0 &&
                ::ptsname_r(robot.get(), path.data(), path.size()) == 0);
    const auto line = serialStreams(path.data());
    auto stream = guardedStreams(line, {.device = path.data(), .stop = kStop, .silence = 100ms})(1s).value();
    EXPECT_EQ(stream->speed().baud, kFirstSpeed);
    EXPECT_TRUE(stream->setSpeed(38400));
    EXPECT_EQ(stream->speed().baud, 38400);

    std::string heard;
    EXPECT_TRUE(waitUntil([&] {
        std::array<char, 256> bytes{};
        const auto got = ::read(robot.get(), bytes.data(), bytes.size());
        if (got > 0) heard.append(bytes.data(), static_cast<std::size_t>(got));
        return heard.find(kStop) == 0;
    }));
    termios speed{};
    ASSERT_EQ(::tcgetattr(robot.get(), &speed), 0);
    EXPECT_EQ(::cfgetospeed(&speed), static_cast<speed_t>(B38400));

    std::array<std::uint8_t, 16> bytes{};
    EXPECT_LT(stream->read(bytes), 0);
    EXPECT_FALSE(line(1s)) << "there is one program on a line";
    stream.reset();
    EXPECT_TRUE(waitUntil([&] { return static_cast<bool>(line(1s)); })) << "the guard keeps the line";
}

}  // namespace
}  // namespace axon::robots
