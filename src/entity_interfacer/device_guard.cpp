// SPDX-License-Identifier: MIT
#include "entity_interfacer/axon/device_guard.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

extern "C" {  // which glibc 2.36 leaves out
#include <sys/pidfd.h>
}

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <iostream>
#include <mutex>
#include <new>
#include <optional>
#include <stdexcept>
#include <system_error>

#include "common/clock.hpp"
#include "common/descriptor.hpp"
#include "entity_interfacer/silence_count.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;

constexpr auto kLook = 10ms;
constexpr auto kRepeat = 50ms;
constexpr auto kHold = 300ms;
constexpr std::size_t kStopMax = 1024;
constexpr int kPriority = 31;                // above the threads that it watches
constexpr int kControl = STDERR_FILENO + 1;  // in the guard's process
constexpr int kApplication = kControl + 1;

/// What both processes see.
struct Page {
    std::atomic<std::uint64_t> beats{0};    // of the application
    std::atomic<std::uint64_t> looks{0};    // of the guard
    std::atomic<std::uint32_t> stopped{0};  // the watch whose device the guard has stopped
    std::atomic<std::uint32_t> let_go{0};   // the watch whose descriptor it has closed since it was released
};
static_assert(std::atomic<std::uint64_t>::is_always_lock_free &&
              std::atomic<std::uint32_t>::is_always_lock_free);

/// Application → guard. A Watch carries the descriptor.
struct Message {
    enum class Kind : std::uint32_t { Watch, Release };
    Kind kind = Kind::Release;
    std::uint32_t watch = 0;
};

struct Control {
    alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> bytes{};
};

bool sendMessage(int control, Message message, int descriptor) {
    iovec data{&message, sizeof message};
    msghdr header{};
    header.msg_iov = &data;
    header.msg_iovlen = 1;
    Control extra;
    if (descriptor >= 0) {
        header.msg_control = extra.bytes.data();
        header.msg_controllen = extra.bytes.size();
        auto* rights = CMSG_FIRSTHDR(&header);
        rights->cmsg_level = SOL_SOCKET;
        rights->cmsg_type = SCM_RIGHTS;
        rights->cmsg_len = CMSG_LEN(sizeof descriptor);
        std::memcpy(CMSG_DATA(rights), &descriptor, sizeof descriptor);
    }
    return ::sendmsg(control, &header, MSG_NOSIGNAL | MSG_DONTWAIT) == static_cast<ssize_t>(sizeof message);
}

// The guard's process. It may be the fork of a program with many threads, of which any may have held any
// lock: from here on only what is safe in a signal handler is called, and no memory is allocated.

class Guard {
  public:
    Guard(Page& page, const std::string& stop, Duration silence, const std::string& when_silent,
          const std::string& when_gone)
        : page_(page), stop_(stop), silence_(silence), when_silent_(when_silent), when_gone_(when_gone) {}

    [[noreturn]] void run() {
        // A fork of the application that outlives it keeps the control connection open.
        std::array<pollfd, 2> wait{{{kControl, POLLIN, 0}, {kApplication, POLLIN, 0}}};
        while (true) {
            const timespec look{0, Duration{kLook}.count()};
            ::ppoll(wait.data(), wait.size(), device_.open() ? &look : nullptr, nullptr);
            page_.looks.fetch_add(1, std::memory_order_release);
            const auto now = clock_.now();
            // First whatever the application has said before its end.
            if (wait[0].revents != 0 ? !hear(now) : wait[1].revents != 0) {
                wait[0].fd = wait[1].fd = -1;  // the application has ended
                gone_ = true;
                if (!device_.open()) ::_exit(0);
                if (!holding_) hold(when_gone_, now);
            }
            if (device_.open() && !holding_ &&
                silence_.look(page_.beats.load(std::memory_order_acquire), now))
                hold(when_silent_, now);
            if (holding_) goOnHolding(now);
        }
    }

  private:
    /// False at the end.
    bool hear(TimePoint now) {
        Message message;
        iovec data{&message, sizeof message};
        Control extra;
        msghdr header{};
        header.msg_iov = &data;
        header.msg_iovlen = 1;
        header.msg_control = extra.bytes.data();
        header.msg_controllen = extra.bytes.size();
        const auto got = ::recvmsg(kControl, &header, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
        if (got < 0 && (errno == EAGAIN || errno == EINTR)) return true;
        if (got != static_cast<ssize_t>(sizeof message)) return false;
        letGo();
        if (message.kind == Message::Kind::Release)
            page_.let_go.store(message.watch, std::memory_order_release);
        const auto* rights = CMSG_FIRSTHDR(&header);
        if (message.kind != Message::Kind::Watch || rights == nullptr) return true;
        int device = -1;
        std::memcpy(&device, CMSG_DATA(rights), sizeof device);
        device_ = Descriptor(device);
        watch_ = message.watch;
        int type = 0;
        socklen_t size = sizeof type;
        is_socket_ = ::getsockopt(device_.get(), SOL_SOCKET, SO_TYPE, &type, &size) == 0;
        silence_.restart(page_.beats.load(std::memory_order_acquire), now);
        return true;
    }
    void letGo() {
        device_.reset();
        holding_ = false;
    }
    void hold(const std::string& why, TimePoint now) {
        // First of all: an application that wakes up in this moment sends nothing more.
        page_.stopped.store(watch_, std::memory_order_release);
        holding_ = true;
        since_ = again_ = now;
        goOnHolding(now);
        // It is the application's too, and may be what the application hangs on.
        pollfd terminal{STDERR_FILENO, POLLOUT, 0};
        if (::poll(&terminal, 1, 0) != 1 || (terminal.revents & POLLOUT) == 0) return;
        [[maybe_unused]] const auto written = ::write(STDERR_FILENO, why.data(), why.size());
    }
    void goOnHolding(TimePoint now) {
        if (now >= again_) {
            writeStop();
            again_ = now + kRepeat;
        }
        if (now < since_ + kHold) return;
        if (!gone_ && !is_socket_) return;  // it cannot be shut for the application
        writeStop();                        // the last thing that the device hears
        if (gone_) ::_exit(0);
        ::shutdown(device_.get(), SHUT_RDWR);
        letGo();
    }
    void writeStop() const {
        if (is_socket_) {
            [[maybe_unused]] const auto sent =
                ::send(device_.get(), stop_.data(), stop_.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
            return;
        }
        pollfd room{device_.get(), POLLOUT, 0};
        if (::poll(&room, 1, 0) != 1) return;
        [[maybe_unused]] const auto written = ::write(device_.get(), stop_.data(), stop_.size());
    }

    const SteadyClock clock_{};
    Page& page_;
    const std::string& stop_;
    SilenceCount silence_;
    const std::string& when_silent_;
    const std::string& when_gone_;
    Descriptor device_;
    bool is_socket_ = false;
    std::uint32_t watch_ = 0;
    bool holding_ = false;
    bool gone_ = false;
    TimePoint since_{};
    TimePoint again_{};
};

/// Leaves nothing of the application in the guard's process: no handlers, no terminal, no descriptors but
/// kControl, kApplication and standard error.
void becomeGuard(int control, int application) {
    for (int signal = 1; signal < NSIG; ++signal) ::signal(signal, SIG_DFL);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGTSTP, SIGTTIN, SIGTTOU, SIGPIPE})
        ::signal(signal, SIG_IGN);
    sigset_t none;
    sigemptyset(&none);
    ::sigprocmask(SIG_SETMASK, &none, nullptr);
    ::setsid();
    ::prctl(PR_SET_NAME, "axon-guard");
    sched_param param{};
    param.sched_priority = kPriority;
    ::sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &param);  // where that is permitted
    application = ::fcntl(application, F_DUPFD, kApplication);          // away from kControl
    if (application < 0) ::_exit(1);
    ::dup2(control, kControl);
    ::dup2(application, kApplication);
    const int nothing = ::open("/dev/null", O_RDWR);
    ::dup2(nothing, STDIN_FILENO);
    ::dup2(nothing, STDOUT_FILENO);
    if (::close_range(kApplication + 1, ~0U, 0) != 0) {  // of a kernel before 5.9
        rlimit most{};
        ::getrlimit(RLIMIT_NOFILE, &most);
        for (int fd = kApplication + 1; fd < static_cast<int>(std::min<rlim_t>(most.rlim_cur, 1U << 20U));
             ++fd)
            ::close(fd);
    }
}

}  // namespace

// The application's side.

class DeviceGuard::Desk {
  public:
    explicit Desk(Options options) : options_(std::move(options)), looks_silence_(options_.silence) {
        if (options_.stop.empty() || options_.stop.size() > kStopMax)
            throw std::invalid_argument(
                "DeviceGuard: Options::stop has " + std::to_string(options_.stop.size()) +
                " bytes; expected 1 to 1024; fix: set the bytes that stop the device");
        if (options_.silence < 50ms || options_.silence > 10s)
            throw std::invalid_argument("DeviceGuard: Options::silence is " +
                                        std::to_string(options_.silence.count()) +
                                        " ms; expected 50 to 10000 ms");
        void* memory =
            ::mmap(nullptr, sizeof(Page), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
        if (memory == MAP_FAILED)
            throw std::system_error(errno, std::generic_category(), "DeviceGuard: shared memory");
        page_ = new (memory) Page;
        const auto line = [this](const std::string& why) {
            return "axon: the guard of " + options_.device + " stops it: its application " + why + "\n";
        };
        when_silent_ = line("has been silent for " + std::to_string(options_.silence.count()) + " ms");
        when_gone_ = line("has ended without stopping it");
        const std::lock_guard lock(mutex_);
        startGuard();
    }
    ~Desk() {
        const std::lock_guard lock(mutex_);
        if (process_.open()) {
            ::shutdown(control_.get(), SHUT_WR);
            pollfd ended{process_.get(), POLLIN, 0};
            const auto until = clock_.now() + kHold + 2 * kRepeat;
            int left = 1;
            do {
                left = static_cast<int>(
                    std::chrono::duration_cast<std::chrono::milliseconds>(until - clock_.now()).count());
            } while (left > 0 && ::poll(&ended, 1, left) < 0 && errno == EINTR);
        }
        giveUp();
        ::munmap(page_, sizeof(Page));
    }

    bool watch(int descriptor) {
        if (descriptor < 0) return false;
        tellOfLoss();
        int error = 0;
        if (handOver(descriptor, error)) return true;
        log("the guard of " + options_.device + " cannot be started: " + std::strerror(error));
        return false;
    }
    bool beat() {
        page_->beats.fetch_add(1, std::memory_order_release);
        if (!watching_ || stopped()) return false;
        const std::lock_guard lock(mutex_);
        if (!looks_silence_.look(page_->looks.load(std::memory_order_acquire), clock_.now()))
            return watching_;
        // First the caller stops the device: whatever takes time comes with its release() or watch().
        watching_ = false;
        lost_ = true;
        return false;
    }
    bool stopped() const { return watch_ != 0 && page_->stopped.load(std::memory_order_acquire) == watch_; }
    void release() {
        tellOfLoss();
        const std::lock_guard lock(mutex_);
        if (!watching_.exchange(false)) return;
        if (!sendMessage(control_.get(), {Message::Kind::Release, watch_}, -1) || !waitUntilLetGo()) giveUp();
    }
    int pid() const { return pid_; }

  private:
    bool handOver(int descriptor, int& error) {
        const std::lock_guard lock(mutex_);
        // A guard that died while nothing was watched is noticed here.
        for (int attempt = 0; attempt < 2; ++attempt) {
            if (!process_.open() && !startGuard()) break;
            const auto next = watch_.load() + 1;
            if (sendMessage(control_.get(), {Message::Kind::Watch, next}, descriptor)) {
                looks_silence_.restart(page_->looks, clock_.now());
                watch_ = next;
                watching_ = true;
                return true;
            }
            error = errno;
            giveUp();
        }
        if (error == 0) error = errno;
        return false;
    }
    void tellOfLoss() {
        {
            const std::lock_guard lock(mutex_);
            if (!std::exchange(lost_, false)) return;
            giveUp();
        }
        log("the guard of " + options_.device +
            " was gone or frozen; the device was stopped, and is guarded again after the next connect");
    }
    bool startGuard() {
        const Descriptor application(::pidfd_open(::getpid(), 0));
        if (!application.open()) return false;  // of a kernel before 5.3
        std::array<int, 2> ends{};
        if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data()) != 0) return false;
        Descriptor own(ends[0]);
        const Descriptor guards(ends[1]);
        // None of the program's handlers may run in the guard.
        sigset_t all, former;
        sigfillset(&all);
        ::pthread_sigmask(SIG_SETMASK, &all, &former);
        const int pid = ::fork();
        if (pid == 0) {
            becomeGuard(guards.get(), application.get());
            Guard(*page_, options_.stop, options_.silence, when_silent_, when_gone_).run();
        }
        const int error = errno;
        ::pthread_sigmask(SIG_SETMASK, &former, nullptr);
        errno = error;
        if (pid < 0) return false;
        process_ = Descriptor(::pidfd_open(pid, 0));
        control_ = std::move(own);
        pid_ = pid;
        if (process_.open()) return true;
        ::kill(pid, SIGKILL);
        ::waitpid(pid, nullptr, 0);
        pid_ = 0;
        return false;
    }
    /// False of a guard that has died, or that is frozen and keeps the device's connection open.
    bool waitUntilLetGo() const {
        const auto until = clock_.now() + options_.silence;
        while (page_->let_go.load(std::memory_order_acquire) != watch_) {
            pollfd ended{process_.get(), POLLIN, 0};
            if (clock_.now() >= until || ::poll(&ended, 1, 1) > 0) return false;
        }
        return true;
    }
    /// Of a guard that does not work any more. Killed before its connection is closed, which would wake it
    /// up. By a descriptor: should the application have reaped it, its number may be another process's.
    void giveUp() {
        watching_ = false;
        pid_ = 0;
        if (!process_.open()) return;
        ::pidfd_send_signal(process_.get(), SIGKILL, nullptr, 0);
        siginfo_t ended{};
        ::waitid(static_cast<idtype_t>(P_PIDFD), static_cast<id_t>(process_.get()), &ended, WEXITED);
        process_.reset();
        control_.reset();
    }
    void log(const std::string& text) const {
        if (options_.logger)
            options_.logger(text);
        else
            std::cerr << "axon: " + text + "\n";
    }

    // Constant after construction.
    const Options options_;
    const SteadyClock clock_{};
    Page* page_ = nullptr;
    std::string when_silent_, when_gone_;

    std::atomic<std::uint32_t> watch_{0};
    std::atomic<bool> watching_{false};
    std::atomic<int> pid_{0};

    std::mutex mutex_;
    SilenceCount looks_silence_;  // these four guarded by mutex_
    Descriptor process_, control_;
    bool lost_ = false;  // the guard was, and has not been given up yet
};

DeviceGuard::DeviceGuard(Options options) : desk_(std::make_unique<Desk>(std::move(options))) {}
DeviceGuard::~DeviceGuard() = default;
bool DeviceGuard::watch(int descriptor) {
    return desk_->watch(descriptor);
}
bool DeviceGuard::beat() {
    return desk_->beat();
}
bool DeviceGuard::stopped() const {
    return desk_->stopped();
}
void DeviceGuard::release() {
    desk_->release();
}
int DeviceGuard::pid() const {
    return desk_->pid();
}

}  // namespace axon
