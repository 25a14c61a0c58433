// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <vector>

#include "child.hpp"
#include "subject.hpp"
#include "tcp_receivers.hpp"

namespace axon::bench {

/// The least that a relay can be, and so this machine's limit for one: a thread, an epoll loop, frames that
/// are read from the sender and written to their receiver as they are. No sessions, no rights, no leases, no
/// watchdogs, no second lane. Prints "ready port=N" and runs until its parent dies.
int runRawRouter();

class RawReceiver final : public ReceiverProtocol {
  public:
    std::string hello(std::size_t index) const override;
    std::size_t consume(const tcp::Connection& connection, std::string_view received, std::int64_t when,
                        Slot& slot, const std::function<void()>& ready) const override;
};

std::unique_ptr<Subject> startRawRouter(const std::filesystem::path& folder, std::size_t n);
/// The same frames without the router, from the sender to each receiver: this machine's limit for a direct
/// path.
std::unique_ptr<Subject> startRawDirect(const std::filesystem::path& folder, std::size_t n);

/// Round trips between two processes that do nothing else, one after the other: two system calls and a
/// wake-up on each side.
class RawPair {
  public:
    explicit RawPair(const std::filesystem::path& folder);
    /// Times in us are added. Throws std::system_error when the other process ends, std::runtime_error when
    /// something comes back altered.
    void trips(std::size_t bytes, int count, std::vector<double>& times) const;

  private:
    Child router_;  ///< which sends back what is for the only one that is there
    tcp::Connection connection_;
};

}  // namespace axon::bench
