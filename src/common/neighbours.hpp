// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/clock.hpp"
#include "common/liveness.hpp"
#include "common/routed.hpp"

namespace axon {

/// How something came from another server: by the topic, or straight.
enum class Via : std::uint8_t { Topic, Straight };

/// The servers of one kind as another server sees them: which there are, where they take signals, and which
/// are alive (safety.md, "Watchdogs").
///
/// Where in the flow: both servers' cores feed it what the others announce, by the topic and directly, and
/// their timers ask for news. States of a neighbour:
///
///     met ── heard directly ──► watched ── silent ──► lost ── heard directly ──► watched
///      └── silent ──► lost ── heard ──► met        another instance: lost and met at once
///
/// Before it was heard directly once, its announcements by the topic count as signs of life; from then on
/// only what comes directly does, because that is the way of the signals. An instance that was replaced is
/// never taken for the present one, however late its announcements come.
///
/// A watched neighbour whose port refuses connections has most likely ended: silence of `kRefuses` is enough
/// then. One that goes on saying that it lives, and is not late, is not lost by that.
///
/// Threads: any; a mutex of its own, held for a look into a map of at most `kMost`. It is I/O-free.
class Neighbours {
  public:
    struct Timeouts {
        Duration busy = std::chrono::milliseconds{250};  ///< while a task runs between us
        Duration idle = std::chrono::seconds{2};
        Duration met = std::chrono::seconds{3};  ///< of one that was never heard directly
    };
    struct News {
        std::vector<std::string> lost;     ///< silent or restarted: everything that came through it is gone
        std::vector<std::string> arrived;  ///< is there, or there again
        /// Whom to send signals to directly, where that has changed.
        std::optional<std::vector<ServerAnnouncement>> reachable;
        TimePoint next;  ///< when to ask again
    };
    static constexpr std::size_t kMost = 256;
    /// Nothing is sent to a neighbour that was not heard for this long. It is forgotten after `kForget`.
    static constexpr std::chrono::seconds kReach{3};
    static constexpr std::chrono::seconds kForget{60};
    /// How often a server says to each neighbour that it lives.
    static constexpr std::chrono::milliseconds kBeat{50};
    /// The silence after which a neighbour is lost whose port refuses.
    static constexpr std::chrono::milliseconds kRefuses = kBeat * 3 / 2;

    explicit Neighbours(Timeouts timeouts) : timeouts_(timeouts) {}
    Neighbours() : Neighbours(Timeouts{}) {}

    /// `lane`: Signal = directly, Data = by the topic. Returns whether there is news to ask for.
    bool heard(Lane lane, const ServerAnnouncement& announcement, TimePoint now);
    /// A connection to `signals`, where this server said that it takes signals, was refused. Returns whether
    /// there is another moment at which to ask for news.
    bool refused(std::string_view server, std::string_view signals);
    /// Something came by this server. One that was never heard of is awaited from now on: it is lost unless
    /// it is heard within `met`.
    void await(std::string_view server, TimePoint now);
    /// Whether a task runs that hangs on this server. One that was never heard of is awaited, too.
    void setBusy(std::string_view server, bool busy, TimePoint now);
    News news(TimePoint now);

    /// Whether the server that serves this client, by its id, is there. True where nobody has said otherwise.
    bool serves(std::string_view client_id) const;
    /// Whether this server was there and no longer is.
    bool lost(std::string_view server) const;
    /// Whether it has been heard directly within this time.
    bool hears(std::string_view server, Duration within, TimePoint now) const;
    std::size_t size() const;

  private:
    struct Neighbour {
        ServerAnnouncement announcement;    // its instance is empty until it was heard
        std::vector<std::string> replaced;  // instances, the last few
        Liveness liveness;
        TimePoint reachable_until;
        bool reached = false;
        bool straight = false;
        bool alive = true;
        bool arrived = false;
        bool restarted = false;
        bool refuses = false;  // since it was last heard directly

        TimePoint deadline() const {
            const auto silent = liveness.deadline();
            return refuses ? std::min<TimePoint>(silent, liveness.last() + kRefuses) : silent;
        }
    };
    Neighbour* findOrAdd(std::string_view server, TimePoint now);

    const Timeouts timeouts_;
    mutable std::mutex mutex_;
    std::map<std::string, Neighbour, std::less<>> all_;  // guarded by mutex_
    bool reach_changed_ = false;                         // guarded by mutex_
};

}  // namespace axon
