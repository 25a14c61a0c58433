// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>
#include <axon/directcomm.h>

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "client/connection/backlog.hpp"
#include "client/connection/server_connection.hpp"
#include "client/direct/direct_path.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/outbox/outbox.hpp"

namespace axon::client {

/// A direct path over Ice, on the communicators of the session. Nothing waits: it is opened by asynchronous
/// calls, what is sent goes to the socket from the caller's thread or into the lane's outbox.
class IceDirectPath final : public DirectPath, public std::enable_shared_from_this<IceDirectPath> {
  public:
    IceDirectPath(const LaneHome& data, const LaneHome& signal, DirectOffer offer, Id128 number,
                  std::shared_ptr<Backlog> backlog, const Clock& clock,
                  std::weak_ptr<DirectPathEvents> events);
    ~IceDirectPath() override;

    void open(Duration timeout) override;
    std::string reason() const override;
    void close(const std::string& why) override;
    void send(direct::Keeping keeping, const Header& head,
              std::shared_ptr<const std::string> message) const override;
    void sendStopSignal(const Header& head, StopCause cause) const override;
    void sendResetSignal(const Header& head) const override;
    void sendClearSignal(const Header& head) const override;
    void beat() const override;

  private:
    class Callback;
    struct LaneEnd {
        std::shared_ptr<Axon::DirectComm::DirectGatePrx> gate;
        std::shared_ptr<transport::DirectConnection> connection;
        std::shared_ptr<Axon::DirectComm::DirectSessionPrx> session;  // oneway
        std::shared_ptr<transport::Outbox> outbox;
        Ice::Identity callback;
    };
    void openLane(Lane lane);
    void challenged(Lane lane, const Axon::CommUtil::Bytes& nonce);
    void opened(Lane lane, const Axon::DirectComm::Opened& its);
    LaneEnd& end(Lane lane) { return lane == Lane::Data ? data_ : signal_; }
    const LaneHome& home(Lane lane) const { return lane == Lane::Data ? data_home_ : signal_home_; }
    std::function<void(std::exception_ptr)> failure();
    template <class Use>
    void step(Use use);
    template <class Send>
    void post(transport::Traffic traffic, Send send) const;

    const LaneHome data_home_, signal_home_;
    const std::shared_ptr<Backlog> backlog_;
    const std::weak_ptr<DirectPathEvents> events_;
    int timeout_ms_ = 0;
    // Each written by one step of the opening, and read after open_ by others.
    LaneEnd data_, signal_;
    mutable std::mutex mutex_;
    // Guarded by mutex_: what is to be closed, as far as it is there, and why it was.
    std::vector<std::shared_ptr<transport::DirectConnection>> connections_;
    std::string reason_;
};

}  // namespace axon::client
