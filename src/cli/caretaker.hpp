// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <sys/types.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
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
    /// After Release: it could not be given back. look() says Release again a minute later.
    void refused(TimePoint now) { again_at_ = now + kAgain; }

  private:
    static constexpr Duration kAgain = std::chrono::minutes{1};

    std::atomic<double> limit_s_{kDefault.count()};
    TimePoint used_at_;
    std::optional<TimePoint> again_at_;
    bool warned_ = false;
};

/// The terminal at this descriptor. Empty where there is none, or it belongs to another user (after su):
/// nothing is written to that one.
std::string terminalOf(int fd, uid_t user);

/// Where a user is reached now: {"terminal": path, "environment": {"DISPLAY": …}} of this process. Without a
/// terminal of this user, or a desktop, that part is missing.
Json reachableAt();
/// Emits an error where `where` (reachableAt) says that nothing can be told there. Whether it did.
bool refuseUnreachable(Session& session, const Json& where);

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

/// Whether a task or a run of a global service that was asked for here is not over.
bool isBusy(const Station& station);

/// Warns of the end of a check-out that nobody uses, and ends it; Station::lost() says why afterwards. A
/// release that is refused is logged, and tried again a minute later. `used`: a verb is running. Whether
/// anything was released.
bool giveBackUnused(Station& station, IdleWatch& idle, const Notifier& notifier,
                    const std::function<void(const std::string&)>& log, TimePoint now, bool used);

/// Whether a user who was away has still to learn that something was given back: the agent, which knows why,
/// stays until a command has asked, for a day at most. Threads: any.
class Untold {
  public:
    void add(TimePoint now) { until_ = now + kLongest; }
    void told() { until_ = TimePoint{}; }
    bool any(TimePoint now) const { return now < until_.load(); }

  private:
    static constexpr Duration kLongest = std::chrono::hours{24};

    std::atomic<TimePoint> until_{TimePoint{}};
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
