// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"

namespace axon::simulation {

class Timeline;

/// One operating-system process of the simulated laboratory: alive, frozen (SIGSTOP) or dead, with a
/// monotonic clock of its own that began at another moment than the others' and may run faster or slower.
///
/// What is due at a frozen process waits until it thaws; what was due at a dead one never happens: each start
/// is a new *life*, and an event belongs to one life. A member of World, which outlives every event.
class Process final : public Clock {
  public:
    Process(Timeline& timeline, int number, std::string name);

    TimePoint now() const override;
    /// The moment of the world's time at which this clock shows `local`, or a little later.
    TimePoint whenItShows(TimePoint local) const;
    void setClock(Duration offset, double rate);

    int number() const { return number_; }
    const std::string& name() const { return name_; }
    bool running() const { return alive_ && !frozen_; }
    bool alive() const { return alive_; }
    bool frozen() const { return frozen_; }
    std::uint32_t life() const { return life_; }
    /// Since when it runs, or since when it does not; in the world's time.
    TimePoint changedAt() const { return changed_at_; }

    void start();
    void die();
    void freeze();
    void thaw();

  private:
    friend class Timeline;
    Timeline& timeline_;
    const int number_;
    const std::string name_;
    bool alive_ = false;
    bool frozen_ = false;
    std::uint32_t life_ = 0;
    TimePoint changed_at_{};
    Duration offset_{};
    double rate_ = 1;
    std::vector<std::uint32_t> backlog_;  ///< slots of what came due while it was frozen
};

/// Virtual time: a queue of events in the order of their time, and of their making where that is equal. One
/// thread; the same calls give the same run, and the same digest.
class Timeline {
  public:
    Timeline() = default;
    ~Timeline();
    Timeline(const Timeline&) = delete;
    Timeline& operator=(const Timeline&) = delete;

    TimePoint now() const { return now_; }
    std::uint64_t events() const { return events_; }
    std::uint64_t digest() const { return digest_; }
    std::size_t waiting() const { return heap_.size(); }
    /// Makes a fact part of the digest.
    void mark(std::uint64_t fact) { digest_ = (digest_ ^ fact) * 0x9E3779B97F4A7C15ULL + (digest_ >> 29U); }

    /// `what` is done at `when` by this life of the process.
    template <class What>
    void at(TimePoint when, Process& who, What&& what) {
        using Stored = std::decay_t<What>;
        const auto index = takeSlot();
        Slot& slot = slots_[index];
        slot.who = &who;
        slot.life = who.life_;
        if constexpr (sizeof(Stored) <= kInline && alignof(Stored) <= alignof(std::max_align_t)) {
            ::new (static_cast<void*>(slot.storage)) Stored(std::forward<What>(what));
            slot.run = [](void* at) { (*static_cast<Stored*>(at))(); };
            slot.destroy = [](void* at) { static_cast<Stored*>(at)->~Stored(); };
        } else {
            ::new (static_cast<void*>(slot.storage)) Stored*(new Stored(std::forward<What>(what)));
            slot.run = [](void* at) { (**static_cast<Stored**>(at))(); };
            slot.destroy = [](void* at) { delete *static_cast<Stored**>(at); };
        }
        push(when < now_ ? now_ : when, index);
    }
    template <class What>
    void after(Duration time, Process& who, What&& what) {
        at(now_ + time, who, std::forward<What>(what));
    }

    /// The next event; false when there is none up to `end`, and then it is `end`.
    bool step(TimePoint end);

    /// Story on: the text is made and kept. Otherwise nothing is.
    bool story = false;
    template <class Text>
    void tell(const std::string& who, Text&& text) {
        if (story) lines_.push_back(stamp(who) + std::forward<Text>(text)());
        if (lines_.size() > kLines) lines_.pop_front();
    }
    const std::deque<std::string>& lines() const { return lines_; }

  private:
    friend class Process;
    static constexpr std::size_t kInline = 280;
    static constexpr std::size_t kLines = 20'000;
    struct Slot {
        Process* who = nullptr;
        std::uint32_t life = 0;
        void (*run)(void*) = nullptr;
        void (*destroy)(void*) = nullptr;
        alignas(std::max_align_t) std::byte storage[kInline];
    };
    struct Entry {
        TimePoint when;
        std::uint64_t order;
        std::uint32_t slot;
        bool operator<(const Entry& other) const {
            return when != other.when ? when > other.when : order > other.order;  // earliest on top
        }
    };
    std::uint32_t takeSlot();
    void release(std::uint32_t index);
    void push(TimePoint when, std::uint32_t slot);
    std::string stamp(const std::string& who) const;

    TimePoint now_{std::chrono::seconds{1000}};
    std::uint64_t order_ = 0;
    std::uint64_t events_ = 0;
    std::uint64_t digest_ = 0xcbf29ce484222325ULL;
    std::vector<Entry> heap_;
    std::deque<Slot> slots_;
    std::vector<std::uint32_t> free_;
    std::deque<std::string> lines_;
};

/// A timer of a process, by the process's own clock. It may ring early, never late: whoever is called looks
/// what is due. Later deadlines than the one that is set cost nothing, which is what watchdogs that are fed
/// need.
class Alarm {
  public:
    Alarm(Timeline& timeline, Process& who, std::function<void()> ring)
        : timeline_(timeline), who_(who), ring_(std::move(ring)) {}
    void set(TimePoint local);
    /// A new life of the process: what the last one had set will not come.
    void forget() {
        armed_ = TimePoint::max();
        ++token_;
    }

  private:
    Timeline& timeline_;
    Process& who_;
    const std::function<void()> ring_;
    TimePoint armed_ = TimePoint::max();
    std::uint64_t token_ = 0;
};

/// Chance that is the same in every run of a seed.
class Dice {
  public:
    explicit Dice(std::uint64_t seed) : source_(seed) {}
    /// 0 to below - 1.
    std::uint64_t roll(std::uint64_t below) { return below == 0 ? 0 : source_.next() % below; }
    bool chance(double part) {
        return static_cast<double>(source_.next() >> 11U) < part * 9007199254740992.0;
    }
    Duration between(Duration from, Duration to) {
        return from + Duration{static_cast<Duration::rep>(
                          roll(static_cast<std::uint64_t>((to - from).count()) + 1))};
    }

  private:
    SeededRandom source_;
};

}  // namespace axon::simulation
