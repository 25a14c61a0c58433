// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "report.hpp"
#include "subject.hpp"

namespace axon::bench {

/// What has not arrived by then never arrived.
inline constexpr std::int64_t kPatience_ns = 2'000'000'000;
/// So long after that the next system waits for it, and it counts no more: it would be in that one's way.
inline constexpr std::int64_t kLate_ns = 5'000'000'000;

/// A message to each receiver that is under way: which one each of them is to note, and when it was sent.
struct Batch {
    Kind kind = Kind::Data;
    std::int64_t begin = 0;
    std::vector<std::int64_t> called;
    std::vector<std::uint32_t> awaited;
};

/// A system that takes part in an experiment, and what is measured of it now.
class Contender {
  public:
    Contender(std::string its_name, std::unique_ptr<Subject> subject);

    const std::string name;
    Series series;
    std::size_t relayed = 0;  ///< the most of Subject::relayed() whenever lookAtPaths() was called

    Board& board() { return subject_->board(); }
    Subject& subject() { return *subject_; }
    /// Latency counts from `begin`, which may be earlier than now: when it was due. Stops are awaited by
    /// their number in a row where the system does not number them, so they may overlap, as long as none is
    /// lost for good.
    Batch send(Message message, std::string& bytes, std::int64_t begin);
    /// The first receiver from this one on whose message has not arrived; board().size() when there is none.
    /// Who asks again begins where it was, so that it does not fetch every receiver's memory again and again
    /// while they write it.
    std::size_t firstMissing(const Batch& batch, std::size_t from = 0) const;
    void lookAtPaths() { relayed = std::max(relayed, subject_->relayed()); }
    /// Until all of it has arrived, or `until`, or Ctrl-C.
    void await(const Batch& batch, std::int64_t until) const;
    bool hasRobots() const { return subject_->robots() != nullptr; }
    /// From the begin of the batch, of all receivers.
    void collect(const Batch& batch, Series& from_begin) const {
        collect(batch, 0, batch.awaited.size(), from_begin, nullptr, nullptr);
    }
    /// Of the receivers from `first` to before `end`; from each call, too, and from the begin of the batch to
    /// the callback of the robot application.
    void collect(const Batch& batch, std::size_t first, std::size_t end, Series& from_begin,
                 Series* from_call, Series* at_callback) const;
    /// What was not as it was sent, or not in its place, at all receivers.
    std::uint64_t bad() const;
    /// Of these, what was not as it was sent.
    std::uint64_t corrupt() const;
    /// Likewise, at the callbacks of robot applications.
    std::uint64_t corruptAtCallback() const;
    /// Why it takes part no more: its server or its receivers have ended, or it can be sent nothing. Empty
    /// while it does. What is sent from then on is lost.
    const std::string& ended();

  private:
    /// 0 = not yet, or never.
    std::int64_t arrivedAt(const Batch& batch, std::size_t i) const;
    /// Likewise, at the callback of the robot application.
    std::int64_t calledBackAt(const Batch& batch, std::size_t i) const;

    std::unique_ptr<Subject> subject_;
    std::uint32_t next_number_[2] = {0, 0};
    std::vector<std::uint32_t> next_counted_;
    std::int64_t quiet_after_ = 0;
    std::string ended_;
};

/// Of the receivers from `first` to before `end`.
struct Figures {
    std::size_t first = 0, end = 0;
    Series from_batch, from_call;
    Series at_callback;  ///< from the batch; empty where there are no robot applications

    nlohmann::json json() {
        nlohmann::json its{{"from_batch", from_batch.json()}, {"from_call", from_call.json()}};
        if (at_callback.sent() > 0) its["at_callback"] = at_callback.json();
        return its;
    }
};

struct Pace {
    std::int64_t
        period_ns;  ///< so that fewer than Arrivals::kRemembered batches are under way within kPatience_ns
    int periods, warm_up;
    std::int64_t late_ns = kLate_ns;  ///< 0 where no other system is measured after it
};

/// A batch each period, whether those before have arrived or not; latency counts from when it was due, so
/// that a sender that is held up makes the figures worse, not fewer. Those that warm up come first and are
/// not counted. Returns when all has arrived, or kPatience_ns and kLate_ns have passed. Looks at the paths
/// before each batch.
void measurePaced(Contender& contender, Message message, std::string& bytes, const Pace& pace,
                  std::vector<Figures>& figures);

}  // namespace axon::bench
