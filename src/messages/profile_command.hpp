// SPDX-License-Identifier: MIT
#pragma once
#include <iosfwd>
#include <string>
#include <vector>

namespace axon {

/// What `axon profile check FILE...` does: all findings of all files, then one line that counts them. With
/// `json` each line is an object: {"file","line","severity","element","expected","fix"} for a finding, and
/// at the end
/// {"ok","files","errors","warnings"}. Returns the exit status: 0 no findings or warnings only, 1 errors, 2 a
/// file that cannot be read (also when others have errors) or no file named at all.
int checkProfiles(const std::vector<std::string>& files, bool json, std::ostream& out);

}  // namespace axon
