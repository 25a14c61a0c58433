// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <string>

#include "robots/common/byte_stream.hpp"
#include "robots/peoplebot/camera_picture.hpp"

namespace axon::peoplebot {

/// The robot's camera over HTTP: asks for GET /raw and keeps the newest picture; after a loss it tries again
/// for ever (after 100 ms, doubling up to 2 s). It is connected only while somebody wants pictures, since a
/// camera that nobody watches costs nothing.
///
/// Threads: one of its own, on which the callbacks run; newest() may be called from any thread. A picture is
/// immutable once it is published. Failure: a camera that says nothing for kSilenceLimit, and one that sends
/// what is no picture, count as lost. The constructor throws std::invalid_argument for what is not host:port.
class CameraClient {
  public:
    static constexpr Duration kSilenceLimit = std::chrono::seconds{3};

    struct Callbacks {
        std::function<void(const std::shared_ptr<const CameraPicture>&)>
            on_picture{};  ///< every one that is read
        std::function<void(const std::string& reason)>
            on_lost{};  ///< also for each failed attempt to connect
    };

    CameraClient(const std::string& address, Callbacks callbacks, bool wanted = true,
                 std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>());
    ~CameraClient();
    CameraClient(const CameraClient&) = delete;
    CameraClient& operator=(const CameraClient&) = delete;

    /// Whether pictures are wanted from now on. Any thread; returns at once.
    void want(bool wanted);
    /// None before the first. Look at its time: it stays when the camera is lost.
    std::shared_ptr<const CameraPicture> newest() const;

  private:
    class Worker;
    std::unique_ptr<Worker> worker_;
};

}  // namespace axon::peoplebot
