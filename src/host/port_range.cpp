// SPDX-License-Identifier: MIT
#include "host/port_range.hpp"

#include <arpa/inet.h>

#include <charconv>
#include <optional>
#include <utility>
#include <vector>

#include "host/settings_file.hpp"

namespace axon {
namespace {

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

Result<LinkPorts> portsOf(const std::vector<Setting>& settings) {
    LinkPorts ports;
    for (const auto& setting : settings) {
        const auto& [key, value, where] = setting;
        const auto malformed = [&setting](const std::string& expected) {
            const auto shown = (setting.key + " = " + setting.value).substr(0, 80);
            return Refusal{RefusalCode::Malformed, setting.where + ": '" + shown + "': " + expected, {}};
        };
        if (key == "Axon.Ports") {
            const auto dash = value.find('-');
            const auto first = number(std::string_view(value).substr(0, dash));
            const auto last =
                dash == std::string::npos ? first : number(std::string_view(value).substr(dash + 1));
            if (!first || !last)
                return malformed("expected two port numbers, as in 'Axon.Ports = 5500-8000'");
            const auto range = checkPortRange(*first, *last, where);
            if (!range) return range.refusal();
            ports.ports = range.value();
        } else if (key == "Axon.Address") {
            in_addr ignored{};
            ports.address = value;
            if (inet_pton(AF_INET, ports.address.c_str(), &ignored) != 1)
                return malformed("expected an IPv4 address, as in 'Axon.Address = 127.0.0.1'");
        } else if (key == "Axon.Users") {
            auto users = LinkUsers::parse(value, where);
            if (!users) return users.refusal();
            ports.users = std::move(users).value();
        } else {
            return malformed(
                "unknown setting: expected Axon.Ports, Axon.Address or Axon.Users: correct the name");
        }
    }
    return ports;
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
    const auto settings = parseSettings(text, file);
    if (!settings) return settings.refusal();
    return portsOf(settings.value());
}

Result<LinkPorts> readPorts(const std::filesystem::path& file) {
    const auto settings = readSettings(file);
    if (!settings) return settings.refusal();
    return portsOf(settings.value());
}

bool isLoopback(std::string_view address) {
    in_addr parsed{};
    return inet_pton(AF_INET, std::string(address).c_str(), &parsed) == 1 &&
           (ntohl(parsed.s_addr) >> 24U) == 127;
}

}  // namespace axon
