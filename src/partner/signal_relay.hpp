// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/status.pb.h>

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "client/base/lanes.hpp"
#include "common/clock.hpp"
#include "common/routed.hpp"
#include "partner/ports.hpp"

namespace axon::partner {

/// Passes stops, resets and clears on, at once: beside PartnerCore and its strand, with a lock of its own, so
/// that a signal never waits for data, for a status or for a session to be opened.
///
/// Where in the flow: what a server at home says to an entity that is shown comes in by stop() and command(),
/// on the threads of the signal lane; it leaves on the signal lane of a session there. A stop of a client
/// that has a session there goes by that one, under its own number; any other goes by a session for such
/// stops, under a number of this relay's. Sent again, it has the same number, so an Entity Manager takes it
/// for the same stop; sent again within kRepeat, it is on its way already and is not passed on. translate()
/// turns what a receipt there says into what it says at home. While there is no session for such stops alone,
/// they go by one that is shared with other uses, and then only so many are passed on in a second that it
/// goes on: kSharedLeast of each client are set aside for it, as long as there is something of kSharedAside;
/// beyond them kSharedOfOne of a client, and kSharedCommon of all.
///
/// Threads: any; no call waits, and nothing is sent while the lock is held. Bounds: kRemembered stops that
/// went by the session for them, kRememberedOfOne of each client, and kRemembered sessions that have ended;
/// the oldest go first, and a stop that is sent again after that is a new one. Of kRecent stops the last
/// kRepeat is known; of more at once, all are passed on. Clients of which something went by the shared
/// session within a second: kShared.
class SignalRelay {
  public:
    static constexpr std::size_t kRemembered = 4096;
    static constexpr std::size_t kRememberedOfOne = 256;
    static constexpr std::size_t kRecent = 16'384;
    /// A client sends a stop again after five times as long. What one number costs there, however often it is
    /// sent: 50 messages a second for each entity.
    static constexpr Duration kRepeat = std::chrono::milliseconds{20};
    static constexpr std::size_t kSharedOfOne = 1000;  ///< all entities that are shown
    static constexpr std::size_t kSharedCommon = 4000;
    static constexpr std::size_t kSharedLeast = 4;
    static constexpr std::size_t kSharedAside = 4000;
    /// Twice as many may pass at once, at the end of one second and the beginning of the next. The connection
    /// itself ends where client::kSignalsUnsent are unsent (gateway.cpp), and a server ends a session that
    /// sends 100,000 in a second.
    static constexpr std::size_t kShared = kSharedCommon + kSharedAside;

    explicit SignalRelay(const Clock& clock) : clock_(clock) {}

    struct Lanes {
        std::shared_ptr<const client::StopLanes> stops;
        std::shared_ptr<const client::DataLane> commands;  ///< which takes Reset and Clear
    };

    /// The session for stops of clients without one is there, or the one that takes them while there is none
    /// for them alone (`shared`); `me`: who it is. Stops that went by another one are forgotten.
    void stopBy(SessionNumber session, const Sender& me, std::shared_ptr<const client::StopLanes> lanes,
                bool shared = false);
    /// This session has ended, if it is one of the two: the next stop goes by the other one.
    void noStopBy(SessionNumber session);
    /// The client of home is `there` in the partner's laboratory.
    void visit(const Sender& client, const Sender& there, Lanes lanes);
    /// Its session has ended. Receipts that name it are translated still.
    void end(const std::string& client);

    enum class Passed : std::uint8_t {
        Sent,  ///< or it is on its way already
        NoSession,
        TooMany  ///< by the shared session
    };
    /// `entity`: UUID there.
    Passed stop(const std::string& entity, const Header& head, StopCause cause);
    /// Reset or Clear. False: this client has no session there, so it holds nothing.
    bool command(client::Operation operation, const std::string& entity, const Header& head);

    /// Who gave the signal that is called so there; nothing: nobody of this laboratory.
    struct Origin {
        Sender client;
        std::int64_t sequence = 0;
    };
    std::optional<Origin> originOf(std::string_view signal_id) const;
    /// Names the stop as it was given at home, and who gave it. Returns whoever did; nothing: nobody of home,
    /// and the receipt is as it was.
    std::optional<Sender> translate(proto::StopReceipt& receipt) const;

  private:
    struct Visitor {
        Sender there;
        Lanes lanes;
    };
    struct Standing {
        SessionNumber session = 0;  // none
        Sender me;
        std::shared_ptr<const client::StopLanes> lanes;
    };
    // Under the lock:
    const Standing& standing() const { return alone_.lanes ? alone_ : shared_; }
    void forgetStops();
    std::int64_t numberOf(const Header& head);
    void forget(std::int64_t number);
    bool justSent(const Header& head, const std::string& entity);
    void noteSent(std::int64_t number, const std::string& entity);
    bool tooMany(const std::string& client);

    const Clock& clock_;
    mutable std::mutex mutex_;
    // Guarded by mutex_:
    Standing alone_, shared_;  // the sessions for strangers' stops
    TimePoint second_{};       // since when is counted:
    std::size_t common_ = 0;
    std::size_t aside_ = 0;
    std::map<std::string, std::size_t> of_one_;                  // by client at home
    std::int64_t last_ = 0;                                      // number of a stop by it
    std::map<std::string, std::deque<std::int64_t>> of_client_;  // its numbers in origins_, by client at home
    using Sent = std::pair<std::int64_t, std::string>;           // number and entity there
    std::map<Sent, TimePoint> recent_;
    std::deque<Sent> recent_order_;
    std::map<std::pair<std::string, std::int64_t>, std::int64_t>
        given_;                                           // its number, by client and number at home
    std::map<std::int64_t, Origin> origins_;              // by its number
    std::map<std::string, Visitor> visitors_;             // by client at home
    std::map<std::string, Sender, std::less<>> clients_;  // by id there
    std::deque<std::string> ended_;                       // ids there, oldest first
};

}  // namespace axon::partner
