// SPDX-License-Identifier: MIT
#pragma once
#include <array>
#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <string_view>
#include <unordered_map>
#include <utility>

#include "common/snapshot.hpp"

namespace axon {

/// A map that many read and few change, in immutable pieces: a change copies one piece of 64, so that 4096
/// joins in a row cost 4096 small copies and not 4096 copies of everything. Readers of different lanes have
/// references, and thus locks, of their own (invariant 3): each names its lane, 0 to `Lanes` - 1.
///
/// `Value` is a shared_ptr; keys point into what it points to. Threads: reading from any; changes come one at
/// a time, so their owner locks. A walk over all sees every entry that was there before it began and stays.
template <class Value, std::size_t Lanes = 1>
class SnapshotTable {
  public:
    static constexpr std::size_t kPieces = 64;

    /// Null when there is none.
    Value find(std::string_view key, std::size_t lane = 0) const {
        const auto piece = pieces_[indexOf(key)][lane].load();
        const auto found = piece->find(key);
        return found == piece->end() ? Value{} : found->second;
    }
    /// Calls `use(value)` for each value, without holding a lock.
    template <class Use>
    void each(Use&& use, std::size_t lane = 0) const {
        for (const auto& lanes : pieces_) {
            const auto piece = lanes[lane].load();
            for (const auto& [key, value] : *piece) use(value);
        }
    }
    std::size_t size() const { return size_.load(std::memory_order_relaxed); }

    /// Replaces what was there under this key. `key` points into what `value` points to.
    void put(std::string_view key, Value value) {
        change(key, [&](Piece& piece) {
            piece.erase(key);  // its key would point into the old value
            piece.emplace(key, std::move(value));
        });
    }
    void erase(std::string_view key) {
        change(key, [&](Piece& piece) { piece.erase(key); });
    }

  private:
    using Piece = std::unordered_map<std::string_view, Value>;

    static std::size_t indexOf(std::string_view key) { return std::hash<std::string_view>{}(key) % kPieces; }

    template <class Change>
    void change(std::string_view key, Change&& make) {
        auto& lanes = pieces_[indexOf(key)];
        const auto before = lanes[0].load();
        auto next = std::make_shared<Piece>(*before);
        make(*next);
        size_.fetch_add(next->size() - before->size(), std::memory_order_relaxed);
        const std::shared_ptr<const Piece> done = std::move(next);
        for (auto& lane : lanes) lane.store(done);
    }

    std::array<std::array<Snapshot<Piece>, Lanes>, kPieces> pieces_;
    std::atomic<std::size_t> size_{0};
};

}  // namespace axon
