// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/outbox.hpp"

namespace axon::transport {

void Outbox::onSent(std::size_t bytes) {
    {
        const std::lock_guard lock(mutex_);
        core_.sent(bytes);
        if (!core_.startPump()) return;
    }
    while (true) {
        std::optional<OutboxCore<Parcel>::Item> item;
        {
            const std::lock_guard lock(mutex_);
            item = core_.next();
        }
        if (!item) return;
        launch(item->bytes, item->parcel);
    }
}

void Outbox::close() {
    const std::lock_guard lock(mutex_);
    core_.close();
}

OutboxCounts Outbox::counts() const {
    const std::lock_guard lock(mutex_);
    return core_.counts();
}

}  // namespace axon::transport
