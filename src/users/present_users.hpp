// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <optional>
#include <string>

#include "common/routed.hpp"
#include "users/access.hpp"

namespace axon::users {

/// Who may be here at this moment, and as what: the file of users changes while clients and Entity Managers
/// are connected. The servers' cores ask it when somebody comes whom it was asked about a while ago, and for
/// all that are here when it has changed. Any thread; neither blocks nor throws, and calls nobody.
class PresentUsers {
  public:
    virtual ~PresentUsers() = default;
    /// Nothing: no client may be this user.
    virtual std::optional<Role> clientRole(const std::string& user) const = 0;
    virtual bool mayBeEntityManager(const std::string& user) const = 0;
    /// Which entities clients may see, check out, take over and rearm. Never null.
    virtual std::shared_ptr<const Access> access() const = 0;
    /// Of all this, as Users::fingerprint() says it: servers with the same one have the same users.
    virtual std::string fingerprint() const = 0;
};

}  // namespace axon::users
