// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "axon/types.hpp"
#include "client/base/server_link.hpp"
#include "client/base/signal_marks.hpp"
#include "client/core/name_index.hpp"
#include "common/clock.hpp"

namespace axon::proto {
class StopReceipt;
}

namespace axon::client {

/// When a stop that is not confirmed is sent again, on both lanes.
inline constexpr Duration kStopFirstResend = std::chrono::milliseconds{100};
inline constexpr Duration kStopResendPeriod = std::chrono::milliseconds{250};
/// While receipts of it come it waits for kStopFirstResend without one, and no longer than this: the answers
/// of thousands take their time, and to ask again before they are through would make it longer.
inline constexpr Duration kStopPatience = std::chrono::seconds{1};

/// Gives stops and collects their receipts (docs/explanation/safety.md, "What a receipt says").
///
/// Where in the flow: beside SessionCore, not in it. It has its own lock in the Ice rim, its own link and its
/// own list of names, so that a stop never waits for anything that data does. An order is *open* from stop()
/// until every receipt is confirmed or its deadline has passed; then `done` is called, once, with what is
/// known. While it is open it is sent again, with the same sequence number (an EM takes it for the same
/// stop), on the signal lane and on the data lane, at kStopFirstResend and then every kStopResendPeriod, but
/// not while answers come (kStopPatience). Losing the connection does not end an order: it is sent again when
/// there is a new one, unless its deadline passed. Threads: none of its own, not thread-safe; the owner
/// confines it. Failure: refusals.
class StopDesk {
  public:
    using Done = std::function<void(Result<std::vector<Receipt>>)>;

    StopDesk(const Clock& clock, StopLink& link, SignalMarks& marks)
        : clock_(clock), link_(link), marks_(marks) {}

    void onConnected(const Sender& self);
    void onDisconnected();
    void onEntity(Presence presence, const std::string& id, const std::string& name, bool ready = true);
    /// newStopAccepted: the servers' stage, of one entity or ("") of all that the order names, and how many
    /// entities it reached. `sequence` is that of the order.
    void onStopAccepted(std::int64_t sequence, const std::string& entity, int entities);
    /// A receipt of an EM; those of other people's stops raise the generation and nothing else.
    void onReceipt(const std::string& entity, const proto::StopReceipt& receipt);
    /// newRefusalMsg: the servers do not, or no longer, know such an entity. A stop whose message was
    /// OVERLOADED is repeated.
    void onRefusal(std::int64_t sequence, const std::string& entity, const Refusal& refusal);

    /// No names = every entity there is. In doubt it stops: an ambiguous name stops all that it may mean, and
    /// a name that is not found does not hold up the others (its refusal is the order's answer, when they are
    /// done). A stop of everything needs no names: it is done when the servers have said how many entities it
    /// reached and as many have answered, known here or not; those that have not are receipts without a name.
    /// Once all are confirmed it waits, up to `standstill` after the call, for those that are to come to
    /// rest.
    void stop(const std::vector<std::string>& names, Duration deadline, Done done, Duration standstill = {});
    /// Orders a drill in the same way: it is acknowledged and does nothing else. It is sent once, so that its
    /// times are those of one message. No names = every entity that is known.
    void drill(const std::vector<std::string>& names, Duration deadline, Done done);

    /// The receipts of a reset or clear that somebody else sends, under this sequence, once and after this
    /// call.
    void await(const std::string& entity, std::int64_t sequence, Duration deadline, Done done);
    /// It is not sent after all; `done` is not called.
    void withdraw(std::int64_t sequence);
    /// A reply of the entity itself to a reset or clear: refused.
    void onReply(const std::string& entity, std::string_view request_id, const Refusal& refusal);

    void onTimer();
    TimePoint nextDeadline() const;
    /// Ends every open order with what is known: the client is being closed.
    void endOrders();
    std::size_t openOrders() const { return orders_.size(); }

  private:
    struct Order {
        std::int64_t sequence = 0;
        StopCause cause = StopCause::Requested;
        bool everything = false;
        bool repeats = true;  // sent again while it is not confirmed
        TimePoint given, deadline, resend;
        TimePoint rests_by;              // how long it waits for robots to come to rest
        TimePoint heard_at;              // the newest receipt
        TimePoint due;                   // the earlier of the two, in due_
        std::vector<std::string> named;  // UUIDs, until they are listed
        bool listed =
            false;  // the receipts have been made: not before it is sent, which thousands of them would delay
        std::map<std::string, Receipt> receipts;  // by UUID
        std::map<std::string, std::int64_t>
            said_at;                      // by UUID, on the Entity Manager's clock: the newest receipt
        std::size_t unconfirmed = 0;      // of the receipts
        std::size_t rolling = 0;          // confirmed, and to come to rest
        std::optional<int> reached;       // entities, of a stop of everything that was accepted
        std::optional<Seconds> accepted;  // likewise
        Refusal unknown;                  // of a name that was not found
        Done done;
    };
    void give(Order order, const std::vector<std::string>& names, Duration deadline, Done done);
    void send(const Order& order, Lane lane, std::vector<std::string> ids, bool again);
    Header header(const Order& order, const std::string& entity, bool again) const;
    Receipt& add(Order& order, const std::string& entity) const;
    /// Before anything looks at the receipts, or a name is forgotten.
    void list(Order& order) const;
    void listAll();
    static bool settled(const Order& order);
    /// Of everything: the servers have said how many it reached, and as many are known.
    static bool allKnown(const Order& order);
    void schedule(Order& order, TimePoint resend);
    /// Takes it out of everything that knows it.
    Order take(std::int64_t sequence);
    void finishIfSettled(const Order& order);
    void finish(std::int64_t sequence);
    Order* find(std::int64_t sequence);

    const Clock& clock_;
    StopLink& link_;
    SignalMarks& marks_;
    bool connected_ = false;
    Sender self_;
    NameIndex names_;
    std::map<std::int64_t, Order> orders_;              // by sequence
    std::set<std::int64_t> everything_;                 // those of orders_ that are of everything
    std::set<std::pair<TimePoint, std::int64_t>> due_;  // of orders_
};

}  // namespace axon::client
