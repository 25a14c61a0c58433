// SPDX-License-Identifier: MIT
#pragma once
#include <axon/link.pb.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

#include "common/descriptor.hpp"
#include "common/frame.hpp"
#include "host/wake_up.hpp"

namespace axon::testing {

/// Where a robot application is, and what it is told at the beginning of a link.
struct LinkTarget {
    std::string application, instance;
    std::string address;
    std::uint16_t first_port = 0, last_port = 0;
    std::chrono::milliseconds watchdog{};
};

/// Both connections of one link, at the end of the Entity Manager (docs/reference/ei-link.md).
///
/// Threads: any may send; one of its own reads, beats and calls the events, which must not destroy it.
/// Failure: the constructor throws Failure; what ends the link later is told once, by `closed`.
class LinkConnection {
  public:
    struct Events {
        std::function<void(const proto::EiToEm&)> message;  ///< all but beats
        std::function<void(const std::string& why)> closed;
    };

    /// Looks for the application until it has a link or the time is up.
    LinkConnection(const LinkTarget& target, std::uint32_t generation, Events events,
                   std::chrono::milliseconds within);
    ~LinkConnection();
    LinkConnection(const LinkConnection&) = delete;
    LinkConnection& operator=(const LinkConnection&) = delete;

    void sendSignal(const proto::EmToEi& message);
    void sendData(const proto::EmToEi& message);
    /// What the beats say from now on.
    void setGeneration(std::uint32_t generation) { generation_ = generation; }
    /// Without beats, the application's watchdog trips.
    void setBeating(bool beating);
    std::uint16_t port() const { return port_; }

  private:
    struct Lane {
        Descriptor socket;
        FrameReader reader;
        std::mutex mutex;  // of those who send
    };
    void search(const LinkTarget& target, std::chrono::milliseconds within);
    void run();
    void beat();
    bool read(Lane& lane);
    bool handle(Lane& lane);
    void send(Lane& lane, const proto::EmToEi& message);

    const Events events_;
    const std::chrono::milliseconds beat_every_;
    std::uint16_t port_ = 0;
    Lane signal_, data_;
    WakeUp wake_;
    std::atomic<std::uint32_t> generation_;
    std::atomic<bool> beating_{true}, ending_{false}, closed_{false};
    std::string last_words_;  // of the reading thread: why the application ends the link
    std::uint64_t beats_ = 0;
    std::thread thread_;
};

}  // namespace axon::testing
