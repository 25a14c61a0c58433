// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <vector>

#include "casters.hpp"

namespace axon::python {

/// Wakes an event loop: a file descriptor that is readable while feeds have something new.
///
/// Threads: any. Neither this nor a Feed ever takes the GIL, so threads of the client library do not wait for
/// Python.
class Doorbell {
  public:
    Doorbell();
    ~Doorbell();
    Doorbell(const Doorbell&) = delete;
    Doorbell& operator=(const Doorbell&) = delete;

    int descriptor() const { return descriptor_; }
    void ring(std::uint64_t feed);
    /// The feeds that have rung since the last call.
    std::vector<std::uint64_t> take();

  private:
    int descriptor_;
    std::mutex mutex_;
    std::set<std::uint64_t> rung_;
};

/// What the client library tells, until Python takes it: a queue between threads of the library, which put
/// something in and go on, and one of Python.
///
/// Bounds: with a limit, the oldest entry is dropped when that many are there. Data (samples, texts, raw
/// bytes) is bounded in bytes as well: the oldest data is dropped, but never the newest. What was dropped is
/// counted. Everything else is as long as it takes; what arrives there is bounded by what Entity Managers and
/// servers say. Threads: any.
class Feed {
  public:
    /// Makes the object for Python, when it is taken. It holds no object of Python.
    using Make = std::function<pybind11::object(int tag)>;

    static constexpr std::size_t kMostBytes = 64 << 20;
    explicit Feed(std::size_t limit = 0, std::size_t most_bytes = kMostBytes)
        : limit_(limit), most_bytes_(most_bytes) {}

    /// `make` is called with `tag`. `data`: how many bytes of data it holds; 0 = it is no data.
    void push(Make make, int tag, std::size_t data = 0);
    /// Nothing arrives after it. What is there can still be taken.
    void close();
    /// Nothing arrives after it, and what is there is forgotten.
    void abandon();
    /// The oldest entry. None if there is none within `time` seconds, or if there will be none. With the GIL.
    pybind11::object take(std::optional<client::Seconds> time);
    std::size_t size() const;
    bool ended() const;  ///< closed, and everything was taken
    std::uint64_t dropped() const;
    /// `bell` rings with `number` whenever something has come, and at the end.
    void ring(std::shared_ptr<Doorbell> bell, std::uint64_t number);
    /// From now on, what arrives goes to `other` with `tag`, and to everybody who was named before, but not
    /// into this feed. A feed that is closed, or that nobody has any more, is left out.
    void forward(const std::shared_ptr<Feed>& other, int tag);

  private:
    struct Entry {
        Make make;
        int tag = 0;
        std::size_t data = 0;
    };
    struct Target {
        std::weak_ptr<Feed> feed;
        int tag;
    };
    bool closed() const;
    /// With mutex_.
    Entry takeOldest();

    const std::size_t limit_;
    const std::size_t most_bytes_;
    mutable std::mutex mutex_;
    std::condition_variable changed_;
    // Guarded by mutex_:
    std::list<Entry> entries_;
    std::deque<std::list<Entry>::iterator> data_;  // those of entries_ that are data, oldest first
    std::size_t bytes_ = 0;                        // of data_
    std::vector<Target> targets_;
    bool closed_ = false;
    std::uint64_t dropped_ = 0;
    std::shared_ptr<Doorbell> bell_;
    std::uint64_t number_ = 0;
};

/// Whether signals of the operating system are delivered to this thread as exceptions: Python does that on
/// the main one.
bool isMainThread();

/// A wait on the main thread is cut into pieces of this length, between which KeyboardInterrupt is looked
/// for.
inline constexpr client::Seconds kSlice{0.05};

}  // namespace axon::python
