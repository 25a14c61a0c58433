// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <thread>
#include <utility>

#include "axon/testing/laboratory.hpp"
#include "common/clock.hpp"

namespace axon::testing {

/// The time of a laboratory, and what is to happen when. Equal times happen in the order in which they were
/// planned.
///
/// Threads: any may plan and cancel; advance() one at a time. What happens runs on the thread of advance()
/// or, if time passes at once, on one of its own, and without the lock.
class Agenda {
  public:
    using Event = std::function<void()>;
    /// `settle` is called after each event: everything that follows from it at the same time has been
    /// planned when it returns.
    Agenda(Passing passing, Event settle);
    ~Agenda();
    Agenda(const Agenda&) = delete;
    Agenda& operator=(const Agenda&) = delete;

    Duration now() const;
    /// Returns a number for cancel(), never 0.
    std::uint64_t in(Duration time, Event event);
    /// After this it no longer begins; one that has begun goes on.
    void cancel(std::uint64_t number);
    void advance(Duration time);
    /// While one exists, nothing begins: for who plans something and says something that has to come before
    /// it. Short, and without advance() or settling in between.
    class Hold {
      public:
        explicit Hold(Agenda& agenda);
        ~Hold();
        Hold(const Hold&) = delete;
        Hold& operator=(const Hold&) = delete;

      private:
        Agenda& agenda_;
    };
    /// Nothing happens any more, and nothing can be planned. Waits for what is happening.
    void end();

  private:
    using Key = std::pair<Duration, std::uint64_t>;
    /// The next event until `end`, at whose time it is then; none if there is none. Waits for who holds it.
    Event takeUntil(Duration end);
    void run();

    const Passing passing_;
    const Event settle_;
    mutable std::mutex mutex_;
    std::condition_variable changed_;
    // Guarded by mutex_:
    Duration now_{};
    std::uint64_t numbers_ = 0;
    std::map<Key, Event> events_;
    std::size_t holds_ = 0;
    bool ending_ = false;

    std::thread thread_;
};

}  // namespace axon::testing
