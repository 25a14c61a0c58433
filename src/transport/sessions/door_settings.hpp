// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

namespace Ice {
class Communicator;
}

namespace axon::transport {

class ConnectionLimits;
class Logins;

/// Of one more way into a server (SessionDoor). What is referred to outlives the door.
struct DoorSettings {
    struct Lane {
        std::string endpoint;  ///< in Ice's form: "ws -h 127.0.0.1 -p 0"
        std::shared_ptr<Ice::Communicator> communicator;
        Logins* logins = nullptr;  ///< who may open a session of this lane
    };
    Lane data;
    Lane signal;
    /// Where a peer finds the signal lane that came to the data lane at the address `local` from a page of
    /// this `origin`; none where it is no browser.
    std::function<std::string(const std::string& local, const std::optional<std::string>& origin)>
        signal_endpoint;
    /// Looks after the connections of peers.
    ConnectionLimits* limits = nullptr;
};

/// The ports that a door has taken.
struct DoorPorts {
    std::uint16_t data = 0;
    std::uint16_t signal = 0;
};

}  // namespace axon::transport
