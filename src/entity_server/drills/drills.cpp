// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/drills/drills.hpp"

#include <algorithm>
#include <charconv>

namespace axon::entity_server {

Drills::Drills(Settings settings, const Clock& clock, RandomSource& random)
    : settings_(settings),
      clock_(clock),
      prefix_(on() ? "drill-" + Id128::random(random).toString() + "-" : std::string()) {}

void Drills::begin(Order& order) const {
    const auto now = clock_.now();
    order.head.sent_at_us = toMicroseconds(now);
    order.to->sent_ = now.time_since_epoch().count();
}

// Of its receipts only the last has a routing key of its own: the Entity Interfacer has acknowledged.
bool Drills::answer(Subject& subject, const Header& head) const {
    if (head.msg_type != kMsgDrill || !isDrill(head)) return false;
    std::uint64_t number = 0;
    const auto& id = head.sender.id;
    std::from_chars(id.data() + prefix_.size(), id.data() + id.size(), number);
    if (number == 0 || number != subject.drill_ || subject.took_ != 0) return false;  // too late, or twice
    const auto took = clock_.now().time_since_epoch().count() - subject.sent_;
    subject.took_ = std::max<Duration::rep>(took, 1);
    return true;
}

void Drills::join(const SubjectRef& subject) {
    if (on()) all_.emplace(subject->entity(), subject);
}

void Drills::leave(const SubjectRef& subject) {
    const auto found = all_.find(subject->entity());
    if (found == all_.end() || found->second != subject) return;
    all_.erase(found);
    subject->drill_ = 0;
    std::erase_if(unanswered_, [&](const Given& given) { return given.to == subject; });
}

std::vector<Drills::Result> Drills::settle() {
    std::vector<Result> done;
    const auto now = clock_.now();
    std::erase_if(unanswered_, [&](const Given& given) {
        auto& subject = *given.to;
        const Duration took{subject.took_.load()};
        const bool answered = took != Duration{};
        if (!answered && now < given.answer_by) return false;
        subject.drill_ = 0;
        // 0 says unknown, so what took less than a microsecond took one.
        const auto us = answered ? std::max<std::int64_t>(
                                       std::chrono::duration_cast<std::chrono::microseconds>(took).count(), 1)
                                 : 0;
        const bool changed = std::exchange(subject.stop_latency_us_, static_cast<std::int32_t>(us)) != us;
        done.push_back({given.to, answered, changed});
        return true;
    });
    return done;
}

/// Null where a drill would tell nothing, or disturb.
Drills::SubjectRef Drills::takeTurn() {
    if (round_.empty()) {
        for (const auto& [entity, subject] : all_) round_.push_back(subject);
        if (round_.empty()) return nullptr;
    }
    auto subject = round_.front().lock();
    round_.pop_front();
    if (!subject || !subject->ready_ || subject->drill_ != 0) return nullptr;
    const auto here = all_.find(subject->entity());
    if (here == all_.end() || here->second != subject) return nullptr;
    return subject;
}

std::vector<Drills::Order> Drills::next() {
    std::vector<Order> orders;
    if (!on()) return orders;
    const auto now = clock_.now();
    const auto step = settings_.period / static_cast<int>(std::max<std::size_t>(all_.size(), 1));
    // After a pause one turn is enough; a burst would measure itself.
    if (next_turn_ + settings_.period <= now) next_turn_ = now + step;
    for (; next_turn_ <= now; next_turn_ += std::max(step, Duration{1})) {
        auto subject = takeTurn();
        if (!subject) continue;
        subject->took_ = 0;
        subject->drill_ = ++given_;
        unanswered_.push_back({now + settings_.answer, subject});
        Header head;
        head.sender = {prefix_ + std::to_string(given_), "the entity server", Role::Operator};
        head.entity = subject->entity();
        head.msg_type = kMsgDrill;
        head.sequence = static_cast<std::int64_t>(given_);
        orders.push_back({std::move(subject), std::move(head)});
    }
    return orders;
}

TimePoint Drills::nextDeadline() const {
    auto next = on() ? next_turn_ : TimePoint::max();
    for (const auto& given : unanswered_) next = std::min(next, given.answer_by);
    return next;
}

}  // namespace axon::entity_server
