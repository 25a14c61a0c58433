// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "client/base/lanes.hpp"
#include "client/base/server_link.hpp"
#include "client/base/signal_marks.hpp"
#include "client/direct/direct_links.hpp"
#include "client/sending/departure.hpp"
#include "client/sending/next_turn.hpp"
#include "client/stops/stop_desk.hpp"
#include "common/clock.hpp"
#include "common/snapshot.hpp"

namespace axon::client {

/// The stop's half of a session: StopDesk, its lock, and the place where a stop leaves (depart()).
///
/// Where in the flow: between the calls that stop and the connections, beside everything that data does. The
/// messages that the desk sends while its lock is held leave after it (Departure), by every way there is:
/// straight to the Entity Managers that have a direct path, through the servers, and as datagrams. Threads:
/// any. The lock is held for a turn of the desk only, never across a call of Ice or of the user, and no
/// message of the data lane takes it; joins and leaves of entities do. Failure: the desk repeats a stop that
/// no way takes.
class StopSender final : private StopLink {
  public:
    /// Sends a stop as a datagram too: of one entity, or ("") of all that are held.
    using Datagram =
        std::function<void(const std::string& entity, std::int64_t sequence, std::int32_t generation)>;

    /// `wake`: the thread that calls onTimer() is to call it earlier than it was told.
    StopSender(const Clock& clock, SignalMarks& marks, const DirectLinks& links, Datagram datagram,
               std::function<void()> wake)
        : clock_(clock),
          marks_(marks),
          links_(links),
          datagram_(std::move(datagram)),
          wake_(std::move(wake)),
          desk_(clock, *this, marks) {}

    /// Runs `use` on the desk, under its lock. The messages that it sends have left when this returns.
    template <class Use>
    auto withDesk(Use&& use) {
        return departure_.after([&]() -> decltype(auto) { return use(desk_); });
    }
    /// The session whose lanes are used from now on; null: none.
    void connect(std::shared_ptr<const StopLanes> lanes) { lanes_.store(std::move(lanes)); }
    /// What is due; when next.
    TimePoint onTimer();

    /// A message of an entity, by whatever way it came: whether it was a receipt, which nobody else needs to
    /// see.
    bool onReceipt(const Header& head, std::string_view message);
    /// A reply on the signal lane: a reset or clear is refused. The core hears of it too.
    void onReply(const Header& head, std::string_view message);
    /// The Entity Manager of `entity` has acknowledged the datagram of a stop of `sender` (a UUID).
    void onDatagramAcknowledged(const std::string& entity, const std::string& sender, std::int64_t sequence,
                                std::uint32_t generation);

  private:
    friend class Departure<StopSender>;
    struct Outgoing {
        Lane lane;
        Header head;
        std::vector<std::string> entities;  // none: what the head names
        StopCause cause;
    };
    struct Leaving {
        std::vector<Outgoing> stops;
        bool wake;
    };
    Leaving collect();
    void depart(const Leaving& leaving) noexcept;
    void sendByLanes(const std::vector<Outgoing>& stops) const;
    void sendAsDatagrams(const std::vector<Outgoing>& stops) const;

    // StopLink: called by the desk, under mutex_.
    void sendStopSignal(Lane lane, const Header& head, StopCause cause) override;
    void sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                         StopCause cause) override;

    const Clock& clock_;
    SignalMarks& marks_;
    const DirectLinks& links_;  // paths() only
    const Datagram datagram_;
    const std::function<void()> wake_;
    Snapshot<StopLanes> lanes_{nullptr};

    std::mutex mutex_;
    // Guarded by mutex_:
    StopDesk desk_;
    std::vector<Outgoing> noted_;
    NextTurn timer_;

    const Departure<StopSender> departure_{*this, mutex_};
};

}  // namespace axon::client
