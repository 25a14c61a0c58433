// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <sys/epoll.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

#include "common/clock.hpp"
#include "common/descriptor.hpp"
#include "direct/lane/spin.hpp"
#include "host/wake_up.hpp"

namespace axon::client {

/// The two threads that read the data lanes of all direct paths of a session, and write what waits there.
///
/// One thread reads and passes on what comes; while it is inside a callback of the user's, the kernel wakes
/// the other one if more comes, which reads and queues it. Both wait on the same set of connections, each of
/// which is told of once for each arrival (epoll, edge-triggered). States: idle ── the first add() ► two
/// threads ── end() ► over. Threads: any, but end(), which joins them and so is called on none of them, and
/// before the last reference is dropped. Failure: a connection that cannot be watched is not added.
class LaneReaders {
  public:
    struct Ready {
        bool read = false, written = false;
        bool over = false;  ///< perhaps with something left to read
    };
    /// One connection. Its functions are called on either thread, also at the same time.
    class Lane {
      public:
        virtual ~Lane() = default;
        virtual int descriptor() const = 0;
        virtual void ready(Ready what) = 0;
        /// The deadline has passed.
        virtual void overdue() = 0;
    };

    /// `spin`: as Spinner's.
    explicit LaneReaders(const Clock& clock, Duration spin = {}) : clock_(clock), spin_(spin) {}
    ~LaneReaders();
    LaneReaders(const LaneReaders&) = delete;
    LaneReaders& operator=(const LaneReaders&) = delete;

    /// A number for a lane.
    std::uint64_t next() { return ++last_; }
    /// Watches it, and holds it until remove(). False where it cannot.
    bool add(std::uint64_t number, std::shared_ptr<Lane> lane, TimePoint deadline);
    /// Another deadline; TimePoint::max() for none.
    void due(std::uint64_t number, TimePoint deadline);
    /// There was more to read than one turn took: ready() comes again, after others.
    void again(std::uint64_t number);
    void remove(std::uint64_t number);
    void end();

  private:
    struct Entry {
        std::shared_ptr<Lane> lane;
        TimePoint deadline;
    };
    bool start();
    void run();
    int await(direct::lane::Spinner& spinner, epoll_event& event);
    int takeOne(epoll_event& event);
    void wakeSleepers(bool whether) const;
    int timeout();
    void tellOverdue();
    std::shared_ptr<Lane> laneOf(std::uint64_t number) const;

    const Clock& clock_;
    const Duration spin_;
    mutable std::mutex mutex_;
    // Guarded by mutex_:
    std::map<std::uint64_t, Entry> lanes_;
    std::array<std::thread, 2> threads_;

    std::atomic<std::uint64_t> last_{0};
    std::atomic<std::size_t> deadlines_{0};  // how many lanes have one
    std::atomic<bool> over_{false};
    // These constant once there are threads. Where they may spin, they sleep in the second set, which tells
    // whether there is something in the first one; else in the first one, and there is no second.
    Descriptor epoll_, sleepers_;
    std::optional<WakeUp> wake_;  // none before the first start()
};

}  // namespace axon::client
