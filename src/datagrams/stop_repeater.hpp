// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <deque>
#include <list>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/routed.hpp"
#include "datagrams/endpoint.hpp"
#include "datagrams/stop_datagram.hpp"

namespace axon::datagrams {

/// When the copies of a stop are sent, counted from the first (datagrams.md, "Rules"). Close
/// together at first, because most losses are single, and then further apart, because an outage lasts.
inline constexpr std::array<std::chrono::milliseconds, 9> kCopiesAt{
    std::chrono::milliseconds{0},  std::chrono::milliseconds{4},   std::chrono::milliseconds{10},
    std::chrono::milliseconds{20}, std::chrono::milliseconds{35},  std::chrono::milliseconds{55},
    std::chrono::milliseconds{80}, std::chrono::milliseconds{110}, std::chrono::milliseconds{150}};

/// The client's stops on their way as datagrams: sent again until they are acknowledged.
///
/// Where in the flow: beside StopDesk, which sends the same stops over the signal lane. A *target* is an
/// entity that this client holds and whose Entity Manager told of a datagram endpoint. A stop of a target has
/// one row of copies; giving the same stop again while the row runs, or after it was acknowledged, does
/// nothing, and after the row has ended begins it anew. Threads: none of its own; the owner confines it. What
/// is to be sent is handed out by take(). Failure: none; what is not acknowledged is TCP's affair.
class StopRepeater {
  public:
    struct Target {
        Endpoint to;
        LeaseNumber lease;
        std::string key;  ///< kLeaseKeyBytes
        Id128 sender;     ///< the session under which the lease was granted or resumed
    };
    struct Outgoing {
        Endpoint to;
        StopDatagramBytes bytes;
    };
    struct Acknowledged {
        std::string entity;
        Id128 sender;
        std::int64_t sequence = 0;
        std::uint32_t generation = 0;  ///< of the stop; 0 = the Entity Manager does not know any more
    };
    static constexpr std::size_t kRows = 4096;

    explicit StopRepeater(const Clock& clock) : clock_(clock) {}

    void admit(const std::string& entity, Target target);
    /// The lease has ended. Nothing happens when the target is of another, newer one.
    void forget(const std::string& entity, LeaseNumber lease);
    bool empty() const { return targets_.empty(); }

    /// A stop of this entity, or of every target ("").
    void stop(const std::string& entity, std::int64_t sequence, std::uint32_t generation);
    /// Whatever the socket received; what is no acknowledgement of a row changes nothing.
    std::optional<Acknowledged> onDatagram(const Endpoint& from, std::string_view bytes);
    void onTimer();
    TimePoint nextDeadline() const;
    /// What is to be sent now, in order.
    std::vector<Outgoing> take() { return std::exchange(outgoing_, {}); }
    std::size_t rows() const { return rows_.size(); }

  private:
    struct Row {
        std::string entity;
        std::int64_t sequence = 0;
        std::uint32_t generation = 0;
        TimePoint begun;
        std::size_t copies = 0;
    };
    struct Known {
        Target target;
        std::deque<std::int64_t> acknowledged;  // the newest few
    };
    void begin(const std::string& entity, Known& known, std::int64_t sequence, std::uint32_t generation);
    void sendDue(Row& row, const Target& target);

    const Clock& clock_;
    std::map<std::string, Known> targets_;
    std::list<Row> rows_;
    std::vector<Outgoing> outgoing_;
};

}  // namespace axon::datagrams
