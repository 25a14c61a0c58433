// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/stops/stop_ledger.hpp"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <stdexcept>
#include <unordered_map>
#include <utility>

#include "common/queue_share.hpp"
#include "common/utf8.hpp"
#include "entity_manager/ports/core_settings.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

constexpr std::size_t kOpenStops = 32;  // as many as StopGenerations knows
constexpr std::size_t kOpenDrills = 64;
constexpr Duration kComesToRest = std::chrono::seconds{10};
constexpr std::uint32_t kGenerationsReserved = 1000;
/// There from the first link until the application has said good-bye.
constexpr const char* kLinkedKey = "application_linked";

/// Where the generations of this life begin: above all that an earlier one has told, however it ended.
std::uint32_t firstGeneration(Storage& storage, StopGenerations& stop_generations) {
    if (const auto text = storage.load(kGenerationKey)) {
        std::uint32_t stored = 0;
        const auto [end, error] = std::from_chars(text->data(), text->data() + text->size(), stored);
        if (error != std::errc{} || end != text->data() + text->size())
            throw std::runtime_error(
                "The stored value \"stop_generation\" is damaged: expected a number, found \"" + *text +
                "\". Remove it only when all clients of this entity have been restarted.");
        stop_generations.continueFrom(stored);
    }
    return stop_generations.generation();
}

/// A next life must not begin at or below a generation that this one tells.
bool mustReserve() {
    return !AXON_PLANTED(GenerationsNotReserved);
}

/// Every stop of the Entity Manager's own outdates what was sent before.
bool mustRaise([[maybe_unused]] StopCause cause) {
    return !(AXON_PLANTED(ReleaseKeepsGeneration) && cause == StopCause::Released);
}

}  // namespace

StopLedger::StopLedger(Turn& turn, Storage& storage, StopGenerations& stop_generations, BackEndPort& back_end)
    : turn_(turn),
      storage_(storage),
      stop_generations_(stop_generations),
      back_end_(back_end),
      generation_(firstGeneration(storage, stop_generations)),
      required_(generation_) {
    link_kept_ = storage.load(kLinkedKey).has_value();
    if (link_kept_)
        lost_ = {proto::StopReceipt::GONE,
                 "it was linked with an Entity Manager that ended, and has not linked since", turn.now()};
    reserved_ = generation_ + kGenerationsReserved;
    if (mustReserve()) storage.save(kGenerationKey, std::to_string(reserved_));
}

bool StopLedger::isOutdated(std::uint32_t seen) const {
    if (AXON_PLANTED(GenerationUnchecked)) return false;
    if (AXON_PLANTED(GenerationOffByOne)) return seen + 1 < required_;
    return seen < required_;
}

Refusal StopLedger::whyNot(std::int32_t known) const {
    const auto seen = static_cast<std::uint32_t>(known);
    // A stop that the signal thread has passed on already and that is still on its way to this strand counts.
    if (!allHandled())
        return {RefusalCode::OldGeneration,
                "A stop is being carried out (stop generation " +
                    std::to_string(stop_generations_.generation()) +
                    "). Look at the entity, then send it again.",
                {}};
    if (isOutdated(seen))
        return {RefusalCode::OldGeneration,
                "It was sent before the newest stop was known (stop generation " + std::to_string(seen) +
                    ", now " + std::to_string(required_) + "). Look at the entity, then send it again.",
                {}};
    if (seen > generation_)
        return {RefusalCode::Malformed,
                "Stop generation " + std::to_string(seen) + " does not exist yet; the newest is " +
                    std::to_string(generation_) + ".",
                {}};
    return {};
}

void StopLedger::rearmed() {
    rearmed_ = generation_;
    stop_generations_.rearmed(generation_);
}

/// Notes that a stop has had its effect here. `own`: raised by this strand, not by the signal thread.
void StopLedger::handled(std::uint32_t generation, bool own, bool voids) {
    if (turn_.linked()) commanded_ = std::max(commanded_, generation);
    if (own && generation != generation_ + 1) {
        early_.push_back(generation);  // the one between is on its way here
    } else {
        generation_ = std::max(generation_, generation);
        while (std::erase(early_, generation_ + 1) > 0) ++generation_;
        std::erase_if(early_, [this](std::uint32_t early) { return early <= generation_; });
        // Early: the disk has it before that many more stops have come.
        if (generation_ + kGenerationsReserved / 2 >= reserved_) {
            reserved_ = generation_ + kGenerationsReserved;
            if (mustReserve()) storage_.keep(kGenerationKey, std::to_string(reserved_));
        }
    }
    if (voids) required_ = std::max(required_, generation);
}

void StopLedger::linkUp() {
    came_back_ = lost_.has_value();
    lost_.reset();
    if (!std::exchange(link_kept_, true)) storage_.keep(kLinkedKey, "1");
    // It has stopped by itself when its last link ended: before all stops so far, those on their way here
    // included.
    link_generation_ = commanded_ = confirmed_ = stop_generations_.generation();
    link_drill_ = stop_generations_.drills();
}

void StopLedger::linkDown(const std::string& reason, LinkEnd end) {
    if (turn_.linked()) {
        came_back_ = false;
        if (end == LinkEnd::GoodBye) {
            lost_.reset();
            if (std::exchange(link_kept_, false)) storage_.forget(kLinkedKey);
        } else {
            lost_ = {end == LinkEnd::Silent ? proto::StopReceipt::SILENT : proto::StopReceipt::GONE, reason,
                     turn_.now()};
        }
    }
    for (auto& open : stops_) {
        if (open.over()) continue;
        auto& receipt = open.receipt;
        if (receipt.stage() == proto::StopReceipt::CALLBACK_RETURNED) {
            if (!receipt.standstill_follows()) continue;
            receipt.set_standstill_follows(false);
        } else if (!lost_) {
            describeAbsence(receipt);
        }
        tellStage(open);
    }
    for (auto& open : drills_) {
        describeAbsence(open.receipt);
        tellStage(open);
    }
    drills_.clear();
    early_answers_.clear();
    early_drills_.clear();
}

bool StopLedger::owed() const {
    return std::any_of(stops_.begin(), stops_.end(), [](const Open& open) {
        return open.receipt.stage() < proto::StopReceipt::CALLBACK_RETURNED;
    });
}

std::uint32_t StopLedger::order(StopCause cause, bool voids) {
    const auto generation = mustRaise(cause) ? stop_generations_.raise() : stop_generations_.generation();
    back_end_.stop(generation, cause);
    handled(generation, true, voids);
    return generation;
}

bool StopLedger::acknowledge(const Header& head, StopCause cause, std::uint32_t generation, bool busy,
                             std::optional<Ended> ended) {
    Open open;
    auto& receipt = open.receipt;
    receipt = receiptOf(head, cause, generation);
    if (!head.sender.id.empty()) open.to.push_back(head.sender);
    const auto* holder = turn_.holder();
    if (holder != nullptr && holder->id != head.sender.id) open.to.push_back(*holder);
    open.at = turn_.now();
    open.moving = moving(busy);
    if (ended) {
        receipt.set_tasks_ended(ended->tasks);
        receipt.set_tasks_removed(ended->removed);
    }

    tellReceipt(open, receipt);
    const bool before_link = generation <= link_generation_;  // and so never sent to it
    if (!turn_.linked() || (before_link && !came_back_)) {
        if (!lost_) describeAbsence(receipt);
        tellStage(open);
    }
    if (stops_.size() == kOpenStops) stops_.pop_front();
    stops_.push_back(std::move(open));
    return turn_.linked() && before_link && came_back_;
}

void StopLedger::repeated(const Header& head, StopCause cause, std::uint32_t generation, bool runs) {
    // A late copy, whose receipt nobody waits for; or a number used twice, whose stop has not been carried
    // out.
    if (generation <= rearmed_ && runs) return;
    Open asked;
    asked.receipt = receiptOf(head, cause, generation);
    for (const auto& open : stops_)
        if (open.receipt.stop_id() == asked.receipt.stop_id()) asked = open;
    asked.to = {head.sender};
    tellStage(asked);
}

void StopLedger::answered(const proto::StopDone& done) {
    if (done.drill() != 0)
        drillDone(done.drill());
    else
        stopDone(done);
}

void StopLedger::settle() {
    for (auto at = early_answers_.begin(); at != early_answers_.end();) {
        if (at->stop_generation() > generation_) {
            ++at;
            continue;
        }
        const auto done = *at;
        at = early_answers_.erase(at);
        stopDone(done);
    }
}

void StopLedger::stopDone(const proto::StopDone& done) {
    if (done.stop_generation() > stop_generations_.generation()) {
        ++turn_.count().unexpected;
        return;
    }
    if (done.stop_generation() > generation_) {
        // The signal thread wrote the stop before it told this strand, and the answer was faster than the
        // news.
        if (early_answers_.size() < kOpenStops) early_answers_.push_back(done);
        return;
    }
    if (!done.fault().empty()) {
        faulted(done);
        return;
    }
    for (auto& open : stops_) {
        if (!mayAdvance(open, done)) continue;
        open.receipt.set_stage(done.stage());
        open.receipt.clear_fault();
        open.receipt.set_standstill_follows(done.stage() == proto::StopReceipt::CALLBACK_RETURNED &&
                                            done.standstill_follows() && open.moving);
        tellStage(open);
    }
    if (done.stage() == proto::StopReceipt::CALLBACK_RETURNED)
        confirmed_ = std::max(confirmed_, done.stop_generation());
}

bool StopLedger::mayAdvance(const Open& open, const proto::StopDone& done) {
    // The Entity Interfacer answers the newest of several stops for all of them.
    const bool concerns = !open.over() && open.receipt.stop_generation() <= done.stop_generation() &&
                          open.receipt.stage() < done.stage();
    if (!concerns || done.stage() != proto::StopReceipt::STANDSTILL) return concerns;
    if (open.receipt.stage() < proto::StopReceipt::CALLBACK_RETURNED) {
        ++turn_.count().unexpected;  // it may stand, but its callback has still to say so
        return false;
    }
    return turn_.now() < open.at + kComesToRest;  // it tells nobody anything of a stop longer ago
}

/// The stop callback has thrown, and is called again.
void StopLedger::faulted(const proto::StopDone& done) {
    const auto fault = std::string(cutUtf8(done.fault(), kReasonMax));
    turn_.warn("the stop callback of the robot application threw, and is called again: " + fault);
    for (auto& open : stops_) {
        if (open.receipt.stop_generation() > done.stop_generation() ||
            open.receipt.stage() >= proto::StopReceipt::CALLBACK_RETURNED)
            continue;
        open.receipt.set_fault(fault);
        tellStage(open);
    }
}

void StopLedger::drill(const Header& head, std::uint32_t number) {
    drill_ = std::max(drill_, number);
    Open open;
    open.drill = number;
    open.receipt = receiptOf(head, StopCause::Drill, generation_);
    open.of_server = head.msg_type == kMsgDrill;
    if (!head.sender.id.empty()) open.to.push_back(head.sender);
    const auto* holder = turn_.holder();
    if (holder != nullptr && holder->id != head.sender.id && !open.of_server) open.to.push_back(*holder);

    tellReceipt(open, open.receipt);
    if (!turn_.linked() || number <= link_drill_) {
        describeAbsence(open.receipt);
        tellStage(open);
        return;
    }
    if (drills_.size() == kOpenDrills) forgetADrill();
    drills_.push_back(std::move(open));
    if (std::erase(early_drills_, number) > 0) drillDone(number);
}

/// The oldest of whoever has most of them, so that nobody's drills are forgotten for a flood of somebody
/// else's.
void StopLedger::forgetADrill() {
    const auto senderOf = [](const Open& open) {
        return open.to.empty() ? kServersOwn : senderKey(open.to.front().id);
    };
    std::unordered_map<SenderKey, std::size_t> of;
    for (const auto& open : drills_) ++of[senderOf(open)];
    const auto most = std::max_element(
        drills_.begin(), drills_.end(),
        [&](const Open& one, const Open& other) { return of[senderOf(one)] < of[senderOf(other)]; });
    drills_.erase(most);
}

void StopLedger::drillDone(std::uint32_t number) {
    if (number > stop_generations_.drills()) {
        ++turn_.count().unexpected;
        return;
    }
    if (number > drill_) {  // the answer was faster than the news
        if (early_drills_.size() < kOpenDrills) early_drills_.push_back(number);
        return;
    }
    const auto found =
        std::find_if(drills_.begin(), drills_.end(), [&](const Open& open) { return open.drill == number; });
    if (found == drills_.end()) return;
    auto open = std::move(*found);
    drills_.erase(found);
    open.receipt.set_stage(proto::StopReceipt::CALLBACK_RETURNED);
    tellStage(open);
}

/// Whether the robot moves, or has been told to stop and has not come to rest yet.
bool StopLedger::moving(bool busy) const {
    const auto now = turn_.now();
    return busy || std::any_of(stops_.begin(), stops_.end(), [now](const Open& open) {
               return open.moving && !open.over() && now < open.at + kComesToRest;
           });
}

proto::StopReceipt StopLedger::receiptOf(const Header& head, StopCause cause,
                                         std::uint32_t generation) const {
    proto::StopReceipt receipt;
    receipt.set_stop_id(head.sender.id + ':' + std::to_string(head.sequence));
    receipt.set_cause(static_cast<proto::StopCause>(cause));
    receipt.set_stop_generation(generation);
    receipt.set_by(named(head.sender));
    receipt.set_stage(proto::StopReceipt::MANAGER);
    return receipt;
}

void StopLedger::tellStage(const Open& open) {
    auto receipt = open.receipt;
    // The order stays open: an application that comes back is given it.
    if (receipt.stage() == proto::StopReceipt::MANAGER && lost_) describeAbsence(receipt);
    tellReceipt(open, std::move(receipt));
}

void StopLedger::tellReceipt(const Open& open, proto::StopReceipt receipt) {
    const bool answered = open.of_server && receipt.stage() == proto::StopReceipt::CALLBACK_RETURNED;
    proto::ToClient message;
    message.mutable_receipt()->Swap(&receipt);
    message.mutable_receipt()->set_at_us(toMicroseconds(turn_.now()));
    message.mutable_receipt()->set_state(
        static_cast<proto::EntityState>(static_cast<int>(turn_.state()) + 1));
    for (const auto& to : open.to) turn_.tell(to, answered ? kMsgDrill : kMsgReceipt, message, Lane::Signal);
}

void StopLedger::describeAbsence(proto::StopReceipt& receipt) const {
    receipt.set_stage(proto::StopReceipt::NO_APPLICATION);
    if (!lost_) {
        receipt.set_absence(proto::StopReceipt::NONE);
        return;
    }
    receipt.set_absence(lost_->how);
    receipt.set_absence_reason(std::string(cutUtf8(lost_->reason, kReasonMax)));
    receipt.set_absent_for_ms(static_cast<std::uint64_t>(
        std::chrono::duration_cast<std::chrono::milliseconds>(turn_.now() - lost_->since).count()));
}

}  // namespace axon::entity_manager
