// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <optional>
#include <string>

#include "common/refusal.hpp"

namespace axon::transport {

/// Which edition of the contracts in api/ a peer was made from: CommUtil::ContractNumber, which a peer sends
/// with the request that opens a session, in the request's context. Ice passes a context on whatever the
/// contracts say, so that editions which share nothing else can still refuse each other by their numbers.
/// Through a router and to the neighbours of a server it goes on as it came. Servers that IceStorm joins have
/// the number in the names of their topics. The data lane of a direct path says it
/// too; its signal lane need not, because both its ends have shown theirs to a server.
inline constexpr const char* kContextContract = "axon-contract";

/// The release of a peer's program (common/release.hpp), for people: with the request that opens a session,
/// and with the first heartbeat that a server sends in one (PeerSender), which answers it. Nothing is decided
/// by it, and a peer need not send it.
inline constexpr const char* kContextRelease = "axon-release";

/// A topic's name with the number: servers of other editions do not meet there.
std::string ofContract(const std::string& topic);
/// The number of another edition's topic of this name; nothing where it is ours, or another topic.
std::optional<int> contractOfOther(const std::string& topic, const std::string& found);

/// What a peer sends with open() and createSession(): our contract and release.
Ice::Context contractContext();
/// What a server sends with the first heartbeat: our release.
Ice::Context releaseContext();

/// What a peer says is its release, cut where isRelease() has seen enough of it; empty: nothing.
std::string releaseIn(const Ice::Context& of_peer);
/// "contract 3", as ReleaseNotes says it.
std::string ourContract();

/// NOT_SUPPORTED with both numbers, the releases as far as they are known, and what to upgrade, unless the
/// peer's number is this one's.
std::optional<Refusal> otherContract(const Ice::Context& of_peer);

}  // namespace axon::transport
