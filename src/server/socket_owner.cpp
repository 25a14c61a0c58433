// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/socket_owner.hpp"

#include <arpa/inet.h>

#include <array>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <vector>

namespace axon::server {
namespace {

/// An address as the kernel writes it: words of the network's order printed as numbers of this machine's.
struct Written {
    std::string v4;  // empty for one of IPv6
    std::string v6;
};

std::optional<Written> written(const std::string& endpoint) {
    const auto colon = endpoint.rfind(':');
    if (colon == std::string::npos) return std::nullopt;
    unsigned port = 0;
    const auto [end, error] =
        std::from_chars(endpoint.data() + colon + 1, endpoint.data() + endpoint.size(), port);
    if (error != std::errc{} || end != endpoint.data() + endpoint.size() || port > 65535) return std::nullopt;
    const auto host = endpoint.substr(0, colon);
    std::array<char, 48> text{};
    in_addr four{};
    if (inet_pton(AF_INET, host.c_str(), &four) == 1) {
        Written out;
        std::snprintf(text.data(), text.size(), "%08X:%04X", four.s_addr, port);
        out.v4 = text.data();
        std::snprintf(text.data(), text.size(), "0000000000000000%08X%08X:%04X", htonl(0xffff), four.s_addr,
                      port);
        out.v6 = text.data();
        return out;
    }
    in6_addr six{};
    if (inet_pton(AF_INET6, host.c_str(), &six) != 1) return std::nullopt;
    std::array<std::uint32_t, 4> words{};
    std::memcpy(words.data(), &six, sizeof six);
    std::snprintf(text.data(), text.size(), "%08X%08X%08X%08X:%04X", words[0], words[1], words[2], words[3],
                  port);
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

}  // namespace

std::optional<std::uint32_t> socketOwner(std::string_view table, const std::string& from,
                                         const std::string& to) {
    const auto its = written(from);
    const auto ours = written(to);
    if (!its || !ours) return std::nullopt;
    while (!table.empty()) {
        const auto end = table.find('\n');
        const auto line = table.substr(0, end);
        table = end == std::string_view::npos ? std::string_view() : table.substr(end + 1);
        // sl local remote state queues timer retransmits uid timeout inode …
        const auto of = words(line);
        if (of.size() < 10 || of[3] != "01" || of[9] == "0") continue;
        const bool four = !its->v4.empty() && of[1] == its->v4 && of[2] == ours->v4;
        if (!four && (of[1] != its->v6 || of[2] != ours->v6)) continue;
        std::uint32_t uid = 0;
        const auto [last, error] = std::from_chars(of[7].data(), of[7].data() + of[7].size(), uid);
        if (error != std::errc{} || last != of[7].data() + of[7].size()) return std::nullopt;
        return uid;
    }
    return std::nullopt;
}

std::optional<std::uint32_t> socketOwner(const std::string& from, const std::string& to) {
    if (const auto uid = socketOwner(contentOf("/proc/net/tcp"), from, to)) return uid;
    return socketOwner(contentOf("/proc/net/tcp6"), from, to);
}

}  // namespace axon::server
