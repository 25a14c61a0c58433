// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include "transport/outbox_core.hpp"

namespace axon::transport {

/// Given to each asynchronous oneway call of Ice: exactly one of the two is called.
struct SendCallbacks {
    std::function<void(std::exception_ptr)> failed;
    std::function<void(bool)> sent;
};

/// Messages on their way to one consumer over one lane. Servants' callback adapters (EntityOutbox,
/// ClientOutbox) and the client's session send through it.
///
/// Flow: post() asks OutboxCore. Usually nothing is in the way, and the message goes to Ice from the caller's
/// thread without a copy of our own; otherwise an owning copy waits until Ice has written enough. Threads:
/// any. One mutex, never held across a call of Ice or of `disconnect`. Lifetime: held by shared_ptr; Ice's
/// callbacks keep it alive. Failure: a failed send closes it. An overflow calls `disconnect(why)`, once.
class Outbox : public std::enable_shared_from_this<Outbox> {
  public:
    /// Must not call back into the outbox's owner before it returns: closing a connection is what it is for.
    using Disconnect = std::function<void(const std::string& why)>;
    using Parcel = std::function<void(SendCallbacks&&)>;

    Outbox(OutboxLimits limits, Disconnect disconnect) : disconnect_(std::move(disconnect)), core_(limits) {}
    /// Whoever used it last held the mutex; that its reference was let go of before this one is counted in libIce,
    /// out of ThreadSanitizer's sight.
    ~Outbox() { const std::lock_guard lock(mutex_); }

    /// `send(SendCallbacks&&)` makes the asynchronous call, perhaps at once; `own()` returns a Parcel that
    /// does the same from copies. `bytes` is about the message's size on the wire.
    template <class Send, class Own>
    void post(Traffic traffic, std::size_t bytes, Send&& send, Own&& own) {
        using Verdict = OutboxCore<Parcel>::Verdict;
        Verdict verdict;
        {
            const std::lock_guard lock(mutex_);
            verdict = core_.offer(traffic, bytes, own);
        }
        if (verdict == Verdict::Send) {
            launch(traffic, bytes, send);
        } else if (verdict == Verdict::Overflow) {
            disconnect_(traffic == Traffic::Signal ? "it does not take signals"
                                                   : "it does not read its messages");
        }
    }

    void close();
    OutboxCounts counts() const;

  private:
    template <class Send>
    void launch(Traffic traffic, std::size_t bytes, Send& send) {
        try {
            send(SendCallbacks{
                [self = shared_from_this()](std::exception_ptr) { self->close(); },
                [self = shared_from_this(), traffic, bytes](bool) { self->onSent(traffic, bytes); }});
        } catch (const std::exception&) {
            close();  // the connection or the communicator is gone; its close callback tells the owner
        }
    }
    void onSent(Traffic traffic, std::size_t bytes);

    const Disconnect disconnect_;
    mutable std::mutex mutex_;
    OutboxCore<Parcel> core_;  // guarded by mutex_
};

}  // namespace axon::transport
