// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>

#include "subject.hpp"
#include "tcp_receivers.hpp"

namespace axon::bench {

/// The client protocol of NATS (text lines INFO, CONNECT, SUB, PUB, MSG, PING, PONG over TCP), as much of it
/// as a receiver with the subjects s.INDEX and d.INDEX needs.
class NatsReceiver final : public ReceiverProtocol {
  public:
    std::string hello(std::size_t index) const override;
    std::size_t consume(const tcp::Connection& connection, std::string_view received, std::int64_t when,
                        Slot& slot, const std::function<void()>& ready) const override;
};

/// nats-server, N receivers in a process of their own, and one publishing connection.
std::unique_ptr<Subject> startNats(const std::filesystem::path& folder, std::size_t n);

}  // namespace axon::bench
