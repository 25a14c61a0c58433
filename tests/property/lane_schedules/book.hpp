// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <cstring>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "common/ids.hpp"
#include "direct/incoming_way.hpp"

namespace axon::schedules {

using direct::Keeping;

/// What the threads of a trial tell its driver: that something has happened. Threads: any.
class Activity {
  public:
    void tell() {
        const std::lock_guard lock(mutex_);
        ++count_;
        changed_.notify_all();
    }
    /// Until something has happened since the last call, or a millisecond is over.
    void await() {
        std::unique_lock lock(mutex_);
        changed_.wait_for(lock, std::chrono::milliseconds{1}, [this] { return count_ != seen_; });
        seen_ = count_;
    }

  private:
    std::mutex mutex_;
    std::condition_variable changed_;
    std::uint64_t count_ = 0, seen_ = 0;
};

/// The content of a message: a piece of one pattern, which follows from the message's number.
class Content {
  public:
    static constexpr std::size_t kMost = (4096 - 64) * 1024;
    static std::string of(std::int64_t sequence, std::size_t size) {
        return std::string(pattern(), placeOf(sequence), size);
    }
    static bool isOf(std::int64_t sequence, std::string_view content) {
        return content.size() <= kMost &&
               std::memcmp(pattern().data() + placeOf(sequence), content.data(), content.size()) == 0;
    }

  private:
    static constexpr std::size_t kPlaces = 8191;
    static std::size_t placeOf(std::int64_t sequence) { return static_cast<std::size_t>(sequence) % kPlaces; }
    static const std::string& pattern() {
        static const std::string its = [] {
            std::string bytes(kMost + kPlaces, '\0');
            SeededRandom(1).fill(bytes.data(), bytes.size());
            return bytes;
        }();
        return its;
    }
};

/// One direction between a client and an Entity Manager: what was sent, and the judgement of what has come.
///
/// A session of the client with its server may be lost, and with it the last messages of that session. All
/// else that may not be lost must come once and in order, and what may be lost at most once and in the same
/// order. Threads: any; numbers are given by the sender in the order of sending.
class Book {
  public:
    explicit Book(std::string name) : name_(std::move(name)) {}

    void sent(Keeping keeping, std::int64_t sequence, std::size_t size) {
        const std::lock_guard lock(mutex_);
        (keeping == Keeping::Kept ? kept_ : droppable_).push_back({sequence, size, session_});
    }
    /// What is sent from now on belongs to another session; what has not come may be lost.
    void newSession() {
        const std::lock_guard lock(mutex_);
        ++session_;
    }
    void came(Keeping keeping, std::int64_t sequence, std::string_view content) {
        const std::lock_guard lock(mutex_);
        const auto& sent = keeping == Keeping::Kept ? kept_ : droppable_;
        const auto at =
            std::lower_bound(sent.begin(), sent.end(), sequence,
                             [](const Sent& one, std::int64_t its) { return one.sequence < its; });
        if (sequence <= last_)
            return wrong(sequence, "came behind " + std::to_string(last_) + ": twice, or out of order");
        last_ = sequence;
        if (at == sent.end() || at->sequence != sequence) return wrong(sequence, "was never sent");
        if (at->size != content.size() || !Content::isOf(sequence, content))
            return wrong(sequence, "has another content");
        if (keeping == Keeping::Droppable) {
            ++droppable_came_;
            return;
        }
        const auto place = static_cast<std::size_t>(at - sent.begin());
        const bool begins = place == 0 || sent[place - 1].session != at->session;
        // A gap is what the session before has lost, and that is its end.
        if (place != next_ && !(begins && sent[next_].session < at->session))
            return wrong(sequence, "came, and " + std::to_string(sent[next_].sequence) + " is missing");
        next_ = place + 1;
        ++kept_came_;
    }
    /// All that may not be lost and was sent in the present session.
    bool allHasCome() const {
        const std::lock_guard lock(mutex_);
        return next_ == kept_.size() || kept_.back().session < session_;
    }
    /// The first thing that was wrong; empty if nothing was.
    std::string verdict() const {
        const std::lock_guard lock(mutex_);
        return wrong_;
    }
    std::string state() const {
        const std::lock_guard lock(mutex_);
        return name_ + ": " + std::to_string(next_) + " of " + std::to_string(kept_.size()) +
               " reliable messages have come" +
               (next_ < kept_.size() ? ", not " + std::to_string(kept_[next_].sequence) : std::string());
    }
    std::size_t keptCame() const {
        const std::lock_guard lock(mutex_);
        return kept_came_;
    }
    std::size_t droppableCame() const {
        const std::lock_guard lock(mutex_);
        return droppable_came_;
    }

  private:
    struct Sent {
        std::int64_t sequence;
        std::size_t size;
        int session;
    };
    /// Under mutex_.
    void wrong(std::int64_t sequence, const std::string& what) {
        if (wrong_.empty()) wrong_ = name_ + ": message " + std::to_string(sequence) + " " + what;
    }

    const std::string name_;
    mutable std::mutex mutex_;
    // Guarded by mutex_:
    std::vector<Sent> kept_, droppable_;
    std::size_t next_ = 0;  // of kept_: the next that is to come
    std::int64_t last_ = 0;
    std::size_t kept_came_ = 0, droppable_came_ = 0;
    int session_ = 0;
    std::string wrong_;
};

/// Something else than the order of messages that must hold in a trial. Threads: any.
class Claims {
  public:
    void hold(bool holds, const char* what) {
        if (holds) return;
        const std::lock_guard lock(mutex_);
        if (broken_.empty()) broken_ = what;
    }
    std::string verdict() const {
        const std::lock_guard lock(mutex_);
        return broken_;
    }

  private:
    mutable std::mutex mutex_;
    std::string broken_;
};

/// Messages that a sender must keep, because they are not acknowledged. Confined to its owner.
class Unacknowledged {
  public:
    void add(std::int64_t sequence, std::size_t bytes) {
        waiting_.push_back({sequence, bytes});
        bytes_ += bytes;
    }
    void acknowledged(std::int64_t sequence) {
        auto last = waiting_.begin();
        for (; last != waiting_.end() && last->first <= sequence; ++last) bytes_ -= last->second;
        waiting_.erase(waiting_.begin(), last);
    }
    void clear() {
        waiting_.clear();
        bytes_ = 0;
    }
    /// One alone may be larger.
    bool within(std::size_t messages, std::size_t bytes) const {
        return waiting_.size() <= 1 || (waiting_.size() <= messages && bytes_ <= bytes);
    }

  private:
    std::vector<std::pair<std::int64_t, std::size_t>> waiting_;
    std::size_t bytes_ = 0;
};

}  // namespace axon::schedules
