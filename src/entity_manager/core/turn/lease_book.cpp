// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/turn/lease_book.hpp"

#include <charconv>
#include <limits>
#include <stdexcept>
#include <utility>

#include "common/planted_bug.hpp"

namespace axon::entity_manager {

namespace {

constexpr std::string_view kKey = "lease";  // "<epoch> <number>"

std::int32_t loadEpoch(Storage& storage) {
    const auto text = storage.load(kKey);
    if (!text) return 0;
    LeaseNumber stored{-1, -1};
    const auto* const last = text->data() + text->size();
    const auto first = std::from_chars(text->data(), last, stored.epoch);
    bool whole = first.ec == std::errc{} && first.ptr != last && *first.ptr == ' ';
    if (whole) {
        const auto second = std::from_chars(first.ptr + 1, last, stored.number);
        whole = second.ec == std::errc{} && second.ptr == last;
    }
    if (!whole || stored.epoch < 0 || stored.epoch == std::numeric_limits<std::int32_t>::max())
        throw std::runtime_error("The stored value \"lease\" is damaged: expected two numbers, found \"" +
                                 *text +
                                 "\". Remove it only if no client still holds a lease of this entity.");
    return stored.epoch;
}

/// Looks at every byte whatever it finds.
bool equalInConstantTime(std::string_view a, std::string_view b) {
    if (a.size() != b.size()) return false;
    volatile unsigned char different = 0;
    for (std::size_t i = 0; i < a.size(); ++i)
        different = static_cast<unsigned char>(
            different | (static_cast<unsigned char>(a[i]) ^ static_cast<unsigned char>(b[i])));
    return different == 0;
}

}  // namespace

std::string named(const Sender& sender) {
    return sender.name.empty() ? sender.id : sender.name;
}

LeaseBook::LeaseBook(Storage& storage, RandomSource& random) : random_(random) {
    last_ = {loadEpoch(storage) + 1, 0};
    if (AXON_PLANTED(EpochNotSaved)) return;
    storage.save(kKey, std::to_string(last_.epoch) + ' ' + std::to_string(last_.number));
}

bool LeaseBook::isStored(Storage& storage) {
    return storage.load(kKey).has_value();
}

std::string LeaseBook::whoHolds() const {
    if (!held_) return " Nobody holds it now; check it out first.";
    return ' ' + nameOfHolder() + " holds it now.";
}

bool LeaseBook::reservedFor(const Sender& sender, const std::string& request_id) const {
    return reservation_ && reservation_->by.id == sender.id && reservation_->request_id == request_id;
}

Refusal LeaseBook::mayTake(const Sender& sender, const std::string& request_id) const {
    if (held_) {
        if (held_->holder.id == sender.id && !held_->grace_until)
            return {RefusalCode::AlreadyHeld, "You hold it already.", nameOfHolder()};
        if (held_->grace_until)
            return {
                RefusalCode::AlreadyHeld,
                nameOfHolder() +
                    " holds it and was lost; it may come back for a few seconds. Try again then, or wait in "
                    "its list.",
                nameOfHolder()};
        return {RefusalCode::AlreadyHeld,
                nameOfHolder() + " holds it. Ask for its release, or choose another entity.", nameOfHolder()};
    }
    if (reservation_ && !reservedFor(sender, request_id))
        return {RefusalCode::Reserved,
                "It is reserved for a check-out of " + named(reservation_->by) + ". Try again shortly.",
                named(reservation_->by)};
    return {};
}

Refusal LeaseBook::mayCommit(const Sender& sender, const std::string& request_id) const {
    if (reservedFor(sender, request_id)) return {};
    if (auto refusal = mayTake(sender, request_id); !refusal.ok()) return refusal;
    return {RefusalCode::Expired, "There is no reservation of this check-out (any more). Reserve again.", {}};
}

Refusal LeaseBook::mayResume(LeaseNumber number, std::string_view key) const {
    if (auto refusal = checkNumber(number); !refusal.ok()) return refusal;
    if (!held_)
        return {
            end_code_ == RefusalCode::Ok ? RefusalCode::NotHolder : end_code_,
            "The lease has ended: " + end_why_ + (end_why_.ends_with('.') ? "" : ".") + " Check it out anew.",
            {}};
    if (!equalInConstantTime(held_->key.bytes(), key))
        return {RefusalCode::NotHolder, "This is not the key of the lease." + whoHolds(), nameOfHolder()};
    return {};
}

void LeaseBook::reserve(const Sender& sender, const std::string& request_id, TimePoint until) {
    reservation_ =
        Reservation{sender, request_id, AXON_PLANTED(ReservationNeverExpires) ? TimePoint::max() : until};
}

const LeaseBook::Held& LeaseBook::grant(const Claim& claim) {
    reservation_.reset();
    if (!AXON_PLANTED(LeaseNumberNotRaised)) ++last_.number;
    // Not saved: the epoch fences across a restart, and a check-out need not wait for the disk.
    end_code_ = RefusalCode::Ok;
    end_why_.clear();
    held_ = Held{last_,      Id128::random(random_), claim.client, claim.request_id,
                 claim.root, claim.hand_over,        {},           named(claim.client)};
    last_holder_ = claim.client.id;
    return *held_;
}

void LeaseBook::orphan(TimePoint until) {
    if (held_ && !held_->grace_until) held_->grace_until = until;
}

void LeaseBook::resume(const Sender& sender, const std::string& request_id) {
    if (!held_) return;
    held_->grace_until.reset();
    held_->holder = sender;
    held_->request_id = request_id;
    last_holder_ = sender.id;
}

void LeaseBook::setHandOver(HandOverPolicy policy) {
    if (held_) held_->hand_over = policy;
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

Refusal LeaseBook::checkNumber(LeaseNumber under) const {
    if (under == LeaseNumber{})
        return {RefusalCode::NotHolder, "You do not hold this entity." + whoHolds(), nameOfHolder()};
    if (under.epoch != last_.epoch && !AXON_PLANTED(EpochUnchecked))
        return {RefusalCode::WrongEpoch,
                "The lease is of an earlier life of the Entity Manager." + whoHolds(), nameOfHolder()};
    if (under.number > last_.number || under.number <= 0)
        return {RefusalCode::NotHolder, "The lease has never been given." + whoHolds(), nameOfHolder()};
    if (under.number < last_.number && !AXON_PLANTED(OlderLeaseObeyed))
        return {RefusalCode::OlderLease, "The lease has ended and a newer one exists." + whoHolds(),
                nameOfHolder()};
    return {};
}

Refusal LeaseBook::check(const Sender& sender, LeaseNumber under) const {
    if (auto refusal = checkNumber(under); !refusal.ok()) return refusal;
    if (held_ ? held_->holder.id != sender.id : sender.id != last_holder_)
        return {RefusalCode::NotHolder, "You do not hold this entity." + whoHolds(), nameOfHolder()};
    if (!held_)
        return {end_code_ == RefusalCode::Ok ? RefusalCode::NotHolder : end_code_,
                "The lease has ended: " + end_why_,
                {}};
    if (held_->grace_until)
        return {
            RefusalCode::ClientLost,
            "Your connection was lost and the robot has been stopped. Resume the lease with its key first.",
            nameOfHolder()};
    return {};
}

}  // namespace axon::entity_manager
