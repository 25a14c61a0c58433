// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/sending/message_sender.hpp"

#include <utility>

namespace axon::client {
namespace {

/// Consecutive small messages for one data lane. Written when it ends, whatever ends it.
class Burst {
  public:
    ~Burst() { end(); }
    bool open() const { return lane_ != nullptr; }
    bool goesTo(const DataLane* lane) const { return lane_.get() == lane; }
    void add(Outgoing& message) {
        lane_ = message.servers;
        lane_->add(message.kind, message.head, std::move(message.bytes));
    }
    void end() {
        if (const auto lane = std::exchange(lane_, nullptr)) lane->write();
    }

  private:
    std::shared_ptr<const DataLane> lane_;
};

bool isSignal(Operation kind) {
    return kind == Operation::Reset || kind == Operation::Clear;
}

}  // namespace

MessageSender::MessageSender(const Clock& clock, const DirectLinks& links, std::function<void()> wake,
                             std::function<void()> lively)
    : clock_(clock), links_(links), wake_(std::move(wake)), direct_(std::move(lively)) {}

void MessageSender::put(Operation kind, const Header& head, std::string bytes) {
    put_bytes_ = bytes.size() + kMessageOverhead;
    put_ = queue_.put({kind, head, std::move(bytes), links_.linkOf(head.entity), lane_.load()}, put_bytes_);
    if (isSignal(kind)) breakBurst();  // signals are left to nobody
}

void MessageSender::sendToEntity(const Header& head, std::string bytes) {
    put(Operation::ToEntity, head, std::move(bytes));
}

void MessageSender::sendToEntityDataSeq(const Header& head, std::string bytes) {
    put(Operation::ToEntityDataSeq, head, std::move(bytes));
}

void MessageSender::sendRequest(const Header& head, std::string bytes) {
    put(Operation::Request, head, std::move(bytes));
}

void MessageSender::sendReset(const Header& head) {
    put(Operation::Reset, head, {});
}

void MessageSender::sendClear(const Header& head) {
    put(Operation::Clear, head, {});
}

void MessageSender::sendMark(const Header& head, std::string bytes, std::shared_ptr<DirectLink> link,
                             std::shared_ptr<DirectPath> path) {
    const auto size = bytes.size() + kMessageOverhead;
    put_ = queue_.put(
        {Operation::ToEntity, head, std::move(bytes), std::move(link), lane_.load(), std::move(path)}, size);
}

MessageSender::Leaving MessageSender::collect(bool here) {
    const auto last = std::exchange(put_, 0);
    return {last, last != 0 && here && !leavesToSender()};
}

bool MessageSender::leavesToSender() {
    const auto now = clock_.now();
    const bool fast = now - std::exchange(sent_at_, now) < kFast;
    return fast && put_bytes_ <= kTogetherBytes && queue_.waiting().bytes < kLeftToSender;
}

void MessageSender::depart(Leaving leaving) {
    if (leaving.last == 0) return;
    if (leaving.here) {
        send(leaving.last);
    } else {
        wake_();
    }
}

void MessageSender::sendAll() {
    {
        const std::lock_guard sending(mutex_);
        direct_.fallBackFromEnded();
    }
    flush();
}

/// Up to the message `ticket`; one thread at a time, so the order of the core is the order on the wire.
void MessageSender::send(std::uint64_t ticket) {
    const std::lock_guard sending(mutex_);
    Burst burst;
    for (auto item = queue_.take(ticket); item;) {
        auto next = queue_.take(ticket);
        auto& message = item->message;
        if (direct_.concerns(message))
            burst.end();  // what may go by the servers now comes behind what was added
        if (!direct_.takes(message)) {
            const bool joins = item->bytes <= kTogetherBytes && !isSignal(message.kind);
            if (!joins || !burst.goesTo(message.servers.get())) burst.end();
            if (message.servers && joins && (burst.open() || next)) {
                burst.add(message);
            } else {
                message.sendByServers();
            }
        }
        queue_.sent(item->bytes);
        item = std::move(next);
    }
}

Refusal MessageSender::admit(std::size_t bytes) const {
    if (bytes > kMessageBytesMax) {
        return {RefusalCode::TooLarge,
                "A message holds at most " + std::to_string(kMessageBytesMax) +
                    " bytes. Send it in pieces, or upload it as a resource.",
                {}};
    }
    auto waiting = queue_.waiting();
    if (const auto lane = lane_.load()) {
        waiting.messages += lane->waiting();
        waiting.bytes += lane->waitingBytes();
    }
    return admission(waiting.messages, waiting.bytes, bytes);
}

void MessageSender::awaitRoom(Duration wait) const {
    if (const auto lane = lane_.load()) lane->awaitRoom(wait);
}

}  // namespace axon::client
