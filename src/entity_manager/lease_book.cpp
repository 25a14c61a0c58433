// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/lease_book.hpp"

#include <charconv>
#include <stdexcept>
#include <utility>

namespace axon::entity_manager {

namespace {

constexpr std::string_view kKey = "lease";  // "<epoch> <number>"

std::int32_t loadEpoch(Storage& storage) {
    const auto text = storage.load(kKey);
    if (!text) return 0;
    std::int32_t epoch = 0;
    const auto [end, error] = std::from_chars(text->data(), text->data() + text->size(), epoch);
    if (error != std::errc{} || epoch < 0)
        throw std::runtime_error("The stored value \"lease\" is damaged: expected two numbers, found \"" +
                                 *text +
                                 "\". Remove it only if no client holds a lease of this entity any more.");
    return epoch;
}

std::string named(const Sender& sender) {
    return sender.name.empty() ? sender.id : sender.name;
}

}  // namespace

LeaseBook::LeaseBook(Storage& storage, RandomSource& random) : random_(random) {
    last_ = {loadEpoch(storage) + 1, 0};
    storage.save(kKey, std::to_string(last_.epoch) + ' ' + std::to_string(last_.number));
}

Refusal LeaseBook::mayTake(const Sender& sender, const std::string& request_id) const {
    if (sender.role == Role::Observer)
        return {RefusalCode::PermissionDenied,
                "Observers may watch and stop, but not check out. Log in as an operator.",
                {}};
    if (held_) {
        if (held_->holder.id == sender.id)
            return {RefusalCode::AlreadyHeld, "You hold it already.", named(held_->holder)};
        return {RefusalCode::AlreadyHeld,
                named(held_->holder) + " holds it. Ask for its release, or choose another entity.",
                named(held_->holder)};
    }
    if (reservation_ && (reservation_->by.id != sender.id || reservation_->request_id != request_id))
        return {RefusalCode::Reserved,
                "It is reserved for a check-out of " + named(reservation_->by) + ". Try again shortly.",
                named(reservation_->by)};
    return {};
}

Refusal LeaseBook::mayCommit(const Sender& sender, const std::string& request_id) const {
    if (reservation_ && reservation_->by.id == sender.id && reservation_->request_id == request_id) return {};
    if (auto refusal = mayTake(sender, request_id); !refusal.ok()) return refusal;
    return {RefusalCode::Expired, "There is no reservation of this check-out (any more). Reserve again.", {}};
}

void LeaseBook::reserve(const Sender& sender, const std::string& request_id, TimePoint until) {
    reservation_ = Reservation{sender, request_id, until};
}

const LeaseBook::Held& LeaseBook::grant(const Sender& sender, const std::string& request_id) {
    reservation_.reset();
    ++last_.number;
    // Not saved: the epoch fences across a restart, and a check-out need not wait for the disk.
    end_code_ = RefusalCode::Ok;
    end_why_.clear();
    held_ = Held{last_, Id128::random(random_), sender, request_id};
    last_holder_ = sender.id;
    return *held_;
}

bool LeaseBook::expire(TimePoint now) {
    if (!reservation_ || now < reservation_->until) return false;
    reservation_.reset();
    return true;
}

void LeaseBook::end(RefusalCode code, std::string why) {
    held_.reset();
    end_code_ = code;
    end_why_ = std::move(why);
}

Refusal LeaseBook::check(const Sender& sender, LeaseNumber under) const {
    const std::string holder = held_ ? named(held_->holder) : std::string();
    const std::string now =
        held_ ? " " + holder + " holds it now." : " Nobody holds it now; check it out first.";
    if (under == LeaseNumber{} || (held_ && held_->holder.id != sender.id && under == last_))
        return {RefusalCode::NotHolder, "You do not hold this entity." + now, holder};
    if (under.epoch != last_.epoch)
        return {RefusalCode::WrongEpoch, "The lease is of an earlier life of the Entity Manager." + now,
                holder};
    if (under.number > last_.number)
        return {RefusalCode::NotHolder, "The lease has never been given." + now, holder};
    if (under.number < last_.number)
        return {RefusalCode::OlderLease, "The lease has ended and a newer one exists." + now, holder};
    if (held_) return {};
    if (sender.id != last_holder_) return {RefusalCode::NotHolder, "You do not hold this entity." + now, {}};
    return {end_code_ == RefusalCode::Ok ? RefusalCode::NotHolder : end_code_,
            "The lease has ended: " + end_why_,
            {}};
}

}  // namespace axon::entity_manager
