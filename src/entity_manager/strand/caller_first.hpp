// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <asio/post.hpp>
#include <utility>

namespace axon::entity_manager {

/// An executor that runs what is *dispatched* to it at once, in the thread that dispatches it, whichever that
/// is, and what is posted to it on the executor behind it. Below a strand it lets the thread that brings a
/// message handle it when the strand is free, without waking another thread; while the strand is taken, the
/// message waits as ever. Threads: any. Who dispatches must be a thread that may do the strand's work: never
/// one of the signal lane.
class CallerFirst {
  public:
    static CallerFirst over(asio::any_io_executor behind) { return {std::move(behind), true}; }

    template <class Function>
    void execute(Function&& function) const {
        if (at_once_) {
            std::decay_t<Function> own(std::forward<Function>(function));
            own();
        } else {
            asio::post(behind_, std::forward<Function>(function));
        }
    }

    asio::execution_context& query(asio::execution::context_t) const {
        return asio::query(behind_, asio::execution::context);
    }
    asio::execution::blocking_t query(asio::execution::blocking_t) const {
        return at_once_ ? asio::execution::blocking_t(asio::execution::blocking.possibly)
                        : asio::execution::blocking_t(asio::execution::blocking.never);
    }
    CallerFirst require(asio::execution::blocking_t::possibly_t) const { return {behind_, true}; }
    CallerFirst require(asio::execution::blocking_t::never_t) const { return {behind_, false}; }

    bool operator==(const CallerFirst& other) const noexcept {
        return behind_ == other.behind_ && at_once_ == other.at_once_;
    }
    bool operator!=(const CallerFirst& other) const noexcept { return !(*this == other); }

  private:
    CallerFirst(asio::any_io_executor behind, bool at_once) : behind_(std::move(behind)), at_once_(at_once) {}

    asio::any_io_executor behind_;
    bool at_once_ = false;
};

}  // namespace axon::entity_manager
