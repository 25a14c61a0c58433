// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/byte_stream.hpp"

#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <stdexcept>

#include "common/descriptor.hpp"

namespace axon::robots {
namespace {

class TcpStream final : public ByteStream {
  public:
    explicit TcpStream(int fd) : fd_(fd) {}

    int descriptor() const override { return fd_.get(); }

    int read(std::span<std::uint8_t> into) override {
        const auto got = ::recv(fd_.get(), into.data(), into.size(), MSG_DONTWAIT);
        if (got > 0) return static_cast<int>(got);
        return got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR) ? 0 : -1;
    }

    bool write(std::span<const std::uint8_t> bytes) override {
        const auto sent = ::send(fd_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
        return sent == static_cast<ssize_t>(bytes.size());
    }

  private:
    const Descriptor fd_;
};

struct Speed {
    int baud;
    speed_t code;
};
constexpr std::array<Speed, 5> kSpeeds{
    {{9600, B9600}, {19200, B19200}, {38400, B38400}, {57600, B57600}, {115200, B115200}}};

const Speed* findSpeed(int baud) {
    const auto* const found = std::find_if(kSpeeds.begin(), kSpeeds.end(),
                                           [baud](const Speed& speed) { return speed.baud == baud; });
    return found == kSpeeds.end() ? nullptr : found;
}

class SerialStream final : public ByteStream {
  public:
    SerialStream(int fd, int asked_speed) : fd_(fd), speed_{.asked = asked_speed} {}

    int descriptor() const override { return fd_.get(); }

    int read(std::span<std::uint8_t> into) override {
        const auto got = ::read(fd_.get(), into.data(), into.size());
        if (got > 0) return static_cast<int>(got);
        // With VMIN 1 nothing yet is EAGAIN, and zero is a line that was hung up.
        return got < 0 && (errno == EAGAIN || errno == EINTR) ? 0 : -1;
    }

    bool write(std::span<const std::uint8_t> bytes) override {
        return ::write(fd_.get(), bytes.data(), bytes.size()) == static_cast<ssize_t>(bytes.size());
    }

    LineSpeed speed() const override { return speed_; }

    bool setSpeed(int baud) override {
        const auto* const speed = findSpeed(baud);
        termios line{};
        if (speed == nullptr || ::tcgetattr(fd_.get(), &line) != 0) return false;
        ::cfsetspeed(&line, speed->code);
        if (::tcsetattr(fd_.get(), TCSANOW, &line) != 0) return false;
        speed_.baud = baud;
        return true;
    }

  private:
    const Descriptor fd_;
    LineSpeed speed_;
};

Refusal notConnected(const std::string& address, const char* why) {
    return {RefusalCode::NotConnected, "cannot connect to the robot at " + address + ": " + why, {}};
}

Result<std::unique_ptr<ByteStream>> connectTo(const std::string& address, const std::string& host,
                                              const std::string& port, Duration timeout) {
    addrinfo hints{};
    hints.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    if (const int error = ::getaddrinfo(host.c_str(), port.c_str(), &hints, &found); error != 0) {
        return notConnected(address, ::gai_strerror(error));
    }
    const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> addresses(found, &::freeaddrinfo);
    int error = EHOSTUNREACH;
    for (const auto* candidate = found; candidate != nullptr; candidate = candidate->ai_next) {
        const int fd = ::socket(candidate->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
        if (fd < 0) {
            error = errno;
            continue;
        }
        auto stream = std::make_unique<TcpStream>(fd);
        const int one = 1;
        ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
        if (::connect(fd, candidate->ai_addr, candidate->ai_addrlen) == 0)
            return std::unique_ptr<ByteStream>(std::move(stream));
        error = errno;
        if (error != EINPROGRESS) continue;
        pollfd waiting{fd, POLLOUT, 0};
        const auto ms = std::chrono::duration_cast<std::chrono::milliseconds>(timeout).count();
        if (::poll(&waiting, 1, static_cast<int>(ms)) <= 0) {
            error = ETIMEDOUT;
            continue;
        }
        socklen_t size = sizeof error;
        ::getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size);
        if (error == 0) return std::unique_ptr<ByteStream>(std::move(stream));
    }
    return notConnected(address, std::strerror(error));
}

Result<std::unique_ptr<ByteStream>> openSerial(const std::string& path, int asked_speed) {
    const int fd = ::open(path.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0) {
        return notConnected(path, errno == EACCES ? "permission denied: is this user in the group dialout?"
                                                  : std::strerror(errno));
    }
    auto stream = std::make_unique<SerialStream>(fd, asked_speed);
    // Two programs on one line would each see half of the answers.
    if (::flock(fd, LOCK_EX | LOCK_NB) != 0) return notConnected(path, "another program uses this line");
    termios line{};
    if (::tcgetattr(fd, &line) != 0) return notConnected(path, "this is not a serial line");
    ::cfmakeraw(&line);
    line.c_cflag |= CLOCAL | CREAD;
    line.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | CRTSCTS);
    line.c_cc[VMIN] = 1;
    line.c_cc[VTIME] = 0;
    if (::tcsetattr(fd, TCSANOW, &line) != 0) return notConnected(path, std::strerror(errno));
    if (!stream->setSpeed(asked_speed != 0 ? asked_speed : kFirstSpeed))
        return notConnected(path, "the line does not have this speed");
    // What the robot said to an earlier program is no answer to this one.
    ::tcflush(fd, TCIOFLUSH);
    return std::unique_ptr<ByteStream>(std::move(stream));
}

}  // namespace

StreamOpener tcpStreams(const std::string& address) {
    const auto colon = address.rfind(':');
    const auto port = colon == std::string::npos ? std::string{} : address.substr(colon + 1);
    int number = 0;
    const auto parsed = std::from_chars(port.data(), port.data() + port.size(), number);
    if (colon == 0 || parsed.ec != std::errc{} || parsed.ptr != port.data() + port.size() || number < 1 ||
        number > 65535) {
        throw std::invalid_argument(
            "robot address \"" + address +
            "\": expected host:port with a port from 1 to 65535, for example 127.0.0.1:8101");
    }
    return [address, host = address.substr(0, colon), port](Duration timeout) {
        return connectTo(address, host, port, timeout);
    };
}

StreamOpener serialStreams(const std::string& device) {
    const auto colon = device.rfind(':');
    const auto path = device.substr(0, colon);
    int asked_speed = 0;
    bool good = !path.empty();
    if (colon != std::string::npos) {
        const auto text = device.substr(colon + 1);
        const auto parsed = std::from_chars(text.data(), text.data() + text.size(), asked_speed);
        good = good && parsed.ec == std::errc{} && parsed.ptr == text.data() + text.size() &&
               findSpeed(asked_speed) != nullptr;
    }
    if (!good)
        throw std::invalid_argument(
            "robot address \"" + device +
            "\": expected a device, with :9600, :19200, :38400, :57600 or :115200 for its "
            "speed, for example /dev/ttyUSB0:38400");
    return [path, asked_speed](Duration /*timeout*/) { return openSerial(path, asked_speed); };
}

StreamOpener robotStreams(const std::string& address) {
    return address.starts_with('/') ? serialStreams(address) : tcpStreams(address);
}

}  // namespace axon::robots
