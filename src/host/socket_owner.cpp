// SPDX-License-Identifier: MIT
#include "host/socket_owner.hpp"

#include <arpa/inet.h>
#include <linux/inet_diag.h>
#include <linux/netlink.h>
#include <linux/sock_diag.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <vector>

#include "common/descriptor.hpp"

namespace axon {
namespace {

/// The address of one end, in the network's order. Of IPv4 the first word alone counts.
struct End {
    std::uint8_t family = AF_INET;
    std::array<std::uint32_t, 4> words{};
    std::uint16_t port = 0;  // in this machine's order
};

std::optional<End> endOf(const std::string& endpoint) {
    const auto colon = endpoint.rfind(':');
    if (colon == std::string::npos) return std::nullopt;
    End out;
    const auto [end, error] =
        std::from_chars(endpoint.data() + colon + 1, endpoint.data() + endpoint.size(), out.port);
    if (error != std::errc{} || end != endpoint.data() + endpoint.size()) return std::nullopt;
    const auto host = endpoint.substr(0, colon);
    if (inet_pton(AF_INET, host.c_str(), out.words.data()) == 1) return out;
    out.family = AF_INET6;
    if (inet_pton(AF_INET6, host.c_str(), out.words.data()) != 1) return std::nullopt;
    return out;
}

/// An address as /proc writes it: words of the network's order printed as numbers of this machine's.
struct Written {
    std::string v4;  // empty for one of IPv6
    std::string v6;
};

Written written(const End& end) {
    std::array<char, 48> text{};
    const auto& words = end.words;
    if (end.family == AF_INET) {
        Written out;
        std::snprintf(text.data(), text.size(), "%08X:%04X", words[0], end.port);
        out.v4 = text.data();
        std::snprintf(text.data(), text.size(), "0000000000000000%08X%08X:%04X", htonl(0xffff), words[0],
                      end.port);
        out.v6 = text.data();
        return out;
    }
    std::snprintf(text.data(), text.size(), "%08X%08X%08X%08X:%04X", words[0], words[1], words[2], words[3],
                  end.port);
    return Written{{}, text.data()};
}

std::vector<std::string_view> words(std::string_view line) {
    std::vector<std::string_view> out;
    for (auto at = line.find_first_not_of(' '); at != std::string_view::npos;
         at = line.find_first_not_of(' ', at)) {
        const auto end = std::min(line.find(' ', at), line.size());
        out.push_back(line.substr(at, end - at));
        at = end;
    }
    return out;
}

std::string contentOf(const char* file) {
    std::ifstream stream(file);
    return {std::istreambuf_iterator<char>(stream), {}};
}

/// Not open where the kernel has no such sockets, or does not let this process have one.
Descriptor netlinkSocket() {
    Descriptor out(::socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_SOCK_DIAG));
    // The kernel answers before send() returns: this is for one that does not.
    const timeval patience{.tv_sec = 0, .tv_usec = 100'000};
    if (out.open()) ::setsockopt(out.get(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    return out;
}

enum class Reply : std::uint8_t { None, NoSuchSocket, Socket };

/// One socket, by the addresses of both its ends as it has them itself.
Reply askFor(int netlink, const End& local, const End& remote, inet_diag_msg& found) {
    struct {
        nlmsghdr head;
        inet_diag_req_v2 body;
    } request{};
    request.head.nlmsg_len = sizeof request;
    request.head.nlmsg_type = SOCK_DIAG_BY_FAMILY;
    request.head.nlmsg_flags = NLM_F_REQUEST;
    request.body.sdiag_family = local.family;
    request.body.sdiag_protocol = IPPROTO_TCP;
    request.body.idiag_states = 1U << TCP_ESTABLISHED;
    auto& id = request.body.id;
    id.idiag_sport = htons(local.port);
    id.idiag_dport = htons(remote.port);
    std::copy(local.words.begin(), local.words.end(), id.idiag_src);
    std::copy(remote.words.begin(), remote.words.end(), id.idiag_dst);
    id.idiag_cookie[0] = id.idiag_cookie[1] = INET_DIAG_NOCOOKIE;
    if (::send(netlink, &request, sizeof request, 0) != static_cast<ssize_t>(sizeof request))
        return Reply::None;
    alignas(nlmsghdr) std::array<char, 8192> buffer;
    ssize_t got = 0;
    do {
        got = ::recv(netlink, buffer.data(), buffer.size(), 0);
    } while (got < 0 && errno == EINTR);
    if (got < static_cast<ssize_t>(sizeof(nlmsghdr))) return Reply::None;
    nlmsghdr head;
    std::memcpy(&head, buffer.data(), sizeof head);
    const auto* payload = buffer.data() + NLMSG_HDRLEN;
    const auto size = static_cast<std::size_t>(got) - NLMSG_HDRLEN;
    if (head.nlmsg_type == NLMSG_ERROR && size >= sizeof(nlmsgerr)) {
        nlmsgerr error;
        std::memcpy(&error, payload, sizeof error);
        return error.error == -ENOENT ? Reply::NoSuchSocket : Reply::None;
    }
    if (head.nlmsg_type != SOCK_DIAG_BY_FAMILY || size < sizeof found) return Reply::None;
    std::memcpy(&found, payload, sizeof found);
    return Reply::Socket;
}

/// Of the socket that has these two ends, and not of one that listens at the first.
bool isConnection(const inet_diag_msg& found, const End& local, const End& remote) {
    return found.idiag_state == TCP_ESTABLISHED && found.id.idiag_sport == htons(local.port) &&
           found.id.idiag_dport == htons(remote.port);
}

}  // namespace

std::optional<std::uint32_t> socketOwner(std::string_view table, const std::string& from,
                                         const std::string& to) {
    const auto its_end = endOf(from);
    const auto our_end = endOf(to);
    if (!its_end || !our_end) return std::nullopt;
    const auto its = written(*its_end);
    const auto ours = written(*our_end);
    while (!table.empty()) {
        const auto end = table.find('\n');
        const auto line = table.substr(0, end);
        table = end == std::string_view::npos ? std::string_view() : table.substr(end + 1);
        // sl local remote state queues timer retransmits uid timeout inode …
        const auto of = words(line);
        if (of.size() < 10 || of[3] != "01" || of[9] == "0") continue;
        const bool four = !its.v4.empty() && of[1] == its.v4 && of[2] == ours.v4;
        if (!four && (of[1] != its.v6 || of[2] != ours.v6)) continue;
        std::uint32_t uid = 0;
        const auto [last, error] = std::from_chars(of[7].data(), of[7].data() + of[7].size(), uid);
        if (error != std::errc{} || last != of[7].data() + of[7].size()) return std::nullopt;
        return uid;
    }
    return std::nullopt;
}

KernelAnswer askKernel(const std::string& from, const std::string& to) {
    const auto its = endOf(from);
    const auto ours = endOf(to);
    if (!its || !ours || its->family != ours->family) return {.heard = true, .uid = std::nullopt};
    const auto netlink = netlinkSocket();
    if (!netlink.open()) return {};
    inet_diag_msg found{};
    switch (askFor(netlink.get(), *its, *ours, found)) {
        case Reply::None:
            return {};
        case Reply::NoSuchSocket:
            // That is also the answer of a kernel without inet_diag, which does not find our own end either.
            return {.heard = askFor(netlink.get(), *ours, *its, found) == Reply::Socket, .uid = std::nullopt};
        case Reply::Socket:
            break;
    }
    // One that no process has any more belongs to root, says the kernel.
    if (!isConnection(found, *its, *ours) || found.idiag_inode == 0)
        return {.heard = true, .uid = std::nullopt};
    return {.heard = true, .uid = found.idiag_uid};
}

std::optional<std::uint32_t> socketOwner(const std::string& from, const std::string& to) {
    if (const auto answer = askKernel(from, to); answer.heard) return answer.uid;
    if (const auto uid = socketOwner(contentOf("/proc/net/tcp"), from, to)) return uid;
    return socketOwner(contentOf("/proc/net/tcp6"), from, to);
}

}  // namespace axon
