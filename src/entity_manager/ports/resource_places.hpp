// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/result.hpp"

// Where the files of resources lie on the robot's machine, as their url says (docs/reference/profiles.md).
namespace axon::entity_manager {

/// Where urls may lead. From the robot application, with its profile.
struct ResourceRoots {
    std::string profiles;  ///< absolute: the folder of the profile, in which a relative url begins
    std::vector<std::string> permitted;  ///< absolute: beneath one of these an absolute url must lie
};

/// A resource as its profile declares it.
struct ResourceQuery {
    std::string service, resource, url;
    bool savable = false;
};

/// What was found of it.
struct ResourcePlace {
    std::string
        path;  ///< absolute and without symbolic links: of the file that is there, or may be put there
    bool there = false;
    std::uint64_t size = 0;  ///< bytes
    Refusal refusal;         ///< why its url cannot be used; the path is empty then
};

// All of these wait for the disk. Threads: any. Failure: refusals, in whose text stands how it is put right.

/// BAD_NAME: the url leads out of its folder by a symbolic link, or lies in none that is permitted. INTERNAL:
/// it cannot be looked at.
ResourcePlace findResourcePlace(const ResourceRoots& roots, std::string_view url);

/// Whether a file may be put there: PERMISSION_DENIED, also where the file that is there has been made
/// read-only.
Refusal mayReplaceResource(const ResourcePlace& place);

/// Puts the file `from` into the place, and leaves nothing at `from`. Whoever opens the place sees the old
/// content or the new, never a part. The mode of the old file stays; a new one may be read by everybody.
/// PERMISSION_DENIED, OVERLOADED (no room), INTERNAL: the old file is as it was, and so is `from`.
Result<void> replaceResource(const std::string& from, const ResourcePlace& place);

}  // namespace axon::entity_manager
