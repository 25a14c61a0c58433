// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "client/base/session_observer.hpp"
#include "client/connection/send_queue.hpp"
#include "client/direct/direct_path.hpp"
#include "common/clock.hpp"
#include "common/snapshot.hpp"
#include "direct/beats.hpp"
#include "direct/incoming_way.hpp"
#include "direct/outgoing_way.hpp"

namespace axon::client {

class DataLane;

/// Of all paths together: more than what users may have waiting, and less than what may wait for the server.
inline constexpr direct::KeptBounds kKeptBounds{12288, kWaitingBytesMax + kWaitingBytesMax / 2};

/// The direct path of one lease, as its sender sees it. `out`, `by` and `servers` are guarded by the owner's
/// lock of sending.
struct DirectLink {
    struct Sent {
        Header head;
        std::shared_ptr<const std::string> message;
    };
    /// The session with the server is lost, or the entity has left: what is not acknowledged is lost with it,
    /// as what the servers had under way is.
    std::atomic<bool> forget{false};
    direct::OutgoingWay<Sent> out{kKeptBounds};
    std::shared_ptr<DirectPath> by;           // while out.direct()
    std::shared_ptr<const DataLane> servers;  // the same: where what the path leaves goes
};

/// The direct paths of a client's session: opens them where a lease offers one, tries again, watches them,
/// and says of each message that comes whether it counts (ADR 0021).
///
/// Where in the flow: beside SessionCore, under the same lock; it knows no connection but DirectPath. For
/// each entity whose lease offers a path: being opened, open, or waiting to try again. Threads: none of its
/// own; everything under the owner's lock of the core but paths(), which any thread may call, and `out` and
/// `by` of links. It never calls a path's functions that call Ice: what is to be opened or closed is
/// returned, for when the lock is free.
class DirectLinks {
  public:
    using Make = std::function<std::shared_ptr<DirectPath>(const DirectOffer& offer)>;
    using Deliver = std::function<void(const Header& head, std::string_view bytes)>;
    using Paths = std::map<std::string, std::shared_ptr<DirectPath>>;
    using Closing = std::vector<std::shared_ptr<DirectPath>>;

    /// At most `most` at a time; where another is offered, it is looked for room again each 30 s.
    DirectLinks(const Clock& clock, std::size_t most, Make make)
        : clock_(clock), most_(most), make_(std::move(make)) {}

    /// A lease was granted or resumed, and offers a path.
    void offer(const DirectOffer& offer);
    /// The lease has ended here, and the path with it. Whether a turn is due.
    bool withdraw(const Held& held);
    /// The entity has left: nothing of this life counts from now on.
    Closing leave(const std::string& entity);
    /// There is no longer a session with a server.
    Closing clear();
    /// The servers have refused the mark of the entity's path.
    Closing markRefused(const std::string& entity);

    /// Null where no path was offered.
    std::shared_ptr<DirectLink> linkOf(const std::string& entity) const;
    /// Messages of this entity come by a direct path, and go there.
    bool direct(const std::string& entity) const;
    /// Of all paths that are open, for signals; behind a lock of its own.
    std::shared_ptr<const Paths> paths() const { return paths_.load(); }

    /// A stop goes straight to those entities of it that have a path: to `entities`, or the one that `head`
    /// names, or all.
    static void stop(const Paths& paths, const Header& head, const std::vector<std::string>& entities,
                     StopCause cause);

    /// Whether a message of an entity counts that came through the servers, on the data lane. A mark makes
    /// `deliver` be called for what was held back.
    bool relayed(direct::Keeping keeping, const Header& head, std::string_view message,
                 const Deliver& deliver);
    struct Arrival {
        bool pass = false;
        bool acknowledge = false;  ///< by a beat, at once
        std::shared_ptr<DirectPath> close;
        const char* why = "";  ///< for close
    };
    Arrival arrived(const DirectPath& path, direct::Keeping keeping, Header& head, std::string_view message);

    struct Turn {
        std::vector<std::shared_ptr<DirectPath>> open;
        std::vector<std::pair<std::shared_ptr<DirectPath>, const char*>> close;  ///< and why
        /// Paths that are open now: their marks are to be sent, and the links take them.
        std::vector<std::pair<std::shared_ptr<DirectLink>, std::shared_ptr<DirectPath>>> begun;
        bool ended = false;  ///< one has: what it has not acknowledged is to be sent again
        struct News {
            bool matters;  ///< otherwise an attempt that failed, of which there are many
            std::string text;
        };
        std::vector<News> news;  ///< for the log
        TimePoint next = TimePoint::max();
    };
    /// What is due. Call at the time of the last turn, and when a path says that it has changed.
    Turn turn();

  private:
    struct Came {
        Header head;
        std::string bytes;
    };
    struct Entry {
        std::int32_t epoch = 0;  // of the lease: another epoch is another life of the Entity Manager, which
                                 // counts from the beginning
        direct::IncomingWay<Came> in;
        direct::Unacknowledged unacknowledged;
        DirectOffer offer;
        std::shared_ptr<DirectLink> link;               // null: not offered, or no longer
        std::vector<std::weak_ptr<DirectLink>> former;  // with messages that may not be acknowledged
        std::shared_ptr<DirectPath> path;               // being opened, or open
        bool begun = false;
        bool withdrawn = false;
        TimePoint begun_at, try_at = TimePoint::max(), mark_due = TimePoint::max(),
                            close_at = TimePoint::max();
        direct::Retry retry;
    };
    /// `next` may be null.
    static void replaceLink(Entry& entry, std::shared_ptr<DirectLink> next);
    static void forget(Entry& entry);
    void tellPaths();
    void told(Entry& entry) const;

    const Clock& clock_;
    const std::size_t most_;
    const Make make_;
    std::unordered_map<std::string, Entry> entries_;
    Snapshot<Paths> paths_;
};

}  // namespace axon::client
