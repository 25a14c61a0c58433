// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/ssc32/ssc32_client.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <mutex>
#include <system_error>
#include <thread>

namespace axon::ssc32 {
namespace {

constexpr Duration kConnectTimeout = std::chrono::seconds{1};
constexpr Duration kFirstPause = std::chrono::milliseconds{100};
constexpr Duration kLongestPause = std::chrono::seconds{2};
constexpr Duration kTick = std::chrono::milliseconds{20};

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

class Ssc32Client::Worker final : public ClientSession::Port {
  public:
    Worker(arcos::StreamOpener open, std::vector<std::size_t> channels, Callbacks callbacks,
           Duration silence_limit, std::shared_ptr<const Clock> clock)
        : open_(std::move(open)),
          callbacks_(std::move(callbacks)),
          clock_(std::move(clock)),
          session_(*this, std::move(channels), silence_limit) {}

    ~Worker() override {
        quit_ = true;
        wake_.raise();
        if (thread_.joinable()) thread_.join();
    }

    void start() {
        thread_ = std::thread([this] { run(); });
    }

    bool online() const {
        const std::lock_guard lock(link_mutex_);
        return online_;
    }

    bool sendLines(const std::string& lines) {
        const std::lock_guard lock(link_mutex_);
        return online_ && write(lines);
    }

    void askPulses() { pulses_wanted_ = true; }

    // ClientSession::Port, on the worker's own thread.
    void send(const std::string& bytes) override {
        const std::lock_guard lock(link_mutex_);
        write(bytes);
    }
    void onOnline(const std::vector<int>& pulses_us) override {
        {
            const std::lock_guard lock(link_mutex_);
            online_ = true;
        }
        pause_ = kFirstPause;
        if (callbacks_.on_online) callbacks_.on_online(pulses_us);
    }
    void onPulses(const std::vector<int>& pulses_us) override {
        if (callbacks_.on_pulses) callbacks_.on_pulses(pulses_us);
    }
    void onStatus(bool moving) override {
        if (callbacks_.on_status) callbacks_.on_status(moving);
    }
    void onLost(const std::string& reason) override {
        {
            const std::lock_guard lock(link_mutex_);
            online_ = false;
        }
        if (callbacks_.on_lost && !quit_) callbacks_.on_lost(reason);
    }

  private:
    bool write(const std::string& bytes) {
        if (!link_) return false;
        if (link_->write({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()})) return true;
        broken_ = true;
        wake_.raise();
        return false;
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
    void attend(std::unique_ptr<arcos::ByteStream> stream) {
        const int fd = stream->descriptor();
        {
            const std::lock_guard lock(link_mutex_);
            link_ = std::move(stream);
            broken_ = false;
        }
        session_.begin(clock_->now());
        std::array<std::uint8_t, 256> chunk;
        while (!quit_ && session_.state() != ClientSession::State::Closed) {
            waitFor(fd, clock_->realTimeUntil(clock_->now() + kTick));
            const int got = link_->read(chunk);
            if (got > 0)
                session_.receive(std::span(chunk).first(static_cast<std::size_t>(got)), clock_->now());
            if (got < 0) session_.end("the controller closed the connection");
            if (broken_) session_.end("the connection to the controller does not take any more bytes");
            if (pulses_wanted_.exchange(false)) session_.askPulses();
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
    const arcos::StreamOpener open_;
    const Callbacks callbacks_;
    const std::shared_ptr<const Clock> clock_;
    const EventDescriptor wake_;

    // Confined to the worker's thread.
    ClientSession session_;
    Duration pause_ = kFirstPause;

    std::atomic<bool> quit_ = false;
    std::atomic<bool> broken_ = false;
    std::atomic<bool> pulses_wanted_ = false;

    mutable std::mutex link_mutex_;            // held for one non-blocking write
    std::unique_ptr<arcos::ByteStream> link_;  // replaced under link_mutex_, by the worker's thread only
    bool online_ = false;                      // guarded by link_mutex_

    std::thread thread_;
};

Ssc32Client::Ssc32Client(arcos::StreamOpener open, std::vector<std::size_t> channels, Callbacks callbacks,
                         Duration silence_limit, std::shared_ptr<const Clock> clock)
    : worker_(std::make_unique<Worker>(std::move(open), std::move(channels), std::move(callbacks),
                                       silence_limit, std::move(clock))) {}
Ssc32Client::~Ssc32Client() = default;
void Ssc32Client::start() {
    worker_->start();
}
bool Ssc32Client::online() const {
    return worker_->online();
}
bool Ssc32Client::send(const std::string& lines) {
    return worker_->sendLines(lines);
}
void Ssc32Client::askPulses() {
    worker_->askPulses();
}

}  // namespace axon::ssc32
