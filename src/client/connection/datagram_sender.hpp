// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

#include "common/clock.hpp"
#include "common/routed.hpp"
#include "datagrams/datagram_lane.hpp"
#include "datagrams/stop_repeater.hpp"

namespace axon::client {

/// Sends stops as datagrams too, straight to the Entity Managers that this client holds leases of
/// (docs/reference/datagrams.md).
///
/// Where in the flow: beside ServerConnection, on the way of a stop. StopRepeater decides what is sent when;
/// this gives it a socket, a thread of the signal lane and a lock of its own, which nothing holds for longer
/// than an entry in a table. States: without a socket until the first Entity Manager offers datagrams.
/// Threads: any; `acknowledged` is called on the datagram thread, with no lock held. Failure: logged once;
/// stops travel by TCP in any case.
class DatagramSender {
  public:
    using Acknowledged = std::function<void(const datagrams::StopRepeater::Acknowledged&)>;

    DatagramSender(const Clock& clock, Acknowledged acknowledged);
    ~DatagramSender();
    DatagramSender(const DatagramSender&) = delete;
    DatagramSender& operator=(const DatagramSender&) = delete;

    /// A lease was granted or resumed by the session `sender`; an endpoint that is empty or no address ends
    /// it.
    void admit(const std::string& entity, LeaseNumber lease, std::string_view endpoint,
               const std::string& key, std::string_view sender);
    void forget(const std::string& entity, LeaseNumber lease);
    /// Of one entity, or ("") of all that are held here. The first copies are sent before it returns.
    void stop(const std::string& entity, std::int64_t sequence, std::int32_t generation);
    /// Joins the thread. Nothing is sent afterwards. Must not be called on that thread.
    void close();

  private:
    bool received(const datagrams::Endpoint& from, std::string_view bytes);
    TimePoint onDue(const datagrams::DatagramLane& lane);
    std::shared_ptr<datagrams::DatagramLane> lane();

    const Clock& clock_;
    const Acknowledged acknowledged_;
    std::mutex mutex_;
    // Guarded by mutex_:
    datagrams::StopRepeater repeater_;
    std::shared_ptr<datagrams::DatagramLane> lane_;
    bool failed_ = false;
    bool closed_ = false;
};

}  // namespace axon::client
