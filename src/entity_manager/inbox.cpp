// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/inbox.hpp"

#include <algorithm>
#include <utility>
#include <vector>

namespace axon::entity_manager {

Inbox::Verdict Inbox::pushSignal(Event event) {
    {
        const std::lock_guard lock(signal_mutex_);
        if (signal_count_ == signals_.size()) --signal_count_;
        signals_[(signal_first_ + signal_count_) % signals_.size()] = std::move(event);
        ++signal_count_;
    }
    return wake();
}

Inbox::Verdict Inbox::pushControl(Event event) {
    {
        const std::lock_guard lock(mutex_);
        if (control_events_ == bounds_.control_events) return Verdict::Overflow;
        waiting_.push_back({std::move(event)});
        ++control_events_;
    }
    return wake();
}

Inbox::Verdict Inbox::pushData(Event event, std::size_t bytes) {
    std::vector<Event> dropped;  // destroyed after the lock: an event may own megabytes
    {
        const std::lock_guard lock(mutex_);
        while (data_events_ > 0 && (data_events_ == bounds_.data_events || data_bytes_ + bytes > bounds_.data_bytes)) {
            const auto oldest = std::find_if(waiting_.begin(), waiting_.end(), [](const Waiting& w) { return w.data; });
            data_bytes_ -= oldest->data_bytes;
            --data_events_;
            ++dropped_;
            dropped.push_back(std::move(oldest->event));
            waiting_.erase(oldest);
        }
        waiting_.push_back({std::move(event), bytes, true});
        ++data_events_;
        data_bytes_ += bytes;
    }
    return wake();
}

Inbox::Event Inbox::take() {
    if (auto event = next()) return event;
    scheduled_ = false;
    // Whoever pushed before that line was told that the strand comes, so the strand must look once more.
    auto event = next();
    if (event) scheduled_ = true;
    return event;
}

Inbox::Event Inbox::next() {
    {
        const std::lock_guard lock(signal_mutex_);
        if (signal_count_ > 0) {
            Event event = std::exchange(signals_[signal_first_], nullptr);
            signal_first_ = (signal_first_ + 1) % signals_.size();
            --signal_count_;
            return event;
        }
    }
    const std::lock_guard lock(mutex_);
    if (waiting_.empty()) return nullptr;
    Waiting first = std::move(waiting_.front());
    waiting_.pop_front();
    if (first.data) {
        --data_events_;
        data_bytes_ -= first.data_bytes;
    } else {
        --control_events_;
    }
    return std::move(first.event);
}

std::uint64_t Inbox::droppedData() const {
    const std::lock_guard lock(mutex_);
    return dropped_;
}

}  // namespace axon::entity_manager
