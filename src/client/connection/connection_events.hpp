// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <string_view>

#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "direct/incoming_way.hpp"

namespace axon::client {

/// What arrives over one ServerConnection; `attempt` is its number. On Ice's threads: data and signal lane at
/// the same time, each in order.
class ConnectionEvents {
  public:
    virtual ~ConnectionEvents() = default;
    virtual void newProfile(std::uint64_t attempt, Presence presence, const Registration& registration,
                            std::string_view profile) = 0;
    virtual void newStatus(std::uint64_t attempt, const EntityStatus& status) = 0;
    /// `lane`: where it came, and `keeping` of what was sent on the data lane.
    virtual void newEntityMsg(std::uint64_t attempt, Lane lane, direct::Keeping keeping, const Header& head,
                              std::string_view message) = 0;
    virtual void newRefusal(std::uint64_t attempt, const Header& head, const Refusal& refusal) = 0;
    virtual void newStopAccepted(std::uint64_t attempt, const Header& head, int entities) = 0;
    virtual void newServerText(std::uint64_t attempt, int code, const std::string& text) = 0;
    virtual void newServerHeartbeat(std::uint64_t attempt) = 0;
    /// With the first of them: the release that the server says it has; anything up to kReleaseMax + 1 bytes.
    virtual void newServerRelease(const std::string& release) = 0;
    /// One of the two connections has ended. May come before open() has returned.
    virtual void closed(std::uint64_t attempt, const std::string& reason) = 0;
};

}  // namespace axon::client
