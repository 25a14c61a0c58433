// SPDX-License-Identifier: MIT
#include "host/port_range.hpp"

#include <arpa/inet.h>

#include <charconv>
#include <fstream>
#include <iterator>
#include <optional>
#include <utility>

namespace axon {
namespace {

constexpr std::size_t kFileMax = 64 * 1024;  // a ports.cfg has two lines; more is another file

std::string_view trimmed(std::string_view text) {
    const auto from = text.find_first_not_of(" \t\r");
    if (from == std::string_view::npos) return {};
    return text.substr(from, text.find_last_not_of(" \t\r") - from + 1);
}

std::optional<long> number(std::string_view text) {
    text = trimmed(text);
    long value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
    return value;
}

}  // namespace

Result<PortRange> checkPortRange(long first, long last, std::string_view where) {
    const auto given = std::to_string(first) + "-" + std::to_string(last);
    if (first < PortRange::kLowest || last > PortRange::kHighest || first > last)
        return Refusal{
            RefusalCode::OutOfRange,
            std::string(where) + ": ports " + given +
                ": expected a range within 5500 to 8000; fix: write the lower end first, as in 5500-8000",
            {}};
    return PortRange{static_cast<std::uint16_t>(first), static_cast<std::uint16_t>(last)};
}

Result<LinkPorts> parsePorts(std::string_view text, std::string_view file) {
    LinkPorts ports;
    int line_number = 0;
    while (!text.empty()) {
        const auto end = text.find('\n');
        auto line = text.substr(0, end);
        text = end == std::string_view::npos ? std::string_view{} : text.substr(end + 1);
        ++line_number;
        line = trimmed(line.substr(0, line.find('#')));
        if (line.empty()) continue;
        const auto where = std::string(file) + ":" + std::to_string(line_number);
        const auto malformed = [&](const std::string& expected) {
            return Refusal{RefusalCode::Malformed,
                           where + ": '" + std::string(line.substr(0, 80)) + "': " + expected,
                           {}};
        };
        const auto equals = line.find('=');
        if (equals == std::string_view::npos)
            return malformed(
                "expected 'Axon.Ports = 5500-8000' or 'Axon.Address = 127.0.0.1'; fix: add the '='");
        const auto key = trimmed(line.substr(0, equals));
        const auto value = trimmed(line.substr(equals + 1));
        if (key == "Axon.Ports") {
            const auto dash = value.find('-');
            const auto first = number(value.substr(0, dash));
            const auto last = dash == std::string_view::npos ? first : number(value.substr(dash + 1));
            if (!first || !last)
                return malformed("expected two port numbers, as in 'Axon.Ports = 5500-8000'");
            const auto range = checkPortRange(*first, *last, where);
            if (!range) return range.refusal();
            ports.ports = range.value();
        } else if (key == "Axon.Address") {
            in_addr ignored{};
            ports.address = std::string(value);
            if (inet_pton(AF_INET, ports.address.c_str(), &ignored) != 1)
                return malformed("expected an IPv4 address, as in 'Axon.Address = 127.0.0.1'");
        } else if (key == "Axon.Users") {
            auto users = LinkUsers::parse(value, where);
            if (!users) return users.refusal();
            ports.users = std::move(users).value();
        } else {
            return malformed(
                "unknown setting: expected Axon.Ports, Axon.Address or Axon.Users; fix: correct the name");
        }
    }
    return ports;
}

Result<LinkPorts> readPorts(const std::filesystem::path& file) {
    std::ifstream in(file, std::ios::binary);
    std::string text;
    if (in) {
        text.resize(kFileMax + 1);
        in.read(text.data(), static_cast<std::streamsize>(text.size()));
        text.resize(static_cast<std::size_t>(in.gcount()));
    }
    if ((!in && !in.eof()) || text.size() > kFileMax)
        return Refusal{RefusalCode::BadName,
                       file.string() +
                           ": expected a readable ports.cfg of at most 64 KiB with the line 'Axon.Ports = "
                           "5500-8000'; fix: create it, or correct the path",
                       {}};
    return parsePorts(text, file.string());
}

bool isLoopback(std::string_view address) {
    in_addr parsed{};
    return inet_pton(AF_INET, std::string(address).c_str(), &parsed) == 1 &&
           (ntohl(parsed.s_addr) >> 24U) == 127;
}

}  // namespace axon
