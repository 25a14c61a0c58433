// SPDX-License-Identifier: MIT
#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "common/result.hpp"
#include "host/link_users.hpp"

namespace axon {

/// Ports on which a robot application may listen for its Entity Manager (thesis, appendix B.3): always within
/// 5500 to 8000, both included.
struct PortRange {
    static constexpr std::uint16_t kLowest = 5500;
    static constexpr std::uint16_t kHighest = 8000;
    std::uint16_t first = kLowest;
    std::uint16_t last = kHighest;

    bool contains(std::uint16_t port) const { return first <= port && port <= last; }
    bool operator==(const PortRange&) const = default;
};

/// What a ports.cfg says. Both ends of the EM-EI link read the same file, or equal ones.
struct LinkPorts {
    PortRange ports;
    std::string address = "127.0.0.1";
    LinkUsers users;
};

/// Refused with OUT_OF_RANGE if the range leaves 5500 to 8000 or begins with its upper end. The message
/// begins with `where`.
Result<PortRange> checkPortRange(long first, long last, std::string_view where);

/// Reads the text of a ports.cfg: lines `Axon.Ports = 5500-8000` (or a single port) and, optionally,
/// `Axon.Address = 127.0.0.1` and `Axon.Users = axon 1001`; `#` begins a comment. Refused with MALFORMED or
/// OUT_OF_RANGE; the message names file, line, what was expected and how to fix it. A setting that is not
/// given keeps its default.
Result<LinkPorts> parsePorts(std::string_view text, std::string_view file);

/// The same from a file; refused with BAD_NAME when it cannot be read.
Result<LinkPorts> readPorts(const std::filesystem::path& file);

/// Whether the text is an IPv4 address of the loopback network, 127.0.0.0/8.
bool isLoopback(std::string_view address);

}  // namespace axon
