// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>

namespace axon {

/// The release of these sources, such as "0.1.0": PROJECT_VERSION.
extern const char* const kRelease;

inline constexpr std::size_t kReleaseMax = 32;

/// Whether a peer's text is taken for a release: 1 to kReleaseMax printable characters of ASCII. Pure.
bool isRelease(std::string_view text);

/// What one program says in its log of peers that have another release and nevertheless work with it: each
/// release once for each kind of peer. Peers say what they like, so whatever is no release counts as one
/// unknown release and is shown cut and escaped, and after kRemembered lines there are no more. Threads: any.
class ReleaseNotes {
  public:
    static constexpr std::size_t kRemembered = 64;

    /// `we`: "this server"; `both`: why the two work together, "contract 3".
    ReleaseNotes(std::string we, std::string both) : we_(std::move(we)), both_(std::move(both)) {}

    /// The line for the log when `peer` ("a client") has connected; nothing where it has our release, has not
    /// told any (empty), or the line was returned before.
    std::optional<std::string> onPeer(const std::string& peer, std::string_view release);

  private:
    const std::string we_, both_;
    std::mutex mutex_;
    std::set<std::pair<std::string, std::string>> said_;  // peer and release; guarded by mutex_
};

}  // namespace axon
