// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/direct/framed_lane.hpp"

#include <system_error>
#include <utility>

#include "direct/lane/frames.hpp"

namespace axon::client {
namespace {

using direct::lane::Channel;
using direct::lane::ClientOpening;
using direct::lane::LaneOutbox;
using direct::lane::LaneSocket;

constexpr int kReadsPerTurn = 16;  // then other lanes have a turn

}  // namespace

FramedLane::FramedLane(std::shared_ptr<LaneReaders> readers, Descriptor socket, const Speaks& speaks,
                       ClientOpening opening, transport::OutboxLimits limits, LaneOutbox::Waits waits,
                       const Clock& clock, std::weak_ptr<Owner> owner)
    : readers_(std::move(readers)),
      number_(readers_->next()),
      clock_(clock),
      owner_(std::move(owner)),
      socket_(std::move(socket)),
      channel_(speaks(socket_)),
      outbox_(limits, *channel_, std::move(waits)),
      opening_(std::move(opening)) {}

void FramedLane::start(Duration timeout) {
    timeout_ = timeout;
    if (!readers_->add(number_, shared_from_this(), clock_.now() + timeout))
        return end("no more connections can be watched in this process");
    if (over_) readers_->remove(number_);
}

void FramedLane::send(direct::Keeping keeping, const Header& head,
                      const std::shared_ptr<const std::string>& message) {
    if (over_) return;
    switch (outbox_.post(keeping, head, message)) {
        case LaneOutbox::Outcome::Taken:
            return;
        case LaneOutbox::Outcome::Overflow:
            return end("its outbox is full: it does not read its messages");
        case LaneOutbox::Outcome::TooLarge:
            return end("a message for it is larger than 4096 KiB");
        case LaneOutbox::Outcome::Over:
            return end("the connection was lost");
    }
}

void FramedLane::end(const std::string& why) {
    // Before it is over: whoever closes it on another thread may then let go of its owner.
    const auto owner = owner_.lock();
    if (over_.exchange(true)) return;
    outbox_.close();
    socket_.shut();
    readers_->remove(number_);
    if (owner) owner->laneOver(why);
}

void FramedLane::ready(LaneReaders::Ready what) {
    if (what.over) closing_ = true;
    if (what.written && outbox_.waiting() && outbox_.flush() == LaneOutbox::Outcome::Over)
        end("the connection was lost");
    // A channel that this side opens begins when the connection is there.
    if (what.written && !channel_open_) what.read = true;
    if (!what.read || arrivals_.fetch_add(1) != 0) return;  // who reads now reads that, too
    // Until the turn is over: what it tells is to be called in laneRead().
    const auto owner = owner_.lock();
    if (!owner) return end("it is no longer needed");
    unsigned seen = 1;
    for (int reads = 0; readAll(*owner, reads);) {
        const auto before = arrivals_.fetch_sub(seen);
        if (before == seen) return owner->laneRead();
        seen = before - seen;
    }
    arrivals_ = 0;
    readers_->again(number_);
    owner->laneRead();
}

/// False when there may be more, and others are to have a turn. `reads`: of this turn until now.
bool FramedLane::readAll(Owner& owner, int& reads) {
    for (; reads < kReadsPerTurn && !over_; ++reads) {
        const auto came = socket_.read(channel_->room(reader_));
        const bool begins = !channel_open_ && came.end == LaneSocket::Read::End::No;
        if ((came.bytes > 0 || begins) && !heard(owner, came.bytes)) return true;
        if (came.end == LaneSocket::Read::End::Closed) end("it closed the connection");
        if (came.end == LaneSocket::Read::End::Lost)
            end("the connection was lost: " + std::generic_category().message(came.error));
        // A part of the room is all there was, and the next arrival is told; but not an end that was told
        // together with this one.
        if (!came.more && (came.bytes == 0 || !closing_)) return true;
    }
    return over_;
}

/// So many bytes were read. False when it is over.
bool FramedLane::heard(Owner& owner, std::size_t count) {
    const auto state = channel_->filled(reader_, count);
    if (state == Channel::State::Open) channel_open_ = true;
    if (!deliver(owner)) return false;
    if (state == Channel::State::Over) end(channel_->why());
    return !over_;
}

/// False when it is over.
bool FramedLane::deliver(Owner& owner) {
    while (!over_) {
        const auto frame = reader_.nextView();
        if (!frame) break;
        if (opening_.state() != ClientOpening::State::Open) {
            if (!onOpening(*frame, owner)) return false;
            continue;
        }
        const auto message = direct::lane::messageIn(*frame);
        if (!message) {
            end("it broke the protocol: a frame is no message");
            return false;
        }
        owner.laneMessage(*message);
    }
    if (reader_.failed())
        end(opening_.state() == ClientOpening::State::Open
                ? "it broke the protocol: " + reader_.error()
                : "what answers is no Entity Manager of this edition");
    return !over_;
}

bool FramedLane::onOpening(std::string_view frame, Owner& owner) {
    const auto answer = opening_.onFrame(frame);
    if (const auto* refusal = std::get_if<Refusal>(&answer)) {
        end(refusal->message);
        return false;
    }
    if (opening_.state() == ClientOpening::State::Open) {
        reader_.setLimit(direct::lane::kMessageFrameMax);
        readers_->due(number_, TimePoint::max());
        owner.laneOpen();
        return !over_;
    }
    const auto& claim = std::get<std::string>(answer);
    const std::string_view piece(claim);
    // A new connection has room for it.
    if (channel_->write({&piece, 1}) != claim.size()) {
        end("the connection was lost");
        return false;
    }
    readers_->due(number_, clock_.now() + timeout_);
    return true;
}

}  // namespace axon::client
