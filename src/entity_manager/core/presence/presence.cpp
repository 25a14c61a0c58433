// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/presence/presence.hpp"

#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "common/entity_name.hpp"
#include "common/planted_bug.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "messages/text.hpp"

namespace axon::entity_manager {

namespace {

using std::chrono::milliseconds;

constexpr Duration kPositionPeriod = milliseconds{200};
constexpr Duration kRestUntold = milliseconds{20};

std::int32_t fifthOf(Duration watchdog) {
    return static_cast<std::int32_t>(std::chrono::duration_cast<milliseconds>(watchdog).count() / 5);
}

}  // namespace

Presence::Presence(Turn& turn, ServerPort& server, const Settings& settings)
    : turn_(turn),
      server_(server),
      entity_(settings.entity),
      liveness_(settings.watchdog_busy, settings.watchdog_idle, turn.now()) {
    liveness_.suspendGaps();  // until there is a session
    registration_.entity = entity_;
    registration_.name =
        isEntityName(settings.application) ? settings.application : inQuotes(settings.application);
    registration_.heartbeat_busy_ms = fifthOf(settings.watchdog_busy);
    registration_.heartbeat_idle_ms = fifthOf(settings.watchdog_idle);
}

void Presence::seek() {
    if (std::exchange(silent_, false)) server_.wantConnection(false);
    server_.wantConnection(true);
    if (up_ && turn_.state() == EntityState::ENVCONN) turn_.fire(upEvent());
}

/// A lease that outlived the session with the server is found again.
Event Presence::upEvent() const {
    return turn_.held() != nullptr && turn_.state() == EntityState::ENVCONN ? Event::ServerReturned
                                                                            : Event::ServerUp;
}

void Presence::sessionBegan() {
    if (up_) sessionEnded("the session with the server was replaced");
    up();
    turn_.fire(upEvent());
}

void Presence::sessionEnded(const std::string& reason) {
    down();
    Incident incident{Event::ServerDown};
    incident.cause = StopCause::ServerLost;
    incident.reason = {RefusalCode::NotConnected, "The Entity Manager lost the server: " + reason, {}};
    turn_.fire(incident);
}

void Presence::up() {
    up_ = true;
    liveness_.resumeGaps(turn_.now());
    heard();
    told_.reset();
}

void Presence::heard() {
    liveness_.heard(turn_.now());
}

void Presence::setBusy(bool busy) {
    if (!AXON_PLANTED(WatchdogAlwaysIdle)) liveness_.setBusy(busy, turn_.now());
    if (!up_) liveness_.suspendGaps();
}

std::optional<std::string> Presence::whySilent() {
    if (!up_ || !liveness_.expired(turn_.now())) return std::nullopt;
    silent_ = true;
    return "it has been silent for " +
           std::to_string(std::chrono::duration_cast<milliseconds>(liveness_.timeout()).count()) + " ms";
}

/// Before the watchdog trips, and seldom.
TimePoint Presence::warnAt() const {
    return std::max(liveness_.lateFrom(), warn_again_);
}

void Presence::onTimer() {
    const auto now = turn_.now();
    if (up_ && now >= warnAt()) {
        warn_again_ = now + Liveness::kWarnAgain;
        turn_.warn("the server: " + describe(liveness_.longest(now)) +
                   "; above that the robot stops. The network or one of the two hosts is overloaded");
    }
    if (!liveness_.expired(now)) sendPosition();
    if (const auto why = whySilent()) sessionEnded(*why);
}

TimePoint Presence::nextDeadline() const {
    auto next = TimePoint::max();
    if (up_) next = std::min({next, liveness_.deadline(), warnAt()});
    if (rest_told_at_) next = std::min(next, *rest_told_at_);
    if (position_waits_ && up_ && ready_) next = std::min(next, position_sent_ + kPositionPeriod);
    return next;
}

std::optional<HopMargin> Presence::margin() const {
    if (!up_) return std::nullopt;
    return HopMargin{"entity manager watches server", liveness_.longest(turn_.now())};
}

void Presence::describeWatchdogs(std::vector<HopMargin> others, proto::EntityStatus& status) const {
    if (auto own = margin()) others.insert(others.begin(), std::move(*own));
    for (const auto& [hop, gap] : others) {
        if (gap.allowed == Duration{}) continue;
        auto& margin = *status.add_watchdogs();
        margin.set_hop(hop);
        margin.set_timeout_ms(
            static_cast<std::uint32_t>(std::chrono::ceil<std::chrono::milliseconds>(gap.allowed).count()));
        margin.set_longest_gap_ms(
            static_cast<std::uint32_t>(std::chrono::ceil<std::chrono::milliseconds>(gap.length).count()));
    }
}

void Presence::profileIs(proto::BasicProfile profile) {
    if (position_waits_) {  // the robot has told its position before its profiles were good
        profile.set_xpos(profile_.xpos());
        profile.set_ypos(profile_.ypos());
        profile.set_zpos(profile_.zpos());
    }
    profile_ = std::move(profile);
    profile_.set_entity_id(entity_);
    registration_.name = profile_.name();
    registration_.category = proto::Category_Name(profile_.category());
    registration_.type = proto::Mobility_Name(profile_.type());
    ready_ = true;
}

void Presence::registerEntity() {
    told_.reset();
    server_.sendBasicPrfl(registration_, ready_ ? profile_ : proto::BasicProfile());
    if (!ready_) return;
    position_sent_ = turn_.now();
    position_waits_ = false;
}

void Presence::positionIs(const proto::PositionNote& position) {
    profile_.set_xpos(position.xpos());
    profile_.set_ypos(position.ypos());
    profile_.set_zpos(position.zpos());
    position_waits_ = true;
    sendPosition();
}

void Presence::sendPosition() {
    const auto now = turn_.now();
    if (!position_waits_ || !ready_ || !up_) return;
    if (now < position_sent_ + kPositionPeriod) return;
    position_sent_ = now;
    position_waits_ = false;
    server_.sendBasicPrfl(registration_, profile_);
}

void Presence::tell(EntityStatus status) {
    const auto rest_told_at = std::exchange(rest_told_at_, std::nullopt);
    if (!up_ || told_ == status) return;
    // Told each time, a rest between two steps is two broadcasts for each step.
    if (auto told = told_; told && told->state == EntityState::BUSY &&
                           (status.state == EntityState::SLAVE || status.state == EntityState::COLLAB)) {
        told->state = status.state;
        const auto at = rest_told_at.value_or(turn_.now() + kRestUntold);
        if (told == status && turn_.now() < at) {
            rest_told_at_ = at;
            return;
        }
    }
    server_.sendStatus(status);
    told_ = std::move(status);
}

}  // namespace axon::entity_manager
