// SPDX-License-Identifier: MIT
#include "host/link_users.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <pwd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>

#include "host/port_range.hpp"
#include "host/socket_owner.hpp"

namespace axon {
namespace {

std::optional<uid_t> uidOf(const std::string& name) {
    uid_t number = 0;
    const auto [end, error] = std::from_chars(name.data(), name.data() + name.size(), number);
    if (error == std::errc{} && end == name.data() + name.size()) return number;
    passwd entry{};
    passwd* found = nullptr;
    std::array<char, 4096> texts;
    if (::getpwnam_r(name.c_str(), &entry, texts.data(), texts.size(), &found) != 0 || found == nullptr)
        return std::nullopt;
    return entry.pw_uid;
}

struct End {
    std::string address;
    std::string text;  // with the port
};

template <class Ask>
std::optional<End> endOf(int socket, Ask ask) {
    sockaddr_in at{};
    socklen_t size = sizeof at;
    if (ask(socket, reinterpret_cast<sockaddr*>(&at), &size) != 0 || at.sin_family != AF_INET)
        return std::nullopt;
    std::array<char, INET_ADDRSTRLEN> text{};
    ::inet_ntop(AF_INET, &at.sin_addr, text.data(), text.size());
    return End{text.data(), std::string(text.data()) + ":" + std::to_string(ntohs(at.sin_port))};
}

}  // namespace

Result<LinkUsers> LinkUsers::parse(std::string_view names, std::string_view where) {
    LinkUsers out;
    while (true) {
        const auto from = names.find_first_not_of(" \t,");
        if (from == std::string_view::npos) return out;
        names.remove_prefix(from);
        const std::string name(names.substr(0, names.find_first_of(" \t,")));
        names.remove_prefix(name.size());
        const auto uid = uidOf(name);
        if (!uid)
            return Refusal{RefusalCode::Malformed,
                           std::string(where) + ": '" + name.substr(0, 80) +
                               "' is not a user of this machine: expected names or numbers, as in "
                               "'Axon.Users = axon 1001'; fix: correct the name",
                           {}};
        out.uids_.push_back(*uid);
    }
}

bool LinkUsers::admits(uid_t uid) const {
    return uid == 0 || uid == ::geteuid() || std::find(uids_.begin(), uids_.end(), uid) != uids_.end();
}

std::optional<Refusal> LinkUsers::check(int socket) const {
    const auto peer = endOf(socket, ::getpeername);
    const auto own = endOf(socket, ::getsockname);
    const auto uid = peer && own ? socketOwner(peer->text, own->text) : std::nullopt;
    if (uid) {
        if (admits(*uid)) return std::nullopt;
        const auto its = std::to_string(*uid);
        return Refusal{RefusalCode::PermissionDenied,
                       "the other end of the link belongs to the user with the number " + its +
                           ", this one to " + std::to_string(::geteuid()) +
                           "; fix: run both as one user, or allow the other user with 'Axon.Users = " + its +
                           "' (in ports.cfg, or in the options of this end)",
                       {}};
    }
    if (peer && own && !isLoopback(peer->address) && peer->address != own->address) return std::nullopt;
    return Refusal{
        RefusalCode::PermissionDenied,
        "the kernel does not say which user owns the other end of the link: it has just been closed, or a "
        "sandbox forbids netlink and /proc/net/tcp to this process; fix: permit one of the two",
        {}};
}

}  // namespace axon
