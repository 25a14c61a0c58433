// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

#include "board.hpp"
#include "tcp.hpp"

namespace axon::bench {

/// How a receiver speaks to its server.
class ReceiverProtocol {
  public:
    virtual ~ReceiverProtocol() = default;
    /// What receiver `index` says first.
    virtual std::string hello(std::size_t index) const = 0;
    /// Whole messages from the beginning of `received`, which came at `when`; how many bytes they were. Tells
    /// `ready` when the server has confirmed hello().
    virtual std::size_t consume(const tcp::Connection& connection, std::string_view received,
                                std::int64_t when, Slot& slot, const std::function<void()>& ready) const = 0;
};

/// N receivers, each with a connection of its own, in one process with one epoll loop; notes arrivals on the
/// board until it is killed or its parent dies.
int runTcpReceivers(const ReceiverProtocol& protocol, const std::string& board_file, std::size_t receivers,
                    std::uint16_t port);

}  // namespace axon::bench
