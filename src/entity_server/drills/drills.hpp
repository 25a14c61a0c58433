// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/routed.hpp"

namespace axon::entity_server {

/// Measures how long a stop takes: who gets a stop of cause Drill, when, and what came of it.
///
/// In each period every entity gets one, from join() to leave(), spread over the period. Its turn passes
/// without one while it is not ready, and while its last one is unanswered. A drill is settled once: with the
/// time from begin() to its answer, or without one when `answer` has passed since it was given. An answer
/// that comes later, or to a drill that was not given, counts for nothing. Nothing is sent here: next() says
/// what to send.
///
/// Threads: isDrill(), begin() and answer() from any, without a lock, as every stop's receipt comes by there.
/// The rest is not thread-safe: its owner's mutex guards it. Bound: one drill for each entity. Failure: none.
class Drills {
  public:
    struct Settings {
        Duration period{};  ///< zero: no drills
        Duration answer{};  ///< later is no answer
    };
    /// An entity that takes part.
    class Subject {
      public:
        explicit Subject(std::string entity) : entity_(std::move(entity)) {}
        const std::string& entity() const { return entity_; }
        /// How long a stop took when that was measured last; 0: it is unknown. Guarded as Drills is.
        std::int32_t stopLatencyUs() const { return stop_latency_us_; }

      private:
        friend class Drills;
        const std::string entity_;
        // The drill that is out, 0 = none; when it was sent and how long it took.
        std::atomic<std::uint64_t> drill_{0};
        std::atomic<Duration::rep> sent_{0};
        std::atomic<Duration::rep> took_{0};
        // Guarded as Drills is.
        bool ready_ = false;
        std::int32_t stop_latency_us_ = 0;
    };
    using SubjectRef = std::shared_ptr<Subject>;
    /// A drill to be sent to this entity, after begin().
    struct Order {
        SubjectRef to;
        Header head;
    };
    struct Result {
        SubjectRef of;
        bool answered;
        bool changed;  ///< stopLatencyUs() has
    };

    Drills(Settings settings, const Clock& clock, RandomSource& random);

    bool on() const { return settings_.period > Duration{}; }
    /// Whether it belongs to a drill: what its sender's id begins with is nobody else's.
    bool isDrill(const Header& head) const { return on() && head.sender.id.starts_with(prefix_); }
    /// Immediately before it is sent.
    void begin(Order& order) const;
    /// What an entity says of a drill. Returns whether settle() is to be called now.
    bool answer(Subject& subject, const Header& head) const;

    /// `subject` is the only one of its entity that is here.
    void join(const SubjectRef& subject);
    void leave(const SubjectRef& subject);
    /// Whether a drill would tell something, and disturb nothing.
    static void setReady(Subject& subject, bool ready) { subject.ready_ = ready; }
    /// Those that have been answered, and those that are overdue.
    std::vector<Result> settle();
    /// Those whose turn has come.
    std::vector<Order> next();
    /// When to call both again.
    TimePoint nextDeadline() const;

  private:
    struct Given {
        TimePoint answer_by;
        SubjectRef to;
    };
    SubjectRef takeTurn();

    const Settings settings_;
    const Clock& clock_;
    const std::string prefix_;
    std::unordered_map<std::string_view, SubjectRef> all_;
    std::deque<std::weak_ptr<Subject>> round_;  // those whose turn is still to come
    std::vector<Given> unanswered_;
    TimePoint next_turn_;
    std::uint64_t given_ = 0;
};

}  // namespace axon::entity_server
