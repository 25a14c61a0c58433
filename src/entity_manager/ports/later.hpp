// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <memory>
#include <optional>
#include <utility>

namespace axon::entity_manager {

/// The answer of a port behind which a disk may take its time: there at once, or set later by a thread of the
/// port, which then says that something has come (Journal::onAnswer, ResourceStore::onAnswer). Copies share
/// the answer. Threads: one sets it, once; any may look.
template <class T>
class Later {
  public:
    /// An answer that is there already.
    Later(T value) : state_(std::make_shared<State>()) {
        set(std::move(value));
    }  // NOLINT: reads as a return value
    static Later pending() { return Later(); }

    bool ready() const { return state_->ready.load(std::memory_order_acquire); }
    /// Only when ready().
    const T& value() const { return *state_->value; }
    void set(T value) const {
        state_->value.emplace(std::move(value));
        state_->ready.store(true, std::memory_order_release);
    }

  private:
    Later() : state_(std::make_shared<State>()) {}
    struct State {
        std::optional<T> value;
        std::atomic<bool> ready{false};
    };
    std::shared_ptr<State> state_;
};

}  // namespace axon::entity_manager
