// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string_view>
#include <vector>

#include "audit/note.hpp"

namespace axon::audit {

/// Notes on their way from the threads that make them to the one that writes them: a bounded queue of slots
/// that exist from the beginning (after D. Vyukov's bounded queue). A push copies the texts into a slot; it
/// takes no lock and allocates nothing. Texts that are longer than their part of a slot are cut.
///
/// Threads: push() any; front(), drop() and pop() one. Bounded: `slots`, rounded up to a power of two. When
/// it is full, push() returns false.
class Ring {
  public:
    static constexpr std::size_t kTexts = 7;
    /// The most bytes of user, name, client, peer, entity, what and outcome.
    static constexpr std::array<std::size_t, kTexts> kLongest{64, 64, 128, 64, 64, 512, 64};
    static constexpr std::size_t kBytes = 960;  // their sum

    /// A note and when it was made, with its texts in itself.
    struct Kept {
        Kind kind = Kind::Started;
        std::int64_t at_us = 0;
        std::array<std::uint16_t, kTexts> ends{};
        std::array<char, kBytes> bytes{};

        std::string_view text(std::size_t which) const {
            const std::size_t begin = which == 0 ? 0 : ends.at(which - 1);
            return {bytes.data() + begin, ends.at(which) - begin};
        }
        /// Of what another life has left.
        bool sound() const {
            std::uint16_t begin = 0;
            for (std::size_t i = 0; i < kTexts; ++i) {
                if (ends[i] < begin || ends[i] - begin > static_cast<int>(kLongest[i])) return false;
                begin = ends[i];
            }
            return static_cast<std::size_t>(kind) < kKinds.size();
        }
    };

    /// `turn`: the position in the whole sequence for which it is free, and one more when it has its note.
    struct Slot {
        std::atomic<std::size_t> turn{0};
        Kept kept;
    };

    explicit Ring(std::size_t slots) : own_(std::bit_ceil(std::max<std::size_t>(slots, 2))), slots_(own_) {
        for (std::size_t i = 0; i < slots_.size(); ++i) slots_[i].turn.store(i, std::memory_order_relaxed);
    }
    /// In slots of somebody else, which outlive it: a power of two of them, empty (Slots).
    explicit Ring(std::span<Slot> slots) : slots_(slots) {}

    std::size_t slots() const { return slots_.size(); }

    bool push(const Note& note, std::int64_t at_us) {
        return pushInto([&](Kept& to) { keep(note, at_us, to); });
    }
    bool push(const Kept& kept) {
        return pushInto([&](Kept& to) { to = kept; });
    }

    /// The oldest, which stays where it is until drop(); null: there is none.
    const Kept* front() const {
        const auto& slot = slots_[next_out_ & (slots_.size() - 1)];
        return slot.turn.load(std::memory_order_acquire) == next_out_ + 1 ? &slot.kept : nullptr;
    }
    void drop() {
        auto& slot = slots_[next_out_ & (slots_.size() - 1)];
        slot.turn.store(next_out_ + slots_.size(), std::memory_order_release);
        ++next_out_;
    }
    bool pop(Kept& to) {
        const auto* const oldest = front();
        if (oldest == nullptr) return false;
        to = *oldest;
        drop();
        return true;
    }

  private:
    template <class Fill>
    bool pushInto(Fill fill) {
        auto at = next_in_.load(std::memory_order_relaxed);
        Slot* slot = nullptr;
        while (true) {
            slot = &slots_[at & (slots_.size() - 1)];
            const auto ahead = static_cast<std::ptrdiff_t>(slot->turn.load(std::memory_order_acquire) - at);
            if (ahead < 0) return false;
            if (ahead > 0) {
                at = next_in_.load(std::memory_order_relaxed);
            } else if (next_in_.compare_exchange_weak(at, at + 1, std::memory_order_relaxed)) {
                break;
            }
        }
        fill(slot->kept);
        slot->turn.store(at + 1, std::memory_order_release);
        return true;
    }

    static void keep(const Note& note, std::int64_t at_us, Kept& to) {
        to.kind = note.kind;
        to.at_us = at_us;
        const std::array<std::string_view, kTexts> texts{note.user,   note.name, note.client, note.peer,
                                                         note.entity, note.what, note.outcome};
        std::size_t end = 0;
        for (std::size_t i = 0; i < kTexts; ++i) {
            auto length = std::min(texts[i].size(), kLongest[i]);
            // Not within a character of UTF-8.
            while (length > 0 && length < texts[i].size() &&
                   (static_cast<unsigned char>(texts[i][length]) & 0xC0U) == 0x80U)
                --length;
            if (length > 0) std::memcpy(to.bytes.data() + end, texts[i].data(), length);
            end += length;
            to.ends[i] = static_cast<std::uint16_t>(end);
        }
    }

    std::vector<Slot> own_;
    const std::span<Slot> slots_;
    std::atomic<std::size_t> next_in_{0};
    std::size_t next_out_ = 0;  // of the thread that pops
};

}  // namespace axon::audit
