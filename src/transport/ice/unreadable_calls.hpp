// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/DispatchInterceptor.h>
#include <Ice/Ice.h>

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

namespace axon::transport {

/// Hands the calls of one session to its servant, and tells the log of those that cannot be read as the
/// contract says: of the first, and at the end of how many there were. A call without a reply would vanish
/// otherwise. The session goes on. Calls that come over the connection of somebody else, which the servant
/// refuses, are told to `foreign`. Threads: any.
class UnreadableCalls final : public Ice::DispatchInterceptor {
  public:
    /// The address of who has called.
    using Foreign = std::function<void(const std::string& peer)>;

    /// `peer`: for the log. `over`: the session's own connection, an Ice::Connection that lives as long as
    /// the servant. `foreign` null, as behind a router: not told.
    UnreadableCalls(std::shared_ptr<Ice::Object> servant, std::string peer, const void* over,
                    Foreign foreign);
    ~UnreadableCalls() override;
    bool dispatch(Ice::Request& request) override;

  private:
    /// Which is told.
    bool isForeign(const Ice::Current& current) const;
    void note(const std::string& operation, const std::string& why);

    const std::shared_ptr<Ice::Object> servant_;
    const std::string peer_;
    const void* const over_;
    const Foreign foreign_;
    std::atomic<std::uint64_t> count_{0};
};

}  // namespace axon::transport
