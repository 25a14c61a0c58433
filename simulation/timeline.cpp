// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/timeline.hpp"

#include <algorithm>
#include <cstdio>

namespace axon::simulation {

namespace {
constexpr TimePoint kBegin{std::chrono::seconds{1000}};
}

Process::Process(Timeline& timeline, int number, std::string name)
    : timeline_(timeline), number_(number), name_(std::move(name)), changed_at_(timeline.now()) {}

TimePoint Process::now() const {
    const auto time = timeline_.now() - kBegin;
    if (rate_ == 1) return kBegin + offset_ + time;
    return kBegin + offset_ + Duration{static_cast<Duration::rep>(static_cast<double>(time.count()) * rate_)};
}

TimePoint Process::whenItShows(TimePoint local) const {
    const auto time = local - kBegin - offset_;
    if (rate_ == 1) return kBegin + time;
    return kBegin + Duration{static_cast<Duration::rep>(static_cast<double>(time.count()) / rate_) + 2};
}

void Process::setClock(Duration offset, double rate) {
    offset_ = offset;
    rate_ = rate;
}

void Process::start() {
    ++life_;
    alive_ = true;
    frozen_ = false;
    changed_at_ = timeline_.now();
}

void Process::die() {
    alive_ = false;
    frozen_ = false;
    ++life_;
    changed_at_ = timeline_.now();
    for (const auto slot : backlog_) timeline_.release(slot);
    backlog_.clear();
}

void Process::freeze() {
    if (!running()) return;
    frozen_ = true;
    changed_at_ = timeline_.now();
}

void Process::thaw() {
    if (!frozen_) return;
    frozen_ = false;
    changed_at_ = timeline_.now();
    for (const auto slot : std::exchange(backlog_, {})) timeline_.push(timeline_.now(), slot);
}

Timeline::~Timeline() {
    for (auto& slot : slots_)
        if (slot.destroy != nullptr) slot.destroy(slot.storage);
}

std::uint32_t Timeline::takeSlot() {
    if (free_.empty()) {
        slots_.emplace_back();
        return static_cast<std::uint32_t>(slots_.size() - 1);
    }
    const auto index = free_.back();
    free_.pop_back();
    return index;
}

void Timeline::release(std::uint32_t index) {
    Slot& slot = slots_[index];
    slot.destroy(slot.storage);
    slot.destroy = nullptr;
    free_.push_back(index);
}

void Timeline::push(TimePoint when, std::uint32_t slot) {
    heap_.push_back({when, ++order_, slot});
    std::push_heap(heap_.begin(), heap_.end());
}

bool Timeline::step(TimePoint end) {
    if (heap_.empty() || heap_.front().when > end) {
        now_ = end;
        return false;
    }
    std::pop_heap(heap_.begin(), heap_.end());
    const auto next = heap_.back();
    heap_.pop_back();
    now_ = next.when;
    Slot& slot = slots_[next.slot];
    if (slot.life != slot.who->life_) {
        release(next.slot);
        return true;
    }
    if (slot.who->frozen_) {
        slot.who->backlog_.push_back(next.slot);
        return true;
    }
    ++events_;
    mark(static_cast<std::uint64_t>(now_.time_since_epoch().count()) * 31 +
         static_cast<std::uint64_t>(slot.who->number_));
    slot.run(slot.storage);
    release(next.slot);
    return true;
}

std::string Timeline::stamp(const std::string& who) const {
    char text[64];
    std::snprintf(text, sizeof text, "%10.6f  %-8s ", std::chrono::duration<double>(now_ - kBegin).count(),
                  who.c_str());
    return text;
}

void Alarm::set(TimePoint local) {
    if (local == TimePoint::max()) return;
    const auto when = std::max(who_.whenItShows(local), timeline_.now());
    if (armed_ <= when) return;
    armed_ = when;
    timeline_.at(when, who_, [this, token = ++token_] {
        if (token != token_) return;
        armed_ = TimePoint::max();
        ring_();
    });
}

}  // namespace axon::simulation
