// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/service_manager.hpp"

#include <spdlog/spdlog.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include "common/descriptor.hpp"

namespace axon::transport {
namespace {

std::string_view variable(const char* name) {
    const char* value = std::getenv(name);
    return value == nullptr ? std::string_view() : std::string_view(value);
}

/// Where the service manager listens.
class NotifySocket {
  public:
    /// A failure is that of tell().
    explicit NotifySocket(std::string_view name) {
        if (name.size() >= sizeof address_.sun_path) {
            failure_ = ENAMETOOLONG;
            return;
        }
        address_.sun_family = AF_UNIX;
        std::memcpy(address_.sun_path, name.data(), name.size());
        if (name.front() == '@') address_.sun_path[0] = '\0';  // a name of Linux's abstract namespace
        size_ = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + name.size());
        from_ = Descriptor(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
        if (from_.get() < 0) failure_ = errno;
    }

    /// Whether it was sent; if not, errno says why.
    bool tell(std::string_view message, int flags) const {
        if (failure_ != 0) return errno = failure_, false;
        return ::sendto(from_.get(), message.data(), message.size(), MSG_NOSIGNAL | flags,
                        reinterpret_cast<const sockaddr*>(&address_), size_) >= 0;
    }

  private:
    sockaddr_un address_{};
    socklen_t size_ = 0;
    Descriptor from_;
    int failure_ = 0;
};

/// Sends this process SIGABRT at its end, unless it is set again before.
class AbortTimer {
  public:
    AbortTimer() {
        sigevent at_end{};
        at_end.sigev_notify = SIGEV_SIGNAL;
        at_end.sigev_signo = SIGABRT;
        if (::timer_create(CLOCK_MONOTONIC, &at_end, &id_) != 0)
            throw std::system_error(errno, std::generic_category(), "no timer for the watchdog");
    }
    ~AbortTimer() { ::timer_delete(id_); }
    AbortTimer(const AbortTimer&) = delete;
    AbortTimer& operator=(const AbortTimer&) = delete;

    void set(Duration to) {
        const auto seconds = std::chrono::floor<std::chrono::seconds>(to);
        itimerspec once{};
        once.it_value.tv_sec = seconds.count();
        once.it_value.tv_nsec = std::chrono::nanoseconds{to - seconds}.count();
        ::timer_settime(id_, 0, &once, nullptr);
    }

  private:
    timer_t id_{};
};

/// A whole positive number, or none.
std::optional<std::int64_t> positive(std::string_view text) {
    std::int64_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc() || end != text.data() + text.size() || number <= 0) return std::nullopt;
    return number;
}

}  // namespace

void tellServiceManagerReady() {
    const auto socket = variable("NOTIFY_SOCKET");
    if (socket.empty()) return;
    if (!NotifySocket(socket).tell("READY=1", 0))
        spdlog::warn(
            "the service manager at '{}' (NOTIFY_SOCKET) was not told that this program is ready: {}; fix: "
            "Type=exec in the systemd unit",
            socket, std::strerror(errno));
}

ServiceWatchdog::ServiceWatchdog(Duration period, std::function<void()> tell,
                                 std::shared_ptr<const Clock> clock)
    : pause_(period / 3), tell_(std::move(tell)), clock_(std::move(clock)) {}

std::unique_ptr<ServiceWatchdog> ServiceWatchdog::fromEnvironment(std::shared_ptr<const Clock> clock) {
    const auto period = variable("WATCHDOG_USEC");
    const auto process = variable("WATCHDOG_PID");
    if (period.empty()) return nullptr;
    constexpr std::int64_t kLongest = std::chrono::microseconds(std::chrono::hours{24 * 365}).count();
    constexpr std::int64_t kShortest = std::chrono::microseconds(std::chrono::milliseconds{30}).count();
    const auto microseconds = positive(period);
    const auto watched = process.empty() ? std::optional<std::int64_t>(::getpid()) : positive(process);
    const auto useless = [](std::string_view name, std::string_view value, std::string_view expected) {
        spdlog::warn(
            "the service manager's watchdog is not fed: {}='{}', expected {}; fix: let systemd set it "
            "(WatchdogSec= in the unit), or unset it",
            name, value, expected);
        return nullptr;
    };
    if (!watched) return useless("WATCHDOG_PID", process, "the number of a process");
    if (*watched != ::getpid()) return nullptr;  // inherited from a process that is watched
    if (!microseconds || *microseconds > kLongest || *microseconds < kShortest)
        return useless("WATCHDOG_USEC", period, "microseconds, from 30000 (30 ms) to a year");
    const auto socket = variable("NOTIFY_SOCKET");
    if (socket.empty())
        return useless("NOTIFY_SOCKET", socket, "the socket of the service manager, as WATCHDOG_USEC is set");
    // Opened now: when no descriptors are left, this is no reason to be killed.
    return std::make_unique<ServiceWatchdog>(
        std::chrono::microseconds{*microseconds},
        [to = std::make_shared<NotifySocket>(socket), name = std::string(socket), failed = false]() mutable {
            const bool told = to->tell("WATCHDOG=1", MSG_DONTWAIT);
            if (!told && !failed)
                spdlog::warn(
                    "the service manager at '{}' (NOTIFY_SOCKET) was not told that this program works: {}; "
                    "it is tried again, but after WatchdogSec= systemd restarts the program",
                    name, std::strerror(errno));
            failed = !told;
        },
        std::move(clock));
}

std::unique_ptr<ServiceWatchdog> ServiceWatchdog::ofTheKernel(Duration period,
                                                              std::shared_ptr<const Clock> clock) {
    return std::make_unique<ServiceWatchdog>(
        period, [timer = std::make_shared<AbortTimer>(), period] { timer->set(period); }, std::move(clock));
}

ServiceWatchdog::Worker ServiceWatchdog::worker() {
    const std::lock_guard lock(mutex_);
    called_.push_back(false);
    return [this, number = called_.size() - 1] { return turned(number); };
}

Duration ServiceWatchdog::turned(std::size_t worker) {
    const std::lock_guard lock(mutex_);
    const auto now = clock_->now();
    if (now < next_) return next_ - now;
    called_[worker] = true;
    if (std::find(called_.begin(), called_.end(), false) != called_.end()) return pause_;
    std::fill(called_.begin(), called_.end(), false);
    tell_();
    next_ = now + pause_;
    return pause_;
}

}  // namespace axon::transport
