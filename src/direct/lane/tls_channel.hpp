// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <string>

#include "certificates/trust.hpp"
#include "direct/lane/channel.hpp"

namespace axon::direct::lane {

/// What all connections of one side share: its certificate, and whom it trusts.
///
/// Constant after construction. Threads: any. Ownership: shared by its channels. Failure: the constructor
/// throws certificates::Unusable for texts that are no certificate or key, or do not belong together.
class Tls : public std::enable_shared_from_this<Tls> {
  public:
    using WallClock = std::function<certificates::WallTime()>;

    static std::shared_ptr<const Tls> of(const certificates::Credentials& credentials, WallClock now);
    ~Tls();
    Tls(const Tls&) = delete;
    Tls& operator=(const Tls&) = delete;

    /// At the client, which calls: TLS from filled(…, 0) on. Whoever answers must show the certificate of the
    /// entity of this name.
    std::unique_ptr<Channel> toEntity(std::string name, Wire& socket) const;
    /// At the Entity Manager, which is called: whoever calls must show what the credentials want.
    std::unique_ptr<Channel> fromCaller(Wire& socket) const;

    const certificates::Trust& trust() const { return trust_; }

  private:
    friend class TlsChannel;
    struct Shown;
    Tls(const certificates::Credentials& credentials, WallClock now);

    const certificates::Trust trust_;
    const WallClock now_;
    const certificates::Credentials::Peer caller_;
    const std::unique_ptr<const Shown> shown_;
};

}  // namespace axon::direct::lane
