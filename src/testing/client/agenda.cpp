// SPDX-License-Identifier: GPL-2.0-or-later
#include "testing/client/agenda.hpp"

#include <algorithm>

namespace axon::testing {

Agenda::Agenda(Passing passing, Event settle) : passing_(passing), settle_(std::move(settle)) {
    if (passing_ == Passing::AtOnce) thread_ = std::thread([this] { run(); });
}

Agenda::~Agenda() {
    end();
}

void Agenda::end() {
    {
        const std::lock_guard lock(mutex_);
        ending_ = true;
        events_.clear();
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
}

Agenda::Hold::Hold(Agenda& agenda) : agenda_(agenda) {
    const std::lock_guard lock(agenda_.mutex_);
    ++agenda_.holds_;
}

Agenda::Hold::~Hold() {
    const std::lock_guard lock(agenda_.mutex_);
    if (--agenda_.holds_ == 0) agenda_.changed_.notify_all();
}

Duration Agenda::now() const {
    const std::lock_guard lock(mutex_);
    return now_;
}

std::uint64_t Agenda::in(Duration time, Event event) {
    const std::lock_guard lock(mutex_);
    if (ending_) return ++numbers_;
    events_.emplace(Key{now_ + std::max(time, Duration::zero()), ++numbers_}, std::move(event));
    changed_.notify_all();
    return numbers_;
}

void Agenda::cancel(std::uint64_t number) {
    const std::lock_guard lock(mutex_);
    std::erase_if(events_, [&](const auto& one) { return one.first.second == number; });
}

Agenda::Event Agenda::takeUntil(Duration end) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return holds_ == 0; });
    if (events_.empty() || events_.begin()->first.first > end) return {};
    now_ = std::max(now_, events_.begin()->first.first);
    return std::move(events_.extract(events_.begin()).mapped());
}

void Agenda::advance(Duration time) {
    const auto end = now() + std::max(time, Duration::zero());
    settle_();
    while (const auto event = takeUntil(end)) {
        event();
        settle_();
    }
    const std::lock_guard lock(mutex_);
    now_ = std::max(now_, end);
}

void Agenda::run() {
    while (true) {
        {
            std::unique_lock lock(mutex_);
            changed_.wait(lock, [this] { return ending_ || !events_.empty(); });
            if (ending_) return;
        }
        if (const auto event = takeUntil(Duration::max())) {
            event();
            settle_();
        }
    }
}

}  // namespace axon::testing
