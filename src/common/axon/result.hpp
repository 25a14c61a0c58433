// SPDX-License-Identifier: MIT
#pragma once
#include <cassert>
#include <utility>
#include <variant>

#include "refusal.hpp"

namespace axon {

/// A value, or the reason why there is none. A refusal is an ordinary outcome and never thrown.
template <class T>
class [[nodiscard]] Result {
  public:
    Result(T value) : state_(std::in_place_index<0>, std::move(value)) {}  // NOLINT: reads as a return value
    Result(Refusal refusal) : state_(std::in_place_index<1>, std::move(refusal)) {}

    bool ok() const { return state_.index() == 0; }
    explicit operator bool() const { return ok(); }
    /// Call only if ok().
    T& value() & { return std::get<0>(state_); }
    const T& value() const& { return std::get<0>(state_); }
    T&& value() && { return std::get<0>(std::move(state_)); }
    T* operator->() { return &value(); }
    const T* operator->() const { return &value(); }
    /// Call only if !ok().
    const Refusal& refusal() const { return std::get<1>(state_); }

  private:
    std::variant<T, Refusal> state_;
};

/// Success, or the reason why something was not done.
template <>
class [[nodiscard]] Result<void> {
  public:
    Result() = default;
    Result(Refusal refusal) : refusal_(std::move(refusal)) {}

    bool ok() const { return refusal_.ok(); }
    explicit operator bool() const { return ok(); }
    const Refusal& refusal() const { return refusal_; }

  private:
    Refusal refusal_;
};

}  // namespace axon
