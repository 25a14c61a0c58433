// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/stream_thread.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <mutex>
#include <system_error>
#include <thread>

#include "common/backoff.hpp"
#include "common/descriptor.hpp"

namespace axon::robots {
namespace {

constexpr Duration kConnectTimeout = std::chrono::seconds{1};
constexpr Duration kFirstPause = std::chrono::milliseconds{100};
constexpr Duration kLongestPause = std::chrono::seconds{2};
constexpr Duration kTick = std::chrono::milliseconds{25};

class EventDescriptor {
  public:
    EventDescriptor() : fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
        if (!fd_.open()) throw std::system_error(errno, std::generic_category(), "eventfd");
    }
    int get() const { return fd_.get(); }
    void raise() const {
        const std::uint64_t one = 1;
        [[maybe_unused]] const auto written = ::write(fd_.get(), &one, sizeof one);
    }
    void lower() const {
        std::uint64_t raised = 0;
        [[maybe_unused]] const auto got = ::read(fd_.get(), &raised, sizeof raised);
    }

  private:
    const Descriptor fd_;
};

}  // namespace

class StreamThread::Loop {
  public:
    Loop(StreamOpener open, Session& session, std::string peer, std::shared_ptr<const Clock> clock)
        : open_(std::move(open)), session_(session), peer_(std::move(peer)), clock_(std::move(clock)) {}

    void start() {
        thread_ = std::thread([this] { run(); });
    }

    void finish() {
        quit_ = true;
        wake_.raise();
        if (thread_.joinable()) thread_.join();
    }
    bool finishing() const { return quit_; }

    bool write(std::span<const std::uint8_t> bytes) {
        const std::lock_guard lock(link_mutex_);
        if (!link_) return false;
        if (link_->write(bytes)) return true;
        broken_ = true;
        wake_.raise();
        return false;
    }

    void succeeded() { pause_.reset(); }
    LineSpeed speed() const { return link_ ? link_->speed() : LineSpeed(); }
    bool setSpeed(int baud) {
        const std::lock_guard lock(link_mutex_);
        return link_ && link_->setSpeed(baud);
    }

  private:
    void run() {
        while (!quit_) {
            auto opened = open_(kConnectTimeout);
            if (opened)
                attend(std::move(opened).value());
            else
                session_.unreachable(opened.refusal().message);
            if (quit_) return;
            waitFor(-1, pause_.next());
        }
    }

    /// One link, from begin() to its end.
    void attend(std::unique_ptr<ByteStream> stream) {
        const int fd = stream->descriptor();
        {
            const std::lock_guard lock(link_mutex_);
            link_ = std::move(stream);
            broken_ = false;
        }
        session_.begin(clock_->now());
        std::array<std::uint8_t, 2048> chunk;
        while (!quit_ && !session_.closed()) {
            waitFor(fd, clock_->realTimeUntil(clock_->now() + kTick));
            const int got = link_->read(chunk);
            if (got > 0)
                session_.receive(std::span(chunk).first(static_cast<std::size_t>(got)), clock_->now());
            if (got < 0) session_.end(peer_ + " closed the connection");
            if (broken_) session_.end("the connection to " + peer_ + " takes no more bytes");
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
    Session& session_;
    const std::string peer_;
    const std::shared_ptr<const Clock> clock_;
    const EventDescriptor wake_;

    Backoff pause_{kFirstPause, kLongestPause};  // confined to the thread

    std::atomic<bool> quit_ = false;
    std::atomic<bool> broken_ = false;

    std::mutex link_mutex_;             // held for one write that does not wait
    std::unique_ptr<ByteStream> link_;  // replaced under link_mutex_, by the thread only

    std::thread thread_;
};

StreamThread::StreamThread(StreamOpener open, Session& session, std::string peer,
                           std::shared_ptr<const Clock> clock)
    : loop_(std::make_unique<Loop>(std::move(open), session, std::move(peer), std::move(clock))) {}
StreamThread::~StreamThread() {
    finish();
}
void StreamThread::start() {
    loop_->start();
}
void StreamThread::finish() {
    loop_->finish();
}
bool StreamThread::finishing() const {
    return loop_->finishing();
}
bool StreamThread::write(std::span<const std::uint8_t> bytes) {
    return loop_->write(bytes);
}
void StreamThread::succeeded() {
    loop_->succeeded();
}
LineSpeed StreamThread::speed() const {
    return loop_->speed();
}
bool StreamThread::setSpeed(int baud) {
    return loop_->setSpeed(baud);
}

}  // namespace axon::robots
