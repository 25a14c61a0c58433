// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/observer.hpp"

#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <algorithm>

#include "simulation/laboratory.hpp"

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;

/// docs/explanation/safety.md, "Watchdogs": the watchdog of each hop while a task runs, and what is allowed
/// beside it.
constexpr Duration kClientWatchdog = 250ms;
constexpr Duration kServerWatchdog = 250ms;
constexpr Duration kManagerWatchdog = 100ms;
constexpr Duration kAllowance = 100ms;
constexpr Duration kLookAgain = 40ms;
/// Tasks one after another are one motion if the robot stands for less than this between them.
constexpr Duration kPause = 20ms;
/// By the end of a run everything has been passed on that is older than this.
constexpr Duration kArrives = 3s;

bool latches(StopCause cause) {
    return cause == StopCause::Requested || cause == StopCause::ClientLost || cause == StopCause::Improper;
}

bool isLoss(StopCause cause) {
    return cause == StopCause::ClientLost || cause == StopCause::Improper || cause == StopCause::ServerLost ||
           cause == StopCause::LinkLost || cause == StopCause::Fault;
}

std::string text(LeaseNumber lease) {
    return std::to_string(lease.epoch) + '.' + std::to_string(lease.number);
}

}  // namespace

const char* toString(Invariant invariant) {
    static constexpr std::array<const char*, kInvariants> kNames{
        "one-lease", "fence",      "dead-man", "latch",   "once",  "too-late",
        "order",     "comes-back", "bounded",  "journal", "unhurt"};
    return kNames[static_cast<std::size_t>(invariant)];
}

void Counts::add(const Counts& other) {
    for (const auto& each : kCounts) this->*each.count += other.*each.count;
}

void Observer::violated(Invariant invariant, std::string what) {
    if (violation_) return;
    timeline_.tell("PROMISE", [&] { return std::string("broken: ") + toString(invariant) + ": " + what; });
    violation_ = Violation{invariant, timeline_.now(), std::move(what)};
}

void Observer::addEntity(const std::string& name, Hops hops) {
    Entity entity;
    entity.name = name;
    entity.hops = hops;
    entities_.push_back(std::move(entity));
}

void Observer::sessionEnded(const std::string& id) {
    const auto found = sessions_.find(id);
    if (found == sessions_.end() || found->second.ended_at) return;
    found->second.ended_at = timeline_.now();
    faultBegins();
}

std::string Observer::label(const std::string& task_id) const {
    const auto id = Id128::fromBytes(task_id);
    return "task " + (id ? id->toString().substr(0, 8) : std::string("?"));
}

void Observer::managerStarts(std::size_t number) {
    auto& entity = entities_[number];
    entity.status.reset();
    entity.present_holder.clear();
    entity.holder_since = timeline_.now();
}

void Observer::managerDies(std::size_t number) {
    auto& entity = entities_[number];
    entity.present_holder.clear();
    entity.holder_since = timeline_.now();
    entity.ended = true;  // what it had granted ends with it
    entity.stops_to_note.clear();
    entity.status.reset();
}

void Observer::taskArrives(std::size_t number, const Header& head, const proto::TaskRequest& request,
                           TimePoint local) {
    ++counts_.tasks;
    auto& facts = tasks_[request.task_id()];
    if (facts.order != 0) return;  // a repetition changes nothing of when it came first
    facts.entity = number;
    facts.held = head.held;
    facts.generation = static_cast<std::uint32_t>(head.stop_generation);
    facts.sequence = head.sequence;
    facts.arrived = timeline_.now();
    facts.arrived_local = local;
    facts.life = entities_[number].hops.manager->life();
    facts.not_after_s = request.not_after_s();
    facts.order = ++order_;
}

void Observer::inHand(std::size_t number, const Header* head) {
    auto& entity = entities_[number];
    entity.in_hand = head != nullptr;
    entity.rearm_in_hand = head != nullptr && head->msg_type == kMsgRearm;
    entity.stale_in_hand = head != nullptr && head->held != LeaseNumber{} && head->held < entity.highest;
}

void Observer::toApplication(std::size_t number, const proto::EmToEi& message, TimePoint local) {
    auto& entity = entities_[number];
    if (message.has_pause() && !message.pause().resume() && !entity.in_hand) ++counts_.held;
    if (message.has_pause() && message.pause().resume() && entity.latch_wanted)
        violated(Invariant::Latch, entity.name + ": a task is resumed after a stop and before a rearm");
    if (entity.stale_in_hand && (message.has_param() || message.has_raw() || message.has_text() ||
                                 message.has_cancel() || message.has_pause()))
        violated(Invariant::Fence,
                 entity.name + ": what was sent under an older lease reaches the application");
    if (!message.has_task()) return;
    ++counts_.dispatches;
    const auto& id = message.task().task_id();
    const auto found = tasks_.find(id);
    timeline_.mark(entity.raised * 977 + number);
    timeline_.tell(entity.name + ".em", [&] {
        return "dispatches " + label(id) + ", generation " + std::to_string(message.task().stop_generation());
    });
    if (found == tasks_.end()) {
        violated(Invariant::Fence, entity.name + ": dispatched " + label(id) + ", which nobody has sent");
        return;
    }
    auto& facts = found->second;
    if (++facts.dispatches > 1)
        violated(Invariant::Once, entity.name + ": " + label(id) + " is dispatched again");
    if (!facts.noted)
        violated(Invariant::Journal,
                 entity.name + ": " + label(id) + " is dispatched, and the journal does not know");
    if (facts.ended)
        violated(Invariant::Once,
                 entity.name + ": " + label(id) + " is dispatched after its sender was told its end");
    if (facts.held != entity.highest)
        violated(Invariant::Fence, entity.name + ": " + label(id) + " was sent under lease " +
                                       text(facts.held) + ", the newest is " + text(entity.highest));
    else if (entity.ended)
        violated(Invariant::OneLease, entity.name + ": " + label(id) + " is dispatched after its lease " +
                                          text(facts.held) + " has ended");
    if (facts.generation < entity.voided) {
        const bool later = entity.voided_order > facts.order;
        violated(later ? Invariant::TooLate : Invariant::Fence,
                 entity.name + ": " + label(id) + " was sent at stop generation " +
                     std::to_string(facts.generation) +
                     (later ? " and is dispatched after a later stop, generation " : ", below the newest, ") +
                     std::to_string(entity.voided));
    }
    if (facts.not_after_s > 0 &&
        local - facts.arrived_local > std::chrono::duration<double>(facts.not_after_s) + 1us)
        violated(Invariant::TooLate, entity.name + ": " + label(id) + " is dispatched after its not_after");
    if (entity.latch_wanted)
        violated(Invariant::Latch,
                 entity.name + ": " + label(id) + " is dispatched after a stop and before a rearm");
    if (facts.order < entity.rearmed_order)
        violated(Invariant::Latch,
                 entity.name + ": " + label(id) + ", which came before the rearm, is dispatched after it");
    auto& last = entity.last_sequence[facts.held];
    if (facts.sequence <= last)
        violated(Invariant::Order, entity.name + ": " + label(id) +
                                       " overtook one that was sent before it under the same lease");
    last = std::max(last, facts.sequence);
}

void Observer::stopGoesOut(std::size_t number, std::uint32_t generation, StopCause cause, bool signal) {
    auto& entity = entities_[number];
    ++counts_.stops;
    timeline_.mark(generation * 31 + number);
    timeline_.tell(entity.name + ".em", [&] {
        return std::string("stop ") + std::to_string(generation) + " (" + toString(cause) +
               ") to the application";
    });
    if (entity.stale_in_hand && cause == StopCause::Released)
        violated(Invariant::Fence, entity.name + ": a release under an older lease ends the newest");
    if (generation <= entity.raised)
        violated(Invariant::Fence, entity.name + ": a stop has generation " + std::to_string(generation) +
                                       ", and " + std::to_string(entity.raised) + " was given before");
    entity.raised = std::max(entity.raised, generation);
    if (cause != StopCause::Reset) {
        entity.voided = std::max(entity.voided, generation);
        entity.voided_order = ++order_;
    }
    entity.stops_to_note.push_back(generation);
    const bool held = entity.status && !entity.status->holder.id.empty();
    // A liar that holds it may leave as it likes.
    if (isLoss(cause) && (!held || sessions_.contains(entity.status->holder.id)))
        hurt(entity.name + ": a stop for " + toString(cause) + ", and nothing was lost");
    if (latches(cause) && (signal || cause == StopCause::ClientLost)) wantLatch(entity);
    if (cause == StopCause::ServerLost && held) wantLatch(entity);
}

void Observer::linkLost(std::size_t number) {
    auto& entity = entities_[number];
    if (entity.status && !entity.status->holder.id.empty()) wantLatch(entity);
}

void Observer::wantLatch(Entity& entity) {
    entity.latch_wanted = true;
    entity.latch_told = false;
}

void Observer::toClient(std::size_t number, const Header& head, const proto::ToClient& message) {
    auto& entity = entities_[number];
    if (message.has_hand_over() && !message.hand_over().withdrawn()) ++counts_.questions;
    if (message.has_lease_ended())
        entity.end_told = std::max(
            entity.end_told, LeaseNumber{static_cast<std::int32_t>(message.lease_ended().lease().epoch()),
                                         static_cast<std::int32_t>(message.lease_ended().lease().number())});
    if (message.has_check_out()) {
        const auto& reply = message.check_out();
        if (reply.place() > 0) ++counts_.waits;
        if (reply.refusal().code() == proto::HAND_OVER_REFUSED) ++counts_.kept;
        if (!reply.has_lease()) return;
        ++counts_.grants;
        const LeaseNumber lease{static_cast<std::int32_t>(reply.lease().epoch()),
                                static_cast<std::int32_t>(reply.lease().number())};
        timeline_.mark(static_cast<std::uint64_t>(lease.number) * 131 + number);
        timeline_.tell(entity.name + ".em",
                       [&] { return "grants lease " + text(lease) + " to " + head.sender.name; });
        if (entity.granted < lease)
            violated(Invariant::Journal,
                     entity.name + ": lease " + text(lease) + " is granted, and the journal does not know");
        if (lease < entity.highest)
            violated(Invariant::OneLease, entity.name + ": lease " + text(lease) + " is granted, and " +
                                              text(entity.highest) + " was before");
        if (lease == entity.highest && entity.ended)
            violated(Invariant::OneLease,
                     entity.name + ": lease " + text(lease) + " is granted again after its end");
        if (lease > entity.highest) {
            // Handed over in one step: it never was free, but its holder must have been told, and the
            // journal.
            const bool ended =
                entity.ended || (entity.end_told >= entity.highest && entity.lease_ended >= entity.highest);
            if (!ended && entity.holder != head.sender.id)
                violated(Invariant::OneLease, entity.name + ": lease " + text(lease) +
                                                  " is granted, and the end of " + text(entity.highest) +
                                                  " was not told");
            if (entity.moves)
                violated(Invariant::OneLease,
                         entity.name + ": granted to " + head.sender.name + " while it moves");
            entity.highest = lease;
            entity.keys.emplace_back(lease, reply.lease().key());
        } else if (entity.holder != head.sender.id && sessions_.contains(entity.holder) &&
                   !sessions_[entity.holder].ended_at) {
            violated(Invariant::OneLease,
                     entity.name + ": two live clients were granted lease " + text(lease));
        }
        // Each session counts its messages from one.
        if (entity.holder != head.sender.id) entity.last_sequence.erase(lease);
        entity.holder = head.sender.id;
        entity.ended = false;
    } else if (message.has_task() && message.task().state() >= proto::TASK_SUCCEEDED) {
        const auto found = tasks_.find(message.task().task_id());
        // A repetition of a task that runs is refused, which is not the end of the task.
        if (found == tasks_.end() || message.task().reason().code() == proto::DUPLICATE) return;
        auto& facts = found->second;
        facts.ended = true;
        if (facts.dispatches > 0 && !facts.end_noted)
            violated(Invariant::Journal, entity.name + ": the end of " + label(message.task().task_id()) +
                                             " is told, and the journal does not know");
    }
}

void Observer::managerIs(std::size_t number, const EntityStatus& status) {
    auto& entity = entities_[number];
    if (entity.status && *entity.status == status) return;
    uuids_.insert(status.entity);
    timeline_.mark(static_cast<std::uint64_t>(status.state) * 7 + (status.latched ? 1 : 0));
    timeline_.tell(entity.name + ".em", [&] {
        return std::string("is ") + axon::toString(status.state) + (status.latched ? ", latched" : "") +
               ", generation " + std::to_string(status.stop_generation) +
               (status.holder.id.empty()
                    ? ""
                    : ", held by " + status.holder.name + " under " + text(status.held)) +
               (status.reason.empty() ? "" : ": " + status.reason);
    });
    if (entity.status && status.stop_generation < entity.status->stop_generation)
        violated(Invariant::Fence, entity.name + ": its stop generation fell from " +
                                       std::to_string(entity.status->stop_generation) + " to " +
                                       std::to_string(status.stop_generation));
    if (status.orphaned && status.state == EntityState::BUSY && entity.status && !entity.status->orphaned &&
        entity.moves && entity.alone == aloneFor("Dock"))
        ++counts_.finished;
    if (status.latched) entity.latch_told = true;
    const bool handled = static_cast<std::uint32_t>(status.stop_generation) >= entity.voided;
    if (!status.latched && entity.latch_wanted && (handled || entity.latch_told)) {
        if (!entity.rearm_in_hand && handled)
            violated(Invariant::Latch,
                     entity.name + (entity.latch_told ? ": the latch is gone, and nobody has rearmed"
                                                      : ": a stop did not latch"));
        if (entity.rearm_in_hand && handled) {
            ++counts_.rearms;
            entity.latch_wanted = false;
            entity.rearmed_order = ++order_;
            if (entity.rearms_noted < ++entity.rearms)
                violated(Invariant::Journal, entity.name + ": it was rearmed, and the journal does not know");
        }
    }
    for (const auto generation : entity.stops_to_note)
        if (static_cast<std::uint32_t>(status.stop_generation) >= generation)
            violated(Invariant::Journal, entity.name + ": stop " + std::to_string(generation) +
                                             " was given, and the journal does not know");
    if (status.holder.id.empty()) {
        if (!entity.ended && entity.lease_ended < entity.highest)
            violated(Invariant::Journal, entity.name + ": lease " + text(entity.highest) +
                                             " has ended, and the journal does not know");
        entity.ended = true;
    }
    if (!status.holder.id.empty() && status.held < entity.highest)
        violated(Invariant::OneLease, entity.name + ": it says that lease " + text(status.held) +
                                          " holds, and " + text(entity.highest) + " was granted");
    entity.status = status;
    holderIs(number, status.holder.id);
}

void Observer::holderIs(std::size_t number, const std::string& holder) {
    auto& entity = entities_[number];
    if (entity.present_holder == holder) return;
    entity.present_holder = holder;
    entity.holder_since = timeline_.now();
    if (entity.moves) watchMotion(number, kClientWatchdog + kAllowance);
}

void Observer::stopRaises(std::size_t number, const Header& head, std::uint32_t life) {
    auto& entity = entities_[number];
    if (head.sequence <= 0) return;
    const auto [seen, fresh] = entity.stops_seen.try_emplace({head.sender.id, head.sequence}, life);
    if (!fresh && seen->second == life)
        violated(Invariant::Fence, entity.name + ": stop " + std::to_string(head.sequence) + " of " +
                                       head.sender.name + " raises the generation twice");
    seen->second = life;
}

void Observer::noted(std::size_t number, const entity_manager::JournalRecord& record) {
    using Kind = entity_manager::JournalRecord::Kind;
    auto& entity = entities_[number];
    switch (record.kind) {
        case Kind::TakenOver:
            ++(record.text.find(" hands it over to ") == std::string::npos ? counts_.forced
                                                                           : counts_.handed_over);
            entity.granted = std::max(entity.granted, record.lease);
            entity.taken_over = record.lease;
            return;
        case Kind::Resumed:
            ++counts_.resumed;
            entity.granted = std::max(entity.granted, record.lease);
            return;
        case Kind::Granted:
            entity.granted = std::max(entity.granted, record.lease);
            return;
        case Kind::LeaseEnded:
            if (record.code == "EXPIRED") ++counts_.lost_for_good;
            if (record.lease == entity.taken_over && entity.end_told < record.lease)
                violated(Invariant::OneLease, entity.name + ": lease " + text(record.lease) +
                                                  " was taken over, and who had it was not told");
            entity.lease_ended = std::max(entity.lease_ended, record.lease);
            return;
        case Kind::Stopped:
            std::erase(entity.stops_to_note, record.generation);
            return;
        case Kind::Rearmed:
            ++entity.rearms_noted;
            return;
        case Kind::Dispatched:
        case Kind::TaskEnded:
            if (const auto found = tasks_.find(record.task.bytes()); found != tasks_.end())
                (record.kind == Kind::Dispatched ? found->second.noted : found->second.end_noted) = true;
            return;
        default:
            return;
    }
}

void Observer::sends(const Header& head) {
    auto& row = to_entity_[{head.sender.id, head.entity}];
    if (nothing_fails_) row.sent.emplace_back(head.sequence, timeline_.now());
}

void Observer::tells(const Header& head) {
    auto& row = to_client_[{head.sender.id, head.entity}];
    if (nothing_fails_) row.sent.emplace_back(head.sequence, timeline_.now());
}

/// Where nothing fails it is the oldest that has not been passed on.
void Observer::takeNext(Row& row, const Header& head) {
    row.passed = head.sequence;
    row.sent_at_us = head.sent_at_us;
    if (!nothing_fails_ || row.sent.empty()) return;
    if (row.sent.front().first < head.sequence)
        violated(Invariant::Order, "message " + std::to_string(row.sent.front().first) + " is lost: " +
                                       std::to_string(head.sequence) + " of the same sender (" +
                                       head.msg_type + ") is passed on, and nothing has failed");
    while (!row.sent.empty() && row.sent.front().first <= head.sequence) row.sent.pop_front();
}

void Observer::passes(std::size_t number, const Header& head, bool repeated) {
    const auto found = to_entity_.find({head.sender.id, head.entity});
    if (found == to_entity_.end()) return;
    auto& row = found->second;
    if (const auto life = entities_[number].hops.manager->life(); row.life != life) {
        row.life = life;
        row.passed = 0;
    }
    if (repeated && head.sequence <= row.passed) return;
    if (head.sequence <= row.passed)
        violated(Invariant::Once, entities_[number].name + ": message " + std::to_string(head.sequence) +
                                      " of " + head.sender.name + " (" + head.msg_type +
                                      ") is passed on after " + std::to_string(row.passed));
    takeNext(row, head);
}

void Observer::hears(const Header& head) {
    const auto found = to_client_.find({head.sender.id, head.entity});
    if (found == to_client_.end()) return;
    auto& row = found->second;
    // Another life of the Entity Manager counts anew, and later.
    if (head.sequence <= row.passed && head.sent_at_us <= row.sent_at_us)
        violated(Invariant::Once, head.sender.name + ": message " + std::to_string(head.sequence) + " (" +
                                      head.msg_type + ") of an entity is passed on after " +
                                      std::to_string(row.passed));
    takeNext(row, head);
}

void Observer::pathOpens(std::size_t number, bool proper) {
    if (!proper)
        violated(Invariant::OneLease,
                 entities_[number].name +
                     ": a direct path is opened by somebody who has not proved to be the holder");
}

std::vector<std::pair<LeaseNumber, std::string>> Observer::endedLeases() const {
    std::vector<std::pair<LeaseNumber, std::string>> ended;
    for (const auto& entity : entities_)
        for (const auto& key : entity.keys)
            if (key.first < entity.highest) ended.push_back(key);
    return ended;
}

void Observer::judgeMessages() {
    if (!nothing_fails_) return;
    for (const auto& [who, row] : to_entity_)
        if (!row.sent.empty() && uuids_.contains(who.second) &&
            timeline_.now() - row.sent.front().second > kArrives)
            violated(Invariant::Order, "message " + std::to_string(row.sent.front().first) + " to " +
                                           who.second.substr(0, 8) +
                                           " has not arrived, and nothing has failed");
}

void Observer::dispatched(std::size_t number, const std::string& task_id) {
    auto& facts = tasks_[task_id];
    if (++facts.reached > 1)
        violated(Invariant::Once,
                 entities_[number].name + ": " + label(task_id) + " has reached the application twice");
}

void Observer::moves(std::size_t number, bool moves, Duration alone) {
    auto& entity = entities_[number];
    const auto now = timeline_.now();
    const auto pause = entity.moves ? Duration{} : now - entity.stands_since;
    const bool begins = pause >= kPause;
    if (moves) {
        // A stricter one has begun to move, or the strict one has ended: from now on it counts.
        entity.alone_since = begins || alone < entity.alone ? now : entity.alone_since + pause;
        entity.alone = alone;
    }
    if (entity.moves == moves) return;
    entity.moves = moves;
    timeline_.mark(moves ? 3 : 5);
    timeline_.tell(entity.name, [&] { return moves ? "MOVES" : "stands"; });
    if (!moves) {
        entity.stands_since = now;
        return;
    }
    entity.moves_since = begins ? now : entity.moves_since + pause;
    watchMotion(number, kManagerWatchdog + kAllowance);
}

void Observer::faultBegins() {
    for (std::size_t number = 0; number < entities_.size(); ++number) {
        if (!entities_[number].moves) continue;
        watchMotion(number, kManagerWatchdog + kAllowance);
        watchMotion(number, kClientWatchdog + kAllowance);
    }
}

void Observer::watchMotion(std::size_t number, Duration in) {
    timeline_.after(Duration{static_cast<Duration::rep>(static_cast<double>(in.count()) * (1 + drift_))} +
                        4 * delay_ + 1us,
                    world_, [this, number] { judgeMotion(number); });
}

/// The chain of control, from the client down: a hop that has been broken for longer than its watchdog and
/// the allowance, while all below it worked, and a robot that has moved all the time.
void Observer::judgeMotion(std::size_t number) {
    const auto& entity = entities_[number];
    if (!entity.moves || violation_) return;
    const auto now = timeline_.now();
    const auto& hops = entity.hops;
    const auto bound = [&](Duration watchdog) {
        return Duration{static_cast<Duration::rep>(static_cast<double>((watchdog + kAllowance).count()) *
                                                   (1 + drift_))} +
               4 * delay_;
    };
    const auto worksFor = [&](const Process& process, Duration time) {
        return process.running() && now - process.changedAt() >= time;
    };
    if (!hops.application->running()) return;
    bool broken = false;
    auto moves_since = entity.moves_since;

    // 3: the Entity Manager, watched by the Entity Interfacer.
    const auto manager_bound = bound(kManagerWatchdog);
    const auto judge = [&](TimePoint since, Duration limit, bool rest_works, const char* what) {
        broken = true;
        const auto from = std::max(since, moves_since);
        if (now - from < limit || !rest_works) return;
        violated(
            Invariant::DeadMan,
            entity.name + " still moves " +
                std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(now - from).count()) +
                " ms after " + what);
    };
    if (!hops.manager->running())
        judge(hops.manager->changedAt(), manager_bound, worksFor(*hops.application, manager_bound),
              "its Entity Manager failed");

    // 2: the server and the way from it, watched by the Entity Manager.
    const auto server_bound = bound(kServerWatchdog);
    const bool below_server =
        worksFor(*hops.manager, server_bound) && worksFor(*hops.application, server_bound);
    // A way that is whole again brings the beats that it had held back, and they are signs of life.
    const auto unheard = [](const Process& process, const Path& path, std::size_t direction) {
        return path.cut[direction] ? process.changedAt()
                                   : std::max(process.changedAt(), path.changed_at[direction]);
    };
    if (!hops.server->running())
        judge(unheard(*hops.server, *hops.server_path, 1), server_bound, below_server, "the server failed");
    if (hops.server_path->cut[1])
        judge(hops.server_path->changed_at[1], server_bound, below_server, "the way from the server was cut");

    // 1: the client that holds it, watched by the front-end server.
    const auto client_bound = bound(kClientWatchdog);
    const bool below_client =
        worksFor(*hops.manager, client_bound) && worksFor(*hops.application, client_bound) &&
        worksFor(*hops.server, client_bound) && !hops.server_path->cut[0] && !hops.server_path->cut[1] &&
        now - hops.server_path->changed_at[0] >= client_bound &&
        now - hops.server_path->changed_at[1] >= client_bound;
    moves_since = std::max(moves_since, entity.alone_since);
    const auto alone_bound =
        client_bound +
        Duration{static_cast<Duration::rep>(static_cast<double>(entity.alone.count()) * (1 + drift_))};
    if (entity.present_holder.empty())
        judge(entity.holder_since, client_bound, below_client, "nobody held it");
    if (const auto found = sessions_.find(entity.present_holder); found != sessions_.end()) {
        const auto& session = found->second;
        if (session.ended_at)
            judge(*session.ended_at, alone_bound, below_client, "its client's session ended");
        else if (!session.process->running())
            judge(unheard(*session.process, *session.path, 0), alone_bound, below_client,
                  "its client failed");
        else if (session.path->cut[0])
            judge(session.path->changed_at[0], alone_bound, below_client, "the way from its client was cut");
    }
    if (broken && !violation_) watchMotion(number, kLookAgain);
}

}  // namespace axon::simulation
