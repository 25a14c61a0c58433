// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users_agreement.hpp"

namespace axon::users {

std::string UsersAgreement::heard(const std::string& server, const std::string& theirs,
                                  const std::string& ours, TimePoint now) {
    const std::lock_guard lock(mutex_);
    const auto found = differing_.find(server);
    if (theirs == ours) {
        if (found == differing_.end()) return {};
        const bool told = found->second.told;
        differing_.erase(found);
        return told ? "users: " + server + " has the same users as this server again" : std::string();
    }
    if (found == differing_.end()) {
        if (differing_.size() < kMost) differing_[server].since = now;
        return {};
    }
    if (found->second.told || now - found->second.since < kPatience) return {};
    found->second.told = true;
    return "users: " + server + " has other users than this server (fingerprints " + theirs + " and " + ours +
           "), so who was removed here may still log in there, or the other way round; fix: copy the file of "
           "Server.Users to all servers";
}

}  // namespace axon::users
