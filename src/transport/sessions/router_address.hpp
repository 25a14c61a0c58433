// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <map>
#include <string>

namespace axon::transport {

/// "10.0.0.7:50122", of which a router says that it is the other end of its connection; empty where that is
/// no address of IPv4 or IPv6 and no port. IPv4 within IPv6 is written as IPv4.
inline std::string routerAddress(std::string address, const std::string& port) {
    constexpr std::size_t kAddressMax = 45, kPortMax = 5;
    constexpr const char* kMapped = "::ffff:";
    if (address.starts_with(kMapped) && address.find('.') != std::string::npos) address.erase(0, 7);
    if (address.empty() || address.size() > kAddressMax || port.empty() || port.size() > kPortMax ||
        address.find_first_not_of("0123456789abcdefABCDEF.:") != std::string::npos ||
        port.find_first_not_of("0123456789") != std::string::npos)
        return {};
    return address + ":" + port;
}

/// The same of the context of a router's request (Glacier2.AddConnectionContext).
inline std::string routerAddress(const std::map<std::string, std::string>& context) {
    const auto address = context.find("_con.remoteAddress"), port = context.find("_con.remotePort");
    if (address == context.end() || port == context.end()) return {};
    return routerAddress(address->second, port->second);
}

}  // namespace axon::transport
