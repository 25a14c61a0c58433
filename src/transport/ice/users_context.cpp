// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/users_context.hpp"

namespace axon::transport {

Ice::Context usersContext(const std::string& fingerprint) {
    return fingerprint.empty() ? Ice::Context() : Ice::Context{{kContextUsers, fingerprint}};
}

std::string usersIn(const Ice::Context& of_server) {
    constexpr std::size_t kMost = 64;
    const auto found = of_server.find(kContextUsers);
    if (found == of_server.end() || found->second.size() > kMost ||
        found->second.find_first_not_of("0123456789abcdef") != std::string::npos)
        return {};
    return found->second;
}

}  // namespace axon::transport
