// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/endpoint.hpp"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <regex>
#include <stdexcept>

namespace axon::transport {
namespace {

constexpr const char* kScheme = "ssl://";

[[noreturn]] void fail(const std::string& text) {
    throw std::invalid_argument("'" + text +
                                "': expected HOST:PORT with a port from 0 to 65535, such as 127.0.0.1:10410, "
                                "or ssl://HOST:PORT, or Ice's ssl -h HOST -p PORT");
}

Endpoint checked(const std::string& text, std::string host, std::string_view port, bool tls) {
    unsigned number = 0;
    const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), number);
    if (error != std::errc{} || end != port.data() + port.size() || number > 65535) fail(text);
    // The host becomes part of an endpoint string: nothing that Ice would read as an option may be in it.
    const bool plain = std::all_of(host.begin(), host.end(), [](unsigned char c) {
        return std::isalnum(c) != 0 || c == '.' || c == '-' || c == '_';
    });
    if (host.empty() || !plain || host.front() == '-') fail(text);
    return {std::move(host), static_cast<std::uint16_t>(number), tls};
}

bool isIceForm(const std::string& text) {
    static const std::regex kBegin(R"(\s*(tcp|ssl)\s)");
    return std::regex_search(text, kBegin, std::regex_constants::match_continuous);
}

Endpoint parseIceForm(const std::string& text, const std::string& whole) {
    static const std::regex kForm(R"(\s*(tcp|ssl)\s+-h\s+(\S+)\s+-p\s+(\d+)\s*)");
    std::smatch parts;
    if (!std::regex_match(text, parts, kForm)) fail(whole);
    return checked(whole, parts[2].str(), parts[3].str(), parts[1] == "ssl");
}

}  // namespace

std::string Endpoint::text() const {
    return std::string(tls ? "ssl" : "tcp") + " -h " + host + " -p " + std::to_string(port);
}

std::string Endpoint::address() const {
    return (tls ? kScheme : "") + host + ":" + std::to_string(port);
}

Endpoint parseEndpoint(const std::string& text) {
    if (isIceForm(text)) return parseIceForm(text, text);
    const std::string_view scheme = kScheme;
    const bool tls = text.rfind(scheme, 0) == 0;
    const auto begin = tls ? scheme.size() : 0;
    const auto colon = text.rfind(':');
    if (colon == std::string::npos || colon < begin) fail(text);
    return checked(text, text.substr(begin, colon - begin), std::string_view(text).substr(colon + 1), tls);
}

std::vector<Endpoint> parseEndpoints(const std::string& text) {
    if (!isIceForm(text)) return {parseEndpoint(text)};
    std::vector<Endpoint> all;
    for (std::size_t at = 0; at <= text.size();) {
        const auto end = std::min(text.find(':', at), text.size());
        all.push_back(parseIceForm(text.substr(at, end - at), text));
        at = end + 1;
    }
    return all;
}

std::string textOf(const std::vector<Endpoint>& endpoints) {
    std::string text;
    for (const auto& endpoint : endpoints) text += (text.empty() ? "" : ":") + endpoint.text();
    return text;
}

std::string asCalled(const std::string& signal_endpoint, const Endpoint& called, const std::string& address) {
    auto signal = parseEndpoint(signal_endpoint);
    if (signal.tls && signal.host == address) signal.host = called.host;
    return signal.text();
}

}  // namespace axon::transport
