// SPDX-License-Identifier: MIT
#pragma once
#include <chrono>
#include <memory>

#ifndef AXON_TESTING_API
#define AXON_TESTING_API __attribute__((visibility("default")))
#endif

namespace axon {
class Clock;
}

namespace axon::testing {

class StepClock;

/// A clock that stands still until the test lets time pass, for a robot application in the test's process:
/// EntityInterfacer::Options::clock = clock.shared(). Task::waitFor() and every time-out of the Entity
/// Interfacer then follow it. std::this_thread::sleep_for() and other clocks do not.
///
/// Time passes in advance(), and while an expectation of a ScriptedManager waits that has this clock. Both go
/// from one deadline of a waiting thread to the next, and let that thread run until it waits again. So a
/// handler that waits for 50 ms in a loop takes each step of its loop, however far the test advances. A step
/// takes about a millisecond of real time.
///
/// A thread that neither waits nor ends within 100 ms is not waited for. Threads: any may read it; advance()
/// belongs to one thread at a time. Copies share the clock.
class AXON_TESTING_API ManualClock {
  public:
    ManualClock();

    /// Lets this much time pass. Time that is zero or less is no time.
    void advance(std::chrono::nanoseconds time);
    /// Since its construction.
    std::chrono::nanoseconds elapsed() const;
    /// What EntityInterfacer::Options::clock takes.
    std::shared_ptr<const Clock> shared() const;

  private:
    friend class ScriptedManager;
    std::shared_ptr<StepClock> clock_;
};

}  // namespace axon::testing
