// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>

#include "subject.hpp"
#include "tcp_receivers.hpp"

namespace axon::bench {

/// The least that a relay can be, and so this machine's limit for one: a thread, an epoll loop, frames that are read from the
/// sender and written to their receiver as they are. No sessions, no rights, no leases, no watchdogs, no second lane.
/// Prints "ready port=N" and runs until its parent dies.
int runRawRouter();

class RawReceiver final : public ReceiverProtocol {
  public:
    std::string hello(std::size_t index) const override;
    std::size_t consume(const tcp::Connection& connection, std::string_view received, std::int64_t when, Slot& slot,
                        const std::function<void()>& ready) const override;
};

std::unique_ptr<Subject> startRawRouter(const std::filesystem::path& folder, std::size_t n);

}  // namespace axon::bench
