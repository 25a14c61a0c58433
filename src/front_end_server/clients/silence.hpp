// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "front_end_server/clients/clients.hpp"

namespace axon::front_end_server {

/// A client that is lost for its silence, and why.
struct SilentClient {
    ClientRef client;
    std::string why;
};

/// Whom the server loses now: each client whose time-out is over. A router that freezes or is cut off
/// silences all its clients, and the server, which hears each at another moment, would find them one after
/// another while the stops for the first ones keep it busy. So where a busy client's time-out is over and no
/// busy one that came by the same connection was heard for four fifths of it, which is one heartbeat less,
/// all these are lost together. Whoever is alone behind its connection has the whole time-out.
///
/// Threads: the owner of `clients` guards it. No I/O.
std::vector<SilentClient> silentAt(const Clients::ById& clients, TimePoint now);

}  // namespace axon::front_end_server
