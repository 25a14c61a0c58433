// SPDX-License-Identifier: MIT
#include "common/queue_share.hpp"

namespace axon {

Refusal queueShareFull(const std::string& consumer) {
    return {RefusalCode::Overloaded,
            consumer + " reads slowly, and its queue has no more room for this sender; fix: send less, or try again in a moment",
            {}};
}

}  // namespace axon
