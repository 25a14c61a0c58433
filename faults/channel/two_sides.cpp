// SPDX-License-Identifier: GPL-2.0-or-later
#include "channel/two_sides.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/if_tun.h>
#include <net/if.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <fstream>
#include <vector>

namespace axon::faults {
namespace {

using namespace std::chrono_literals;

constexpr int kMtu = 1500;

void require(bool done, const std::string& what, const char* fix) {
    if (!done) throw NotPermitted(what + ": " + std::strerror(errno) + "; fix: " + fix);
}

/// Who is not root becomes it in a user namespace of its own, where the kernel lets ordinary users have one.
void becomeRoot() {
    if (::geteuid() == 0) return;
    const auto uid = ::geteuid();
    const auto gid = ::getegid();
    require(::unshare(CLONE_NEWUSER) == 0, "a user namespace", "run it as root");
    std::ofstream("/proc/self/setgroups") << "deny";
    std::ofstream("/proc/self/uid_map") << "0 " << uid << " 1";
    std::ofstream("/proc/self/gid_map") << "0 " << gid << " 1";
}

class Configuration {
  public:
    Configuration() : fd_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {}
    void up(const char* device) const {
        auto request = requestFor(device);
        request.ifr_flags = IFF_UP | IFF_RUNNING;
        set(SIOCSIFFLAGS, request, "bringing a device up");
    }
    void address(const char* device, unsigned long what, const char* value) const {
        auto request = requestFor(device);
        sockaddr_in address{};
        address.sin_family = AF_INET;
        ::inet_pton(AF_INET, value, &address.sin_addr);
        std::memcpy(&request.ifr_addr, &address, sizeof address);
        set(what, request, "an address for a device");
    }
    void mtu(const char* device) const {
        auto request = requestFor(device);
        request.ifr_mtu = kMtu;
        set(SIOCSIFMTU, request, "the largest packet of a device");
    }

  private:
    static ifreq requestFor(const char* device) {
        ifreq request{};
        std::strncpy(request.ifr_name, device, IFNAMSIZ - 1);
        return request;
    }
    void set(unsigned long what, ifreq& request, const char* name) const {
        require(::ioctl(fd_.get(), what, &request) == 0, name, "run it as root, or with CAP_NET_ADMIN");
    }
    const Descriptor fd_;
};

/// The calling thread is in the new namespace afterwards.
std::pair<Descriptor, Descriptor> makeSide(const char* here, const char* there) {
    require(::unshare(CLONE_NEWNET) == 0, "a network namespace", "run it as root, or with CAP_SYS_ADMIN");
    Descriptor tun(::open("/dev/net/tun", O_RDWR | O_CLOEXEC | O_NONBLOCK));
    require(tun.open(), "/dev/net/tun", "load the kernel's module tun, and permit the device");
    ifreq request{};
    std::strncpy(request.ifr_name, "radio0", IFNAMSIZ - 1);
    request.ifr_flags = IFF_TUN | IFF_NO_PI;
    require(::ioctl(tun.get(), TUNSETIFF, &request) == 0, "a TUN device",
            "run it as root, or with CAP_NET_ADMIN");
    const Configuration configuration;
    configuration.up("lo");
    configuration.address("radio0", SIOCSIFADDR, here);
    configuration.address("radio0", SIOCSIFDSTADDR, there);
    configuration.mtu("radio0");
    configuration.up("radio0");
    Descriptor space(::open("/proc/thread-self/ns/net", O_RDONLY | O_CLOEXEC));
    require(space.open(), "/proc/thread-self/ns/net", "mount /proc");
    return {std::move(space), std::move(tun)};
}

}  // namespace

/// Reads both devices and writes each packet into the other at its time.
class TwoSides::Carrier {
  public:
    Carrier(const ChannelSettings& settings, std::uint64_t seed, int left, int right)
        : outages_(settings, seed, SteadyClock().now()),
          lanes_{Lane{left, right, Channel(settings, seed + 1, outages_), {}},
                 Lane{right, left, Channel(settings, seed + 2, outages_), {}}},
          wake_(::eventfd(0, EFD_CLOEXEC)),
          thread_([this] { run(); }) {}
    ~Carrier() { finish(); }
    Report finish() {
        if (thread_.joinable()) {
            ending_ = true;
            const std::uint64_t one = 1;
            (void)!::write(wake_.get(), &one, sizeof one);
            thread_.join();
        }
        return {lanes_[0].channel.counters(), lanes_[1].channel.counters(), outages_.count()};
    }

  private:
    struct Packet {
        TimePoint due;
        std::vector<char> bytes;
    };
    struct Lane {
        int from, to;
        Channel channel;
        std::deque<Packet> flying;
    };

    void run() {
        pthread_setname_np(pthread_self(), "channel");
        sched_param parameters{};
        parameters.sched_priority = 20;
        pthread_setschedparam(pthread_self(), SCHED_RR, &parameters);
        const SteadyClock clock{};
        while (!ending_) {
            auto next = TimePoint::max();
            for (auto& lane : lanes_) {
                deliver(lane, clock.now());
                if (!lane.flying.empty()) next = std::min(next, lane.flying.front().due);
            }
            const auto wait =
                next == TimePoint::max() ? Duration(1s) : std::max<Duration>(next - clock.now(), 0ns);
            const timespec time{wait / 1s, static_cast<long>((wait % 1s).count())};
            std::array<pollfd, 3> waiting{
                {{wake_.get(), POLLIN, 0}, {lanes_[0].from, POLLIN, 0}, {lanes_[1].from, POLLIN, 0}}};
            ::ppoll(waiting.data(), waiting.size(), &time, nullptr);
            for (auto& lane : lanes_) take(lane, clock);
        }
    }
    static void take(Lane& lane, const Clock& clock) {
        std::array<char, kMtu + 100> bytes;
        while (true) {
            const auto got = ::read(lane.from, bytes.data(), bytes.size());
            if (got <= 0) return;
            const auto size = static_cast<std::size_t>(got);
            if (const auto due = lane.channel.pass(clock.now(), size))
                lane.flying.push_back({*due, {bytes.data(), bytes.data() + size}});
        }
    }
    static void deliver(Lane& lane, TimePoint now) {
        while (!lane.flying.empty() && lane.flying.front().due <= now) {
            const auto& bytes = lane.flying.front().bytes;
            (void)!::write(lane.to, bytes.data(), bytes.size());
            lane.flying.pop_front();
        }
    }

    Outages outages_;
    std::array<Lane, 2> lanes_;
    const Descriptor wake_;
    std::atomic<bool> ending_{false};
    std::thread thread_;
};

TwoSides::TwoSides(const ChannelSettings& settings, std::uint64_t seed) {
    becomeRoot();
    std::tie(namespaces_[0], tuns_[0]) = makeSide(kLeft, kRight);
    std::tie(namespaces_[1], tuns_[1]) = makeSide(kRight, kLeft);
    carrier_ = std::make_unique<Carrier>(settings, seed, tuns_[0].get(), tuns_[1].get());
}

TwoSides::~TwoSides() = default;

void TwoSides::enter(Side side) const {
    require(::setns(namespaces_[static_cast<int>(side)].get(), CLONE_NEWNET) == 0,
            "entering a network namespace", "run it as root, or with CAP_SYS_ADMIN");
}

pid_t TwoSides::start(Side side, const std::string& command) const {
    const bool left = side == Side::Left;
    const pid_t child = ::fork();
    if (child != 0) return child;
    ::setpgid(0, 0);
    ::setenv("AXON_CHANNEL_HERE", left ? kLeft : kRight, 1);
    ::setenv("AXON_CHANNEL_THERE", left ? kRight : kLeft, 1);
    if (::setns(namespaces_[static_cast<int>(side)].get(), CLONE_NEWNET) == 0)
        ::execl("/bin/sh", "sh", "-c", command.c_str(), static_cast<char*>(nullptr));
    ::_exit(126);
}

TwoSides::Report TwoSides::finish() {
    return carrier_->finish();
}

}  // namespace axon::faults
