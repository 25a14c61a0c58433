// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lab_server.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <system_error>
#include <utility>

namespace axon::lab {
namespace {

constexpr Duration kTick = std::chrono::milliseconds{8};  // of the wall clock between two looks at it
constexpr Duration kTruthPeriod = std::chrono::milliseconds{100};  // of the world
constexpr Duration kLongestLag = std::chrono::milliseconds{250};   // of the world; more is given up

[[noreturn]] void fail(const std::string& what) {
    throw std::system_error(errno, std::generic_category(), what);
}

class Descriptor {
  public:
    explicit Descriptor(int fd = -1) : fd_(fd) {}
    ~Descriptor() { reset(); }
    Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
    Descriptor& operator=(Descriptor&& other) noexcept {
        std::swap(fd_, other.fd_);
        return *this;
    }
    int get() const { return fd_; }
    explicit operator bool() const { return fd_ >= 0; }
    void reset() {
        if (fd_ >= 0) ::close(fd_);
        fd_ = -1;
    }

  private:
    int fd_;
};

Descriptor listenOn(const std::string& address, int port) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(port));
    if (::inet_pton(AF_INET, address.c_str(), &to.sin_addr) != 1) {
        errno = EINVAL;
        fail(fmt::format("--listen {}: expected an IPv4 address such as 127.0.0.1", address));
    }
    Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    if (!socket) fail("socket");
    const int one = 1;
    ::setsockopt(socket.get(), SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    if (::bind(socket.get(), reinterpret_cast<sockaddr*>(&to), sizeof to) != 0 ||
        ::listen(socket.get(), 4) != 0) {
        fail(
            fmt::format("cannot listen on {}:{}; another laboratory may be running: choose another --port, "
                        "or 0 for a free one",
                        address, port));
    }
    return socket;
}

int portOf(const Descriptor& socket) {
    sockaddr_in bound{};
    socklen_t size = sizeof bound;
    if (::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&bound), &size) != 0) fail("getsockname");
    return ntohs(bound.sin_port);
}

}  // namespace

class LabServer::Loop {
  public:
    Loop(WorldDescription world, Options options)
        : options_(std::move(options)),
          robots_(std::move(world.robots)),
          wake_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)),
          lab_((world.robots = robots_, world),
               [this](std::size_t robot, const arcos::Bytes& bytes) { send(robot, bytes); }) {
        if (!wake_) fail("eventfd");
        if (!options_.truth_path.empty()) {
            truth_ = Descriptor(
                ::open(options_.truth_path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644));
            if (!truth_) fail("--truth " + options_.truth_path);
        }
        int next = options_.first_port;
        for (const auto& robot : robots_) {
            const int port = robot.port.value_or(next);
            if (port > 65535)
                throw BadDescription(
                    fmt::format("robot {} would get port {}: choose a smaller --port", robot.name, port));
            links_.push_back({listenOn(options_.listen, port), Descriptor{}});
            if (port != 0) next = port + 1;
        }
    }

    std::vector<int> ports() const {
        std::vector<int> ports;
        for (const auto& link : links_) ports.push_back(portOf(link.listener));
        return ports;
    }

    void stop() noexcept {
        const std::uint64_t one = 1;
        [[maybe_unused]] const auto written = ::write(wake_.get(), &one, sizeof one);
    }

    void run() {
        auto pace_start = clock_.now();
        auto pace_age = lab_.age();
        std::vector<pollfd> watched;
        while (true) {
            watched.assign(1, {wake_.get(), POLLIN, 0});
            for (const auto& link : links_) {
                watched.push_back({link.listener.get(), POLLIN, 0});
                watched.push_back({link.client.get(), POLLIN, 0});  // a negative descriptor is passed over
            }
            // Sleeping in whole ticks, whatever arrives: commands wait for the next tick, 100 wake-ups a
            // second suffice.
            next_tick_ = std::max(next_tick_ + kTick, clock_.now());
            waitUntil(next_tick_);
            ::poll(watched.data(), watched.size(), 0);
            if ((watched[0].revents & POLLIN) != 0) return;
            for (std::size_t i = 0; i < links_.size(); ++i) {
                if (watched[2 * i + 1].revents != 0) accept(i);
                if (watched[2 * i + 2].revents != 0) read(i);
            }

            const auto due =
                pace_age + std::chrono::duration_cast<Duration>((clock_.now() - pace_start) * options_.speed);
            if (due - lab_.age() > std::max<Duration>(kLongestLag, std::chrono::duration_cast<Duration>(
                                                                       kTick * options_.speed * 3))) {
                // Too slow, or the process was stopped for a while: give up the lost time instead of racing
                // after it.
                pace_start = clock_.now();
                pace_age = lab_.age() + Physics::kPeriod;
                noteLag();
                step();
                continue;
            }
            while (lab_.age() < due) step();
        }
    }

  private:
    struct Link {
        Descriptor listener;
        Descriptor client;
    };

    void waitUntil(TimePoint when) const {
        const auto left = when - clock_.now();
        if (left <= Duration::zero()) return;
        pollfd wake{wake_.get(), POLLIN, 0};
        const timespec time{0, static_cast<long>(left.count())};
        ::ppoll(&wake, 1, &time, nullptr);
    }

    void step() {
        lab_.step();
        if (truth_ && lab_.age() >= next_truth_) {
            next_truth_ += kTruthPeriod;
            writeTruth();
        }
        for (std::size_t i = 0; i < links_.size(); ++i) {
            if (links_[i].client && broken_[i]) drop(i);
        }
    }

    void noteLag() {
        if (std::exchange(lag_noted_, true)) return;
        std::fputs(
            "axon-lab: this machine is too slow for the asked speed, or was suspended; the world runs "
            "behind\n",
            stderr);
    }

    void writeTruth() {
        std::string lines;
        for (std::size_t i = 0; i < robots_.size(); ++i) {
            const auto t = lab_.truth(i);
            lines += fmt::format(
                R"({{"time_s":{:.3f},"monotonic_us":{},"name":"{}","robot":{},"x_m":{:.4f},"y_m":{:.4f},"theta_deg":{:.2f},"speed_m_s":{:.4f},"rotation_deg_s":{:.2f}}})"
                "\n",
                std::chrono::duration<double>(lab_.age()).count(), toMicroseconds(clock_.now()),
                robots_[i].name, i, t.x_m, t.y_m, t.theta_deg, t.speed_m_s, t.rotation_deg_s);
        }
        if (::write(truth_.get(), lines.data(), lines.size()) < 0) {
            std::perror("axon-lab: --truth");
            truth_.reset();
        }
    }

    void accept(std::size_t robot) {
        Descriptor client(
            ::accept4(links_[robot].listener.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
        if (!client || links_[robot].client) return;  // busy: closing the connection is the refusal
        const int one = 1;
        ::setsockopt(client.get(), IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
        links_[robot].client = std::move(client);
        broken_[robot] = false;
        lab_.clientConnected(robot);
    }

    void read(std::size_t robot) {
        std::array<std::uint8_t, 4096> chunk;
        const auto got = ::recv(links_[robot].client.get(), chunk.data(), chunk.size(), 0);
        if (got > 0) {
            lab_.receive(robot, std::span(chunk).first(static_cast<std::size_t>(got)));
        } else if (got == 0 || (errno != EAGAIN && errno != EINTR)) {
            drop(robot);
        }
    }

    void send(std::size_t robot, const arcos::Bytes& bytes) {
        if (!links_[robot].client) return;
        const auto sent =
            ::send(links_[robot].client.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
        // Not dropped here: the laboratory is in the middle of a step.
        if (sent != static_cast<ssize_t>(bytes.size())) broken_[robot] = true;
    }

    void drop(std::size_t robot) {
        links_[robot].client.reset();
        lab_.clientLost(robot);
    }

    const Options options_;
    const std::vector<RobotPlacement> robots_;
    const SteadyClock clock_;
    Descriptor wake_;
    Laboratory lab_;
    std::vector<Link> links_;
    std::vector<char> broken_ = std::vector<char>(robots_.size());
    Descriptor truth_;
    TimePoint next_tick_{};
    Duration next_truth_{};
    bool lag_noted_ = false;
};

LabServer::LabServer(WorldDescription world, Options options)
    : loop_(std::make_unique<Loop>(std::move(world), std::move(options))) {}
LabServer::~LabServer() = default;
std::vector<int> LabServer::ports() const {
    return loop_->ports();
}
void LabServer::run() {
    loop_->run();
}
void LabServer::stop() noexcept {
    loop_->stop();
}

}  // namespace axon::lab
