// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/camera_client.hpp"

#include <poll.h>

#include <array>
#include <atomic>
#include <condition_variable>
#include <mutex>
#include <thread>

#include "common/backoff.hpp"

namespace axon::peoplebot {
namespace {

constexpr Duration kConnectTimeout = std::chrono::seconds{1};
constexpr Duration kFirstPause = std::chrono::milliseconds{100};
constexpr Duration kLongestPause = std::chrono::seconds{2};
constexpr int kLook_ms = 50;  // how long the end of the program may have to wait

}  // namespace

class CameraClient::Worker {
  public:
    Worker(const std::string& address, Callbacks callbacks, bool wanted, std::shared_ptr<const Clock> clock)
        : open_(robots::tcpStreams(address)),
          address_(address),
          callbacks_(std::move(callbacks)),
          clock_(std::move(clock)),
          wanted_(wanted) {
        thread_ = std::thread([this] { run(); });
    }
    ~Worker() {
        {
            const std::lock_guard lock(mutex_);
            quit_ = true;
        }
        news_.notify_all();
        thread_.join();
    }

    void want(bool wanted) {
        if (wanted_ == wanted) return;
        {
            const std::lock_guard lock(mutex_);
            wanted_ = wanted;
        }
        news_.notify_all();
    }

    std::shared_ptr<const CameraPicture> newest() const {
        const std::lock_guard lock(mutex_);
        return newest_;
    }

  private:
    void run() {
        while (!quit_) {
            {
                std::unique_lock lock(mutex_);
                news_.wait(lock, [this] { return quit_ || wanted_; });
                if (quit_) return;
            }
            std::string reason;
            auto opened = open_(kConnectTimeout);
            if (opened) {
                reason = attend(*opened.value());
            } else {
                reason = opened.refusal().message;
            }
            if (quit_) return;
            if (!wanted_) continue;
            if (callbacks_.on_lost) callbacks_.on_lost(reason);
            std::unique_lock lock(mutex_);
            news_.wait_for(lock, pause_.next(), [this] { return quit_.load(); });
        }
    }

    /// One connection; why it ended.
    std::string attend(robots::ByteStream& stream) {
        const std::string request =
            "GET /raw HTTP/1.1\r\nHost: " + address_ + "\r\nConnection: close\r\n\r\n";
        if (!stream.write({reinterpret_cast<const std::uint8_t*>(request.data()), request.size()}))
            return "the camera at " + address_ + " does not take a request";
        reader_.reset();
        auto heard = clock_->now();
        while (!quit_ && wanted_) {
            pollfd waiting{stream.descriptor(), POLLIN, 0};
            ::poll(&waiting, 1, kLook_ms);
            const int got = stream.read(chunk_);
            const auto now = clock_->now();
            if (got < 0) return "the camera at " + address_ + " closed the connection";
            if (got == 0) {
                if (now - heard > kSilenceLimit) return "the camera at " + address_ + " is silent";
                continue;
            }
            heard = now;
            try {
                reader_.feed(std::span(chunk_).first(static_cast<std::size_t>(got)), now);
            } catch (const BadPicture& error) {
                return error.what();
            }
            if (auto picture = reader_.take())
                publish(std::make_shared<const CameraPicture>(std::move(*picture)));
        }
        return {};
    }

    void publish(const std::shared_ptr<const CameraPicture>& picture) {
        pause_.reset();
        {
            const std::lock_guard lock(mutex_);
            newest_ = picture;
        }
        if (callbacks_.on_picture) callbacks_.on_picture(picture);
    }

    // Constant after construction.
    const robots::StreamOpener open_;
    const std::string address_;
    const Callbacks callbacks_;
    const std::shared_ptr<const Clock> clock_;

    // Confined to the worker's thread.
    PictureReader reader_;
    std::array<std::uint8_t, 65536> chunk_;
    Backoff pause_{kFirstPause, kLongestPause};

    mutable std::mutex mutex_;
    std::condition_variable news_;                 // quit_ or wanted_ changed
    std::shared_ptr<const CameraPicture> newest_;  // guarded by mutex_
    std::atomic<bool> quit_ = false;               // written under mutex_
    std::atomic<bool> wanted_;                     // written under mutex_

    std::thread thread_;
};

CameraClient::CameraClient(const std::string& address, Callbacks callbacks, bool wanted,
                           std::shared_ptr<const Clock> clock)
    : worker_(std::make_unique<Worker>(address, std::move(callbacks), wanted, std::move(clock))) {}
CameraClient::~CameraClient() = default;
void CameraClient::want(bool wanted) {
    worker_->want(wanted);
}
std::shared_ptr<const CameraPicture> CameraClient::newest() const {
    return worker_->newest();
}

}  // namespace axon::peoplebot
