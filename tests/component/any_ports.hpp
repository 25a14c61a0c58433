// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "server/server.hpp"
#include "support/loopback.hpp"

namespace axon::test {

inline constexpr const char* kFirst = "00000000-0000-4000-8000-000000000001";
inline constexpr const char* kSecond = "00000000-0000-4000-8000-000000000002";
inline constexpr const char* kThird = "00000000-0000-4000-8000-000000000003";

/// A server on whichever ports are free, at this process's own address.
inline server::ServerSettings onLoopback() {
    const auto any_port = loopbackAddress() + ":0";
    server::ServerSettings settings;
    settings.client_endpoint = settings.client_signal_endpoint = any_port;
    settings.entity_endpoint = settings.entity_signal_endpoint = any_port;
    settings.topic_endpoint = settings.topic_signal_endpoint = any_port;
    return settings;
}

}  // namespace axon::test
