// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <random>
#include <string_view>

#include "audit/note.hpp"
#include "common/clock.hpp"
#include "common/queue_share.hpp"
#include "common/rate_limit.hpp"

namespace axon::audit {

/// How many commands and refusals are kept in a second.
struct ShareBounds {
    std::uint32_t sure = 20;   ///< of each source, whatever the others do
    std::uint32_t each = 200;  ///< of each source, while there is room
    std::uint32_t all = 1000;  ///< of all sources together, besides what is sure
};

/// Which of the records that anybody can cause in any number are kept: each source has a part that no other
/// source can use up. A source is a user with all its sessions, or else the address of a connection without
/// its port, or else a name.
///
/// Threads: any; no lock, no allocation. Bounded: 1024 parts. Sources that meet in a part by chance share it;
/// who meets whom is another at each start, so that nobody can choose a part.
class Shares {
  public:
    explicit Shares(const ShareBounds& bounds) : all_(bounds.all), salt_(std::random_device{}()) {
        for (std::size_t i = 0; i < kParts; ++i)
            parts_.emplace_back(bounds.sure, bounds.each - std::min(bounds.each, bounds.sure));
    }

    bool admit(const Note& note, TimePoint now) {
        auto& part = parts_[partOf(note)];
        return part.sure.admit(now) || (part.more.admit(now) && all_.admit(now));
    }

  private:
    static constexpr std::size_t kParts = 1024;
    struct Part {
        Part(std::uint32_t its_sure, std::uint32_t its_more) : sure(its_sure), more(its_more) {}
        RateLimit sure, more;
    };

    std::size_t partOf(const Note& note) const {
        const auto address = note.peer.substr(0, note.peer.rfind(':'));
        std::uint64_t key = 0;
        if (!note.client.empty()) {
            key = senderKey(note.client);
        } else {
            for (const auto text : {address, note.user, note.name, note.entity})
                if (key == 0 && !text.empty()) key = std::hash<std::string_view>{}(text) | 1U;
        }
        key = (key ^ salt_) * 0x9e3779b97f4a7c15U;
        return key >> 54U;  // 10 bits
    }

    std::deque<Part> parts_;
    RateLimit all_;
    const std::uint64_t salt_;
};

}  // namespace axon::audit
