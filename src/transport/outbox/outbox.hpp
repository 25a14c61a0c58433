// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include "transport/outbox/answered_messages.hpp"
#include "transport/outbox/outbox_core.hpp"

namespace axon::transport {

/// Given to each asynchronous call of Ice, which uses a twoway proxy where `answered` is set, a oneway proxy
/// otherwise. `failed` or what is set of the other two is called, once.
struct SendCallbacks {
    std::function<void()> answered;
    std::function<void(std::exception_ptr)> failed;
    std::function<void(bool)> sent;
};

/// When a message has left an outbox.
enum class Until : std::uint8_t {
    Written,  ///< to the socket
    /// Control and data: answered by the consumer, it or one after it (AnsweredMessages). A router takes
    /// whatever it is sent, and its memory has no bound but this one (and sendAll() goes beyond it). Signals
    /// and heartbeats never wait for an answer.
    Answered
};

/// Messages on their way to one consumer over one lane. Servants' callback adapters (EntityOutbox,
/// ClientOutbox) and the sessions of clients and Entity Managers send through it.
///
/// Flow: post() asks OutboxCore. Usually nothing is in the way, and the message goes to Ice from the caller's
/// thread without a copy of our own; otherwise an owning copy waits until Ice has written enough. Threads:
/// any. One mutex, never held across a call of Ice or of `disconnect`. Lifetime: held by shared_ptr; Ice's
/// callbacks keep it alive. Failure: a failed send closes it; where messages are answered it
/// also calls `disconnect`, because no connection that ends says so. An overflow calls that, once.
class Outbox : public std::enable_shared_from_this<Outbox> {
  public:
    /// Must not call back into the outbox's owner before it returns: closing a connection is what it is for.
    using Disconnect = std::function<void(bool improper, const std::string& why)>;
    using Parcel = std::function<void(SendCallbacks&&)>;

    Outbox(OutboxLimits limits, Disconnect disconnect, Until until = Until::Written)
        : disconnect_(std::move(disconnect)),
          until_(until),
          core_(limits),
          answers_(limits.window_bytes / kAsksInWindow) {}
    /// Whoever used it last held the mutex; that its reference was let go of before this one is counted in
    /// libIce, out of ThreadSanitizer's sight.
    ~Outbox() { const std::lock_guard lock(mutex_); }

    /// `send(SendCallbacks&&)` makes the asynchronous call, perhaps at once; `own()` returns a Parcel that
    /// does the same from copies. `bytes` is about the message's size on the wire. Returns false, and sends
    /// nothing, when it is beyond the share of `from`.
    template <class Send, class Own>
    bool post(Traffic traffic, std::size_t bytes, Send&& send, Own&& own, SenderKey from = kServersOwn) {
        using Verdict = OutboxCore<Parcel>::Verdict;
        Verdict verdict;
        std::uint64_t number = 0;
        {
            const std::lock_guard lock(mutex_);
            verdict = core_.offer(traffic, bytes, own, from);
            if (verdict == Verdict::Send) number = numberOf({traffic, bytes, from});
        }
        if (verdict == Verdict::Send) {
            launch({traffic, bytes, from}, number, send);
        } else if (verdict == Verdict::Overflow) {
            disconnect_(true, traffic == Traffic::Signal ? "it does not take signals"
                                                         : "it does not read its messages");
        }
        return verdict != Verdict::Refused;
    }

    /// Of control and data that may not wait: false where it would have to, and nothing has happened then.
    template <class Send>
    bool postAtOnce(Traffic traffic, std::size_t bytes, Send&& send) {
        using Verdict = OutboxCore<Parcel>::Verdict;
        const AnsweredMessages::Message message{traffic, bytes, kServersOwn};
        std::uint64_t number = 0;
        {
            const std::lock_guard lock(mutex_);
            if (!core_.mayPass() || core_.offer(traffic, bytes, [] { return Parcel(); }) != Verdict::Send)
                return false;
            number = numberOf(message);
        }
        launch(message, number, send);
        return true;
    }
    /// Gives Ice all that waits, however much that is, and what is posted afterwards: before an orderly end,
    /// at which Ice sends what it has and then closes the connection. Where messages are answered, each of
    /// these is.
    void sendAll();
    void close();
    bool closed() const;
    OutboxCounts counts() const;

  private:
    static constexpr std::size_t kAsksInWindow = 4;

    bool isAnswered(Traffic traffic) const {
        return until_ == Until::Answered && (traffic == Traffic::Control || traffic == Traffic::Data);
    }
    /// Of what is sent now, under mutex_: 0 if it need not be answered.
    std::uint64_t numberOf(const AnsweredMessages::Message& message) {
        return isAnswered(message.traffic) ? answers_.onSend(message) : 0;
    }
    template <class Send>
    void launch(const AnsweredMessages::Message& message, std::uint64_t number, Send& send) {
        SendCallbacks back;
        auto self = shared_from_this();
        back.failed = [self](const std::exception_ptr& error) { self->fail(error); };
        if (number != 0) {
            back.answered = [self = std::move(self), number] { self->onAnswer(number); };
        } else if (!isAnswered(message.traffic)) {
            back.sent = [self = std::move(self), message](bool) { self->onSent(message); };
        }
        try {
            send(std::move(back));
        } catch (const std::exception&) {
            fail(std::current_exception());  // the connection or the communicator is gone; its close callback
                                             // tells the owner
        }
    }
    void onSent(const AnsweredMessages::Message& message);
    void onAnswer(std::uint64_t number);
    void pump();
    void fail(const std::exception_ptr& error);

    const Disconnect disconnect_;
    const Until until_;
    mutable std::mutex mutex_;
    OutboxCore<Parcel> core_;   // guarded by mutex_
    AnsweredMessages answers_;  // guarded by mutex_; empty but where until_ is Answered
};

}  // namespace axon::transport
