// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/strand/inbox.hpp"

#include <algorithm>
#include <utility>
#include <vector>

namespace axon::entity_manager {

/// Which of the waiting signals makes room for one that must not be lost; kSignals = none. The newest stop
/// must reach the strand, or every command would be one of an old generation.
std::size_t Inbox::victimFor(Signal kind) {
    std::size_t newest_stop = kSignals;
    for (std::size_t i = 0; i < kSignals && kind != Signal::Stop; ++i)
        if (signalAt(i).kind == Signal::Stop) newest_stop = i;
    for (const auto first : {Signal::Peer, Signal::Passing})
        for (std::size_t i = 0; i < kSignals; ++i)
            if (signalAt(i).kind == first) return i;
    for (std::size_t i = kSignals; i-- > 0;)
        if (signalAt(i).kind == Signal::Stop && i != newest_stop) return i;
    return kSignals;
}

Inbox::Verdict Inbox::pushSignal(Signal kind, Event event, SenderKey from) {
    Event victim;  // destroyed after the lock
    {
        const std::lock_guard lock(signal_mutex_);
        if (kind == Signal::Peer && (peers_ == kPeerSignals || signal_count_ == kSignals))
            return Verdict::Dropped;
        if (kind == Signal::Passing && noRoomForPassing(from)) return Verdict::Dropped;
        if (signal_count_ == kSignals) {
            auto at = victimFor(kind);
            if (at == kSignals) return Verdict::Overflow;
            victim = std::move(signalAt(at).event);
            peers_ -= signalAt(at).kind == Signal::Peer ? 1 : 0;
            for (; at + 1 < kSignals; ++at) signalAt(at) = std::move(signalAt(at + 1));
            --signal_count_;
        }
        signalAt(signal_count_) = {kind, std::move(event), from};
        ++signal_count_;
        signals_left_ = signal_count_;
        peers_ += kind == Signal::Peer ? 1 : 0;
    }
    return wake();
}

bool Inbox::wouldDrop(SenderKey from) const {
    const std::lock_guard lock(signal_mutex_);
    return noRoomForPassing(from);
}

/// Under signal_mutex_.
bool Inbox::noRoomForPassing(SenderKey from) const {
    if (signal_count_ == kSignals) return true;
    if (from == kServersOwn) return false;
    std::size_t its = 0, all = 0;
    for (std::size_t i = 0; i < signal_count_; ++i) {
        const auto& one = signalAt(i);
        if (one.kind != Signal::Passing) continue;
        ++all;
        its += one.from == from ? 1 : 0;
    }
    return its >= kPassingOfOne || all >= kPassing;
}

Inbox::Verdict Inbox::pushControl(Event&& event, std::size_t bytes, Share share) {
    {
        const std::lock_guard lock(mutex_);
        if (!fits(bytes, share)) return Verdict::Overflow;
        waiting_.push_back({std::move(event), bytes});
        events_left_ = waiting_.size();
        ++control_events_;
        control_bytes_ += bytes;
    }
    return wake();
}

bool Inbox::hasRoom(std::size_t bytes) const {
    const std::lock_guard lock(mutex_);
    return control_events_ <= bounds_.control_events / 4 && control_bytes_ <= bounds_.control_bytes / 4 &&
           fits(bytes, Share::Half);
}

Inbox::Verdict Inbox::pushData(Event event, std::size_t bytes) {
    std::vector<Event> dropped;  // destroyed after the lock: an event may own megabytes
    {
        const std::lock_guard lock(mutex_);
        while (data_events_ > 0 &&
               (data_events_ == bounds_.data_events || data_bytes_ + bytes > bounds_.data_bytes)) {
            const auto oldest =
                std::find_if(waiting_.begin(), waiting_.end(), [](const Waiting& w) { return w.data; });
            data_bytes_ -= oldest->bytes;
            --data_events_;
            ++dropped_;
            dropped.push_back(std::move(oldest->event));
            waiting_.erase(oldest);
        }
        waiting_.push_back({std::move(event), bytes, true});
        events_left_ = waiting_.size();
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
    if (signals_left_ > 0) {
        const std::lock_guard lock(signal_mutex_);
        if (signal_count_ > 0) {
            Event event = std::exchange(signalAt(0).event, nullptr);
            peers_ -= signalAt(0).kind == Signal::Peer ? 1 : 0;
            signal_first_ = (signal_first_ + 1) % signals_.size();
            signals_left_ = --signal_count_;
            return event;
        }
    }
    if (events_left_ == 0) return nullptr;
    const std::lock_guard lock(mutex_);
    if (waiting_.empty()) return nullptr;
    Waiting first = std::move(waiting_.front());
    waiting_.pop_front();
    events_left_ = waiting_.size();
    if (first.data) {
        --data_events_;
        data_bytes_ -= first.bytes;
    } else {
        --control_events_;
        control_bytes_ -= first.bytes;
    }
    return std::move(first.event);
}

std::uint64_t Inbox::droppedData() const {
    const std::lock_guard lock(mutex_);
    return dropped_;
}

}  // namespace axon::entity_manager
