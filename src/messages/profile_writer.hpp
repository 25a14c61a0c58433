// SPDX-License-Identifier: MIT
#pragma once
#include <axon/profile.pb.h>

#include <string>

namespace axon {

/// Messages back to the XML of figures 3.2, 3.3 and A.1, in the spellings that docs/reference/profiles.md
/// prefers. Reading the text gives an equal message, except for what a profile does not hold: entity_id,
/// is_exec, missing, sha256 and size. Characters that XML cannot hold (control characters, bad
/// UTF-8) become '?'.
std::string writeBasicProfile(const proto::BasicProfile& profile);
std::string writeServicesProfile(const proto::ServicesProfile& profile);
std::string writeGlobalProfile(const proto::GlobalProfile& profile);

}  // namespace axon
