// SPDX-License-Identifier: GPL-2.0-or-later
#include "datagrams/signal_socket.hpp"

#include <netinet/in.h>
#include <netinet/ip.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <array>

namespace axon::datagrams {
namespace {

struct Option {
    const char* name;
    int level;
    int number;
    int value;
};

// Newer than the kernel headers of Debian 12; the numbers are those of Linux' uapi/linux/tcp.h.
constexpr int kTcpRtoMaxMs = 44, kTcpRtoMinUs = 45, kTcpDelackMaxUs = 46;
constexpr int kExpeditedForwarding = 46 << 2;  // RFC 3246, in the byte's upper six bits
constexpr int kInteractive = 6;                // TC_PRIO_INTERACTIVE; 7 would need CAP_NET_ADMIN

constexpr std::array kTcp{
    Option{"TCP_NODELAY", IPPROTO_TCP, TCP_NODELAY, 1},
    Option{"TCP_USER_TIMEOUT", IPPROTO_TCP, TCP_USER_TIMEOUT, 10'000},
    Option{"TCP_RTO_MIN_US", IPPROTO_TCP, kTcpRtoMinUs, 10'000},
    Option{"TCP_RTO_MAX_MS", IPPROTO_TCP, kTcpRtoMaxMs, 1'000},
    Option{"TCP_THIN_LINEAR_TIMEOUTS", IPPROTO_TCP, TCP_THIN_LINEAR_TIMEOUTS, 1},
    Option{"TCP_DELACK_MAX_US", IPPROTO_TCP, kTcpDelackMaxUs, 8'000},
};
// The kernel derives a priority from the type of service, so it is set after it.
constexpr std::array kMarks{
    Option{"IP_TOS", IPPROTO_IP, IP_TOS, kExpeditedForwarding},
    Option{"SO_PRIORITY", SOL_SOCKET, SO_PRIORITY, kInteractive},
};
// The one that every Linux permits. With BBR a connection never counts as thin, and every time-out doubles
// the next.
constexpr char kCongestion[] = "reno";
constexpr Option kBuffer{"SO_RCVBUF", SOL_SOCKET, SO_RCVBUF, 32 * 1024};  // the kernel doubles it

template <class Options>
void set(int fd, const Options& options, std::vector<std::string>& missing) {
    for (const auto& option : options)
        if (::setsockopt(fd, option.level, option.number, &option.value, sizeof option.value) != 0)
            missing.emplace_back(option.name);
}

}  // namespace

std::vector<std::string> prepareSignalSocket(int fd) {
    std::vector<std::string> missing;
    set(fd, kTcp, missing);
    if (::setsockopt(fd, IPPROTO_TCP, TCP_CONGESTION, kCongestion, sizeof kCongestion - 1) != 0)
        missing.emplace_back("TCP_CONGESTION");
    set(fd, kMarks, missing);
    return missing;
}

std::vector<std::string> prepareDatagramSocket(int fd) {
    std::vector<std::string> missing;
    set(fd, kMarks, missing);
    set(fd, std::array{kBuffer}, missing);
    return missing;
}

}  // namespace axon::datagrams
