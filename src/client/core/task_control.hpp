// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <utility>

#include "client/core/core_context.hpp"
#include "client/core/leases.hpp"
#include "client/core/requests.hpp"

namespace axon::client {

// Pause, resume and cancel, which are one message for tasks and runs. `noun` is "task" or "run". Threads:
// that of SessionCore.

/// Returns the sequence number of the message. Nobody waits for an answer.
std::int64_t sendControl(CoreContext& context, Id128 id, const Held& under, proto::TaskAction action);

/// Asks for it, in the place of what was asked before for the same id. Refused with WRONG_STATE when `state`,
/// the present one, is final, and where the lease is not ready.
template <class State>
void requestControl(const CoreParts& parts, Id128 id, const Held& under, State state,
                    proto::TaskAction action, const std::string& noun, Done done) {
    if (isFinal(state)) {
        return done(Refusal{
            RefusalCode::WrongState, "The " + noun + " has ended already: " + toString(state) + ".", {}});
    }
    if (const auto refusal = parts.leases.ready(under); !refusal.ok()) return done(refusal);
    parts.requests.settle<request::Control>(
        id, Refusal{RefusalCode::Cancelled, "A newer request for the same " + noun + " took its place.", {}});
    const auto sequence = sendControl(parts.context, id, under, action);
    parts.requests.await(id, {.entity = under.entity,
                              .lease = under.lease,
                              .sequence = sequence,
                              .what = request::Control{{std::move(done)}, action}});
}

/// It is in this state now: answers the request for it, where that says so.
template <class State>
void settleControl(Requests& requests, Id128 id, State state, const std::string& noun) {
    auto* pending = requests.find<request::Control>(id);
    if (pending == nullptr) return;
    if (const auto answer = pending->as<request::Control>().answerTo(state, noun))
        requests.settle<request::Control>(id, *answer);
}

}  // namespace axon::client
