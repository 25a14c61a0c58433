// SPDX-License-Identifier: MIT
#include "common/release.hpp"

#include <algorithm>

namespace axon {
namespace {

bool isPrintable(char c) {
    return c >= ' ' && c <= '~';
}

std::string escaped(std::string_view text) {
    static constexpr char kHex[] = "0123456789abcdef";
    std::string shown;
    for (const char c : text.substr(0, kReleaseMax)) {
        if (isPrintable(c)) {
            shown += c;
            continue;
        }
        const auto byte = static_cast<unsigned char>(c);
        shown += "\\x";
        shown += kHex[byte >> 4U];
        shown += kHex[byte & 15U];
    }
    return text.size() > kReleaseMax ? shown + "..." : shown;
}

}  // namespace

const char* const kRelease = AXON_RELEASE;

bool isRelease(std::string_view text) {
    return !text.empty() && text.size() <= kReleaseMax && std::all_of(text.begin(), text.end(), isPrintable);
}

std::optional<std::string> ReleaseNotes::onPeer(const std::string& peer, std::string_view release) {
    if (release.empty() || release == kRelease) return std::nullopt;
    const bool known = isRelease(release);
    bool last = false;
    {
        const std::lock_guard lock(mutex_);
        if (said_.size() >= kRemembered) return std::nullopt;
        if (!said_.emplace(peer, known ? release : std::string_view()).second) return std::nullopt;
        last = said_.size() == kRemembered;
    }
    return "connected with " + peer + " of " +
           (known ? "release " + std::string(release) : "an unknown release ('" + escaped(release) + "')") +
           ", " + we_ + " has " + kRelease + "; they work together, because both have " + both_ +
           (last ? "; further releases are not logged" : "");
}

}  // namespace axon
