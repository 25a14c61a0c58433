// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <asio/steady_timer.hpp>
#include <cstdint>
#include <memory>
#include <utility>

#include "common/clock.hpp"

namespace axon::entity_manager {

/// A timer of a strand on the injected clock, for one time: the last that was set.
///
/// asio's timer knows the machine's time only, so it is asked again when it rings too early by the clock.
/// States: idle ─ at() ► due ─ rings, or cancel() ► idle; at() while due replaces time and call, also where
/// the old one was under way. Threads: the strand's alone, where the call is made as well. The call must hold
/// its owner weakly: it may be under way when the owner ends.
class DueTimer {
  public:
    DueTimer(const asio::any_io_executor& strand, const Clock& clock)
        : state_(std::make_shared<State>(strand, clock)) {}
    DueTimer(const DueTimer&) = delete;
    DueTimer& operator=(const DueTimer&) = delete;

    template <class Call>
    void at(TimePoint due, Call call) {
        state_->due = due;
        await(state_, ++state_->number, std::move(call));
    }
    void cancel() {
        state_->due = TimePoint::max();
        ++state_->number;
        state_->timer.cancel();
    }
    /// TimePoint::max() while it is idle.
    TimePoint due() const { return state_->due; }

  private:
    struct State {
        State(const asio::any_io_executor& strand, const Clock& its_clock)
            : clock(its_clock), timer(strand) {}
        const Clock& clock;
        asio::steady_timer timer;
        TimePoint due = TimePoint::max();
        std::uint64_t number = 0;  // of at() and cancel(): asio may have queued the handler of an earlier one
    };

    template <class Call>
    static void await(const std::shared_ptr<State>& state, std::uint64_t number, Call call) {
        state->timer.expires_after(state->clock.realTimeUntil(state->due));
        state->timer.async_wait([weak = std::weak_ptr(state), number,
                                 call = std::move(call)](const asio::error_code& cancelled) mutable {
            const auto its = weak.lock();
            if (cancelled || !its || its->number != number) return;
            if (its->clock.now() < its->due) return await(its, number, std::move(call));
            its->due = TimePoint::max();
            call();
        });
    }

    const std::shared_ptr<State> state_;
};

}  // namespace axon::entity_manager
