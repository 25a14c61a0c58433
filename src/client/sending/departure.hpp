// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <exception>
#include <mutex>
#include <optional>
#include <type_traits>
#include <utility>

namespace axon::client {

/// "Collect under the lock, send after it": how whatever a core gives to send leaves the library.
///
/// A core (SessionCore, StopDesk) calls its links while its owner's lock is held. The owner only notes what
/// it is given. When the use of the core is over, two named steps of the owner follow:
///
///   owner.collect(how...)   under the lock: takes out what was noted, and decides which threads have to wake
///   owner.depart(leaving)   without the lock, on the same thread: sends it, and wakes them; noexcept
///
/// Both follow even when the use throws, because what the core gave to send before that counts (a stop above
/// all). Where in the flow: between the calls of users and connections on one side, and a core on the other.
/// Threads: any; one at a time is inside. A use must not begin another one of the same owner. depart() may:
/// it holds nothing. Failure: an exception in depart() ends the program, and the watchdogs of its peers stop
/// what it holds.
template <class Owner>
class Departure {
  public:
    Departure(Owner& owner, std::mutex& lock) : owner_(owner), lock_(lock) {}

    /// Returns what `use` returns, after the departure. `how` is passed on to collect().
    template <class Use, class... How>
    auto after(Use&& use, How... how) const -> std::decay_t<std::invoke_result_t<Use>> {
        using Answer = std::decay_t<std::invoke_result_t<Use>>;
        std::unique_lock inside(lock_);
        std::exception_ptr thrown;
        std::conditional_t<std::is_void_v<Answer>, std::optional<bool>, std::optional<Answer>> answer;
        try {
            if constexpr (std::is_void_v<Answer>) {
                use();
            } else {
                answer.emplace(use());
            }
        } catch (...) {
            thrown = std::current_exception();
        }
        auto leaving = owner_.collect(how...);
        inside.unlock();
        static_assert(noexcept(owner_.depart(std::move(leaving))), "half a departure would wake nobody");
        owner_.depart(std::move(leaving));
        if (thrown) std::rethrow_exception(thrown);
        if constexpr (!std::is_void_v<Answer>) return std::move(*answer);
    }

  private:
    Owner& owner_;
    std::mutex& lock_;
};

}  // namespace axon::client
