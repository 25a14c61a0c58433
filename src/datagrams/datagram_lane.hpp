// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <functional>
#include <string>
#include <string_view>
#include <thread>

#include "common/clock.hpp"
#include "common/descriptor.hpp"
#include "datagrams/endpoint.hpp"
#include "host/wake_up.hpp"

namespace axon::datagrams {

/// A UDP socket with a thread that reads it and calls at times, for either end of the stop as a datagram.
///
/// The thread asks for SCHED_RR like those of the signal lane, and is an ordinary one where that is not
/// permitted. It calls `received` for each datagram, which says whether it was worth anything: after 64 in a
/// row that were not, the thread rests for a millisecond, so that a flood cannot take a whole core from the
/// robot. It calls `due`, where there is one, after each round and when woken; the answer is when it wants to
/// be called next. Ownership: the destructor joins the thread, so it must not run on it. Failure: the
/// constructor throws std::system_error where the address cannot be bound; a datagram that cannot be sent is
/// lost like any other.
class DatagramLane {
  public:
    using Received =
        std::function<bool(const DatagramLane& lane, const Endpoint& from, std::string_view bytes)>;
    using Due = std::function<TimePoint(const DatagramLane& lane)>;

    /// Port 0 takes a free one.
    DatagramLane(std::string thread_name, Endpoint bind, const Clock& clock, Received received, Due due);
    ~DatagramLane();
    DatagramLane(const DatagramLane&) = delete;
    DatagramLane& operator=(const DatagramLane&) = delete;

    /// Any thread, does not wait; also from inside the callbacks.
    void send(const Endpoint& to, std::string_view bytes) const;
    /// `due` wants to be called earlier than it said. Any thread.
    void wake() const;
    const Endpoint& local() const { return local_; }

  private:
    void run();
    bool readSome();
    void rest(Duration time) const;

    const std::string thread_name_;
    const Clock& clock_;
    const Received received_;
    const Due due_;
    Descriptor socket_;
    WakeUp wake_;
    Endpoint local_;
    int refused_in_a_row_ = 0;  // confined to the thread
    std::atomic<bool> ending_{false};
    std::thread thread_;
};

}  // namespace axon::datagrams
