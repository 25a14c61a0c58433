// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <memory>
#include <string>

#include "common/routed.hpp"

namespace axon::entity_server {

/// What the front-end servers know of an entity, replaced whole.
struct Record {
    Registration registration;
    std::shared_ptr<const std::string> profile;  ///< never null
    EntityStatus status;
    bool heard = false;         ///< the status is one that it has sent
    std::uint64_t session = 0;  ///< the number of its session
};
using RecordRef = std::shared_ptr<const Record>;

}  // namespace axon::entity_server
