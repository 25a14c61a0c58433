// SPDX-License-Identifier: MIT
#include "common/queue_share.hpp"

namespace axon {

Refusal queueShareFull(const std::string& consumer) {
    return {RefusalCode::Overloaded,
            consumer + " reads slowly, and the part of its queue that other senders than its holder may fill is full; fix: send less, or "
                       "try again in a moment",
            {}};
}

}  // namespace axon
