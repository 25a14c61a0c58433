// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/outbox/outbox.hpp"

#include "transport/ice/communicator.hpp"

namespace axon::transport {

static_assert(OutboxLimits{}.data_bytes >= kMessageSizeMaxKib * std::size_t{1024},
              "what a peer may send must be able to wait");

void Outbox::onSent(const AnsweredMessages::Message& message) {
    {
        const std::lock_guard lock(mutex_);
        core_.sent(message.traffic, message.bytes, message.from);
        if (!core_.startPump()) return;
    }
    pump();
}

void Outbox::onAnswer(std::uint64_t number) {
    {
        const std::lock_guard lock(mutex_);
        for (const auto& [traffic, bytes, from] : answers_.onAnswer(number)) core_.sent(traffic, bytes, from);
        if (!core_.startPump()) return;
    }
    pump();
}

void Outbox::sendAll() {
    {
        const std::lock_guard lock(mutex_);
        core_.openWindow();
        answers_.askAlways();
        if (!core_.startPump()) return;
    }
    pump();
}

void Outbox::pump() {
    while (true) {
        std::optional<OutboxCore<Parcel>::Item> item;
        AnsweredMessages::Message message{};
        std::uint64_t number = 0;
        {
            const std::lock_guard lock(mutex_);
            item = core_.next();
            if (!item) return;
            message = {item->traffic, item->bytes, item->from};
            number = numberOf(message);
        }
        launch(message, number, item->parcel);
    }
}

void Outbox::fail(const std::exception_ptr& error) {
    bool was_open = false;
    {
        const std::lock_guard lock(mutex_);
        was_open = !core_.closed();
        core_.close();
    }
    if (!was_open || until_ != Until::Answered) return;
    std::string why = "what it is sent does not arrive";
    if (error) why += ": " + translate(error).message;
    disconnect_(false, why);
}

void Outbox::close() {
    const std::lock_guard lock(mutex_);
    core_.close();
}

bool Outbox::closed() const {
    const std::lock_guard lock(mutex_);
    return core_.closed();
}

OutboxCounts Outbox::counts() const {
    const std::lock_guard lock(mutex_);
    return core_.counts();
}

}  // namespace axon::transport
