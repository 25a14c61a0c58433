// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <string>

namespace axon::transport {

/// The fingerprint of a server's users (users::Users::fingerprint()), beside its announcement by the topic.
/// Nothing is decided by it, and a server need not send it.
inline constexpr const char* kContextUsers = "axon-users";

/// What a server says of its users, and what another one hears of it; empty: nothing, or no fingerprint.
Ice::Context usersContext(const std::string& fingerprint);
std::string usersIn(const Ice::Context& of_server);

}  // namespace axon::transport
