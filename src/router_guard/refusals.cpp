// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/refusals.hpp"

#include <utility>

#include "common/refused_connection.hpp"

namespace axon::router_guard {

Refusals::Refusals(std::unique_ptr<audit::AuditTrail> trail, const Clock& clock, Say say)
    : clock_(clock), say_(std::move(say)), trail_(std::move(trail)) {}

void Refusals::onTrace(const std::string& trace) {
    if (const auto address = listeningAt(trace)) {
        const std::lock_guard lock(mutex_);
        listens_on_.emplace(portIn(*address));
        return;
    }
    const auto refused = refusedConnection(trace);
    if (!refused) return;
    const auto what = (refused->at == RefusedAt::TlsHandshake ? "a TLS handshake at " : "a connection to ") +
                      refused->local + ": " + refused->why;
    {
        const std::lock_guard lock(mutex_);
        // Otherwise this program has called somebody who does not speak Ice.
        if (refused->at == RefusedAt::Protocol && !listens_on_.contains(portIn(refused->local))) return;
        if (trail_)
            trail_->note({.kind = audit::Kind::Refusal,
                          .peer = refused->peer,
                          .what = what,
                          .outcome = refusalName(refused->code)});
    }
    if (lines_.admit(clock_.now()))
        say_("audit: a connection from " + refused->peer + " was refused: " + what + " (" + refused->said +
             ")");
}

void Refusals::end() {
    std::unique_ptr<audit::AuditTrail> ending;  // outside the lock, as it waits for the disk
    const std::lock_guard lock(mutex_);
    ending = std::move(trail_);
}

}  // namespace axon::router_guard
