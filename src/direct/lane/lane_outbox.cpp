// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/lane_outbox.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace axon::direct::lane {
namespace {

constexpr std::size_t kMessagesAtOnce = 64;

}  // namespace

LaneOutbox::Outcome LaneOutbox::post(Keeping keeping, const Header& head,
                                     const std::shared_ptr<const std::string>& message) {
    const auto bytes = headOf(keeping, head, message->size());
    const std::lock_guard lock(mutex_);
    if (core_.closed()) return Outcome::Over;
    if (!bytes) return Outcome::TooLarge;
    const auto traffic = keeping == Keeping::Kept ? transport::Traffic::Control : transport::Traffic::Data;
    const auto whole = bytes->size() + message->size();
    const auto verdict = core_.offer(traffic, whole, [&] {
        return std::make_unique<Parcel>(Parcel{*bytes, message, waits_ ? waits_(whole) : nullptr});
    });
    switch (verdict) {
        case Core::Verdict::Send:
            break;
        case Core::Verdict::Overflow:
            over();
            return Outcome::Overflow;
        case Core::Verdict::Closed:
            return Outcome::Over;
        default:
            return Outcome::Taken;
    }
    std::size_t taken = 0;
    if (launched_.empty()) {
        const std::array<std::string_view, 2> pieces{bytes->view(), *message};
        const auto written = wire_.write(pieces);
        if (!written) return over();
        taken = *written;
        if (taken == whole) {
            core_.sent(traffic, whole);
            return Outcome::Taken;
        }
        written_ = taken;
    }
    launched_.push_back({std::make_unique<Parcel>(Parcel{*bytes, message, nullptr}), whole, traffic});
    if (waiting_.exchange(true)) return Outcome::Taken;
    // The wire may have begun to take more before that line, and nobody would hear of it.
    return flushLocked();
}

LaneOutbox::Outcome LaneOutbox::flush() {
    const std::lock_guard lock(mutex_);
    return core_.closed() ? Outcome::Over : flushLocked();
}

/// Until the wire has said that it is full, or nothing is left.
LaneOutbox::Outcome LaneOutbox::flushLocked() {
    while (true) {
        if (core_.startPump())
            while (auto item = core_.next())
                launched_.push_back({std::move(item->parcel), item->bytes, item->traffic});
        if (launched_.empty()) {
            waiting_ = false;
            return Outcome::Taken;
        }
        std::array<std::string_view, 2 * kMessagesAtOnce> pieces;
        std::size_t count = 0;
        for (const auto& one : launched_) {
            if (count == pieces.size()) break;
            pieces[count++] = one.parcel->head.view();
            pieces[count++] = *one.parcel->message;
        }
        // Of the first one a part is written.
        const auto of_head = std::min(written_, pieces[0].size());
        pieces[0].remove_prefix(of_head);
        pieces[1].remove_prefix(written_ - of_head);
        const auto taken = wire_.write({pieces.data(), count});
        if (!taken) return over();
        if (*taken == 0) return Outcome::Taken;
        written_ += *taken;
        while (!launched_.empty() && written_ >= launched_.front().bytes) {
            written_ -= launched_.front().bytes;
            core_.sent(launched_.front().traffic, launched_.front().bytes);
            launched_.pop_front();
        }
    }
}

LaneOutbox::Outcome LaneOutbox::over() {
    core_.close();
    launched_.clear();
    written_ = 0;
    waiting_ = false;
    return Outcome::Over;
}

void LaneOutbox::close() {
    const std::lock_guard lock(mutex_);
    over();
}

transport::OutboxCounts LaneOutbox::counts() const {
    const std::lock_guard lock(mutex_);
    return core_.counts();
}

}  // namespace axon::direct::lane
