// SPDX-License-Identifier: MIT
#pragma once
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <thread>

#include "common/clock.hpp"

namespace axon::testing {

/// The clock behind ManualClock. It knows the threads that wait for it by their questions: a thread that
/// waits asks realTimeUntil() several times in a millisecond, and one whose deadline has come asks no more
/// until it waits again. So a step can be complete before the next one begins.
///
/// Threads: any; advance() and step() one at a time.
class StepClock final : public Clock {
  public:
    TimePoint now() const override;
    Duration realTimeUntil(TimePoint deadline) const override;

    Duration elapsed() const { return now() - kStart; }
    /// How many threads wait for a time to come.
    std::size_t waiting() const;
    /// From deadline to deadline, each step complete.
    void advance(Duration time);
    /// To the next deadline, but at most this far.
    void step(Duration at_most);

    /// Called between two steps, not from within a thread that waits: whoever must not fall behind when much
    /// time passes keeps up here. Ends with the token.
    using Follower = std::function<void()>;
    [[nodiscard]] std::shared_ptr<void> follow(Follower follower);

  private:
    static constexpr TimePoint kStart{std::chrono::seconds{1000}};  // not zero, as ManualClock of common
    /// Of a thread: until when it waits, or that it runs since its deadline.
    struct Thread {
        TimePoint deadline;
        bool waits;
    };
    void moveTo(TimePoint time);
    void follow();
    TimePoint next(TimePoint limit) const;

    mutable std::mutex mutex_;
    mutable std::condition_variable asked_;
    TimePoint now_ = kStart;  // guarded by mutex_, as all that follows
    mutable std::map<std::thread::id, Thread> threads_;
    std::map<const void*, std::weak_ptr<Follower>> followers_;
};

}  // namespace axon::testing
