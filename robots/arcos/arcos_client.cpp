// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/arcos_client.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <mutex>
#include <system_error>
#include <thread>

namespace axon::arcos {
namespace {

constexpr Duration kConnectTimeout = std::chrono::seconds{1};
constexpr Duration kFirstPause = std::chrono::milliseconds{100};
constexpr Duration kLongestPause = std::chrono::seconds{2};
constexpr Duration kTick = std::chrono::milliseconds{25};

class EventDescriptor {
  public:
    EventDescriptor() : fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
        if (fd_ < 0) throw std::system_error(errno, std::generic_category(), "eventfd");
    }
    ~EventDescriptor() { ::close(fd_); }
    EventDescriptor(const EventDescriptor&) = delete;
    EventDescriptor& operator=(const EventDescriptor&) = delete;
    int get() const { return fd_; }
    void raise() const {
        const std::uint64_t one = 1;
        [[maybe_unused]] const auto written = ::write(fd_, &one, sizeof one);
    }
    void lower() const {
        std::uint64_t raised = 0;
        [[maybe_unused]] const auto got = ::read(fd_, &raised, sizeof raised);
    }

  private:
    int fd_;
};

}  // namespace

class ArcosClient::Worker final : public ClientSession::Port {
  public:
    Worker(StreamOpener open, Callbacks callbacks, Duration silence_limit, std::shared_ptr<const Clock> clock)
        : open_(std::move(open)),
          callbacks_(std::move(callbacks)),
          clock_(std::move(clock)),
          session_(*this, silence_limit) {}

    ~Worker() override { finish(); }

    void finish() {
        if (finished_.exchange(true)) return;
        command(encodeCommand(Command::EStop));
        command(encodeCommand(Command::Close));
        quit_ = true;
        wake_.raise();
        if (thread_.joinable()) thread_.join();
    }

    void start() {
        thread_ = std::thread([this] { run(); });
    }

    RobotState state() const {
        const std::lock_guard lock(state_mutex_);
        return state_;
    }

    bool command(const Bytes& bytes) {
        const std::lock_guard lock(link_mutex_);
        if (!online_ || !link_) return false;
        if (link_->write(bytes)) return true;
        broken_ = true;
        wake_.raise();
        return false;
    }

    // ClientSession::Port, on the worker's own thread.
    void send(const Bytes& bytes) override {
        const std::lock_guard lock(link_mutex_);
        if (link_ && !link_->write(bytes)) broken_ = true;
    }

    void onOnline(const RobotIdentity& identity) override {
        {
            const std::lock_guard lock(link_mutex_);
            online_ = true;
        }
        pause_ = kFirstPause;
        publish(session_.robot());
        if (callbacks_.on_online) callbacks_.on_online(identity);
    }

    void onState(const RobotState& state) override {
        publish(state);
        if (callbacks_.on_state) callbacks_.on_state(state);
    }

    void onLost(const std::string& reason) override {
        {
            const std::lock_guard lock(link_mutex_);
            online_ = false;
        }
        publish(session_.robot());
        if (callbacks_.on_lost) callbacks_.on_lost(reason);
    }

  private:
    void publish(const RobotState& state) {
        const std::lock_guard lock(state_mutex_);
        state_ = state;
    }

    void run() {
        while (!quit_) {
            auto opened = open_(kConnectTimeout);
            if (opened) {
                attend(std::move(opened).value());
            } else if (callbacks_.on_lost) {
                callbacks_.on_lost(opened.refusal().message);
            }
            if (quit_) return;
            waitFor(-1, pause_);
            pause_ = std::min(pause_ * 2, kLongestPause);
        }
    }

    /// One connection, from begin() to its end.
    void attend(std::unique_ptr<ByteStream> stream) {
        const int fd = stream->descriptor();
        {
            const std::lock_guard lock(link_mutex_);
            link_ = std::move(stream);
            broken_ = false;
        }
        session_.begin(clock_->now());
        std::array<std::uint8_t, 2048> chunk;
        while (!quit_ && session_.state() != ClientSession::State::Closed) {
            waitFor(fd, clock_->realTimeUntil(clock_->now() + kTick));
            const int got = link_->read(chunk);
            if (got > 0)
                session_.receive(std::span(chunk).first(static_cast<std::size_t>(got)), clock_->now());
            if (got < 0) session_.end("the robot closed the connection");
            if (broken_) session_.end("the connection to the robot does not take any more bytes");
            session_.tick(clock_->now());
        }
        session_.end("the program ends");
        const std::lock_guard lock(link_mutex_);
        link_.reset();
    }

    void waitFor(int fd, Duration time) {
        std::array<pollfd, 2> waiting{pollfd{wake_.get(), POLLIN, 0}, pollfd{fd, POLLIN, 0}};
        // Less than none is for ever to poll(2).
        const auto ms = std::max<std::int64_t>(0, std::chrono::ceil<std::chrono::milliseconds>(time).count());
        ::poll(waiting.data(), fd < 0 ? 1 : 2, static_cast<int>(ms));
        if (waiting[0].revents != 0) wake_.lower();
    }

    // Constant after construction.
    const StreamOpener open_;
    const Callbacks callbacks_;
    const std::shared_ptr<const Clock> clock_;
    const EventDescriptor wake_;

    // Confined to the worker's thread.
    ClientSession session_;
    Duration pause_ = kFirstPause;

    std::atomic<bool> finished_ = false;
    std::atomic<bool> quit_ = false;
    std::atomic<bool> broken_ = false;

    mutable std::mutex state_mutex_;
    RobotState state_;  // guarded by state_mutex_

    std::mutex link_mutex_;             // held for one non-blocking write
    std::unique_ptr<ByteStream> link_;  // replaced under link_mutex_, by the worker's thread only
    bool online_ = false;               // guarded by link_mutex_

    std::thread thread_;
};

ArcosClient::ArcosClient(StreamOpener open, Callbacks callbacks, Duration silence_limit,
                         std::shared_ptr<const Clock> clock)
    : worker_(
          std::make_unique<Worker>(std::move(open), std::move(callbacks), silence_limit, std::move(clock))) {}
ArcosClient::~ArcosClient() = default;
void ArcosClient::start() {
    worker_->start();
}

void ArcosClient::finish() {
    worker_->finish();
}

RobotState ArcosClient::state() const {
    return worker_->state();
}
bool ArcosClient::command(Command command) {
    return worker_->command(encodeCommand(command));
}
bool ArcosClient::command(Command command, int argument) {
    return worker_->command(encodeCommand(command, argument));
}
bool ArcosClient::command(Command command, std::string_view text) {
    return worker_->command(encodeCommand(command, text));
}

bool ArcosClient::drive(double forward_mm_s, double left_deg_s) {
    auto bytes = encodeCommand(Command::Vel, static_cast<int>(std::lround(forward_mm_s)));
    const auto rotation = encodeCommand(Command::RVel, static_cast<int>(std::lround(left_deg_s)));
    bytes.insert(bytes.end(), rotation.begin(), rotation.end());
    return worker_->command(bytes);
}

bool ArcosClient::stop() {
    return worker_->command(encodeCommand(Command::EStop));
}

}  // namespace axon::arcos
