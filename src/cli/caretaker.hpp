// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <atomic>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "cli/desktop.hpp"
#include "cli/session.hpp"
#include "common/clock.hpp"

// What an agent does of its own accord: tells its user what cannot wait, and gives back what nobody uses.
namespace axon::cli {

/// Says when something that is held and not used should be given back. Threads: setLimit any, look one.
class IdleWatch {
  public:
    static constexpr Seconds kDefault{3600};
    enum class Says { Nothing, Warn, Release };

    explicit IdleWatch(TimePoint now) : used_at_(now) {}
    /// How long it may stay unused; zero = for ever.
    void setLimit(Seconds limit) { limit_s_ = limit.count(); }
    Seconds limit() const { return Seconds(limit_s_); }
    /// How long before the end it warns: five minutes, of short limits half.
    Seconds warning() const { return std::min(Seconds(300), limit() / 2); }
    /// Warn comes once for each time of disuse.
    Says look(TimePoint now, bool used);

  private:
    std::atomic<double> limit_s_{kDefault.count()};
    TimePoint used_at_;
    bool warned_ = false;
};

/// Where a user is reached now: {"terminal": path, "environment": {"DISPLAY": …}} of this process. Without a
/// terminal, or a desktop, that part is missing.
Json reachableAt();

/// Tells a user at once: a line and the bell on a terminal, and a notification of the desktop by notify-send.
/// Threads: any. Does not wait: a terminal that takes nothing, and a missing notify-send, are passed over.
class Notifier {
  public:
    /// As reachableAt() says; nothing is told before.
    void aim(const Json& where);
    bool aimed() const;
    void tell(const std::string& text) const;

  private:
    mutable std::mutex mutex_;
    // guarded by mutex_
    std::string terminal_;
    Desktop desktop_;
    bool aimed_ = false;
};

/// Tells of requests for what a station holds. Threads: follow() one at a time.
class RequestWatch {
  public:
    explicit RequestWatch(std::shared_ptr<Notifier> notifier) : notifier_(std::move(notifier)) {}
    /// Listens to what is held now, and no longer to what is not. An open request is told of at once.
    void follow(Station& station);

  private:
    const std::shared_ptr<Notifier> notifier_;
    std::mutex mutex_;
    std::map<std::string, std::shared_ptr<void>> listening_;  // guarded by mutex_
};

}  // namespace axon::cli
