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
#include "client/connection/communicators.hpp"
#include "client/connection/server_connection.hpp"
#include "client/direct/direct_path.hpp"
#include "client/direct/framed_lane.hpp"
#include "client/direct/lane_readers.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/outbox/outbox.hpp"

namespace axon::client {

/// A direct path over the network: frames on the data lane, read by the session's LaneReaders, and Ice on the
/// signal lane, on the communicator of the session. Both are TLS where the endpoints say so: then each is
/// used only once whoever answers has shown the entity's certificate. Nothing waits: each lane is opened by
/// what answers, what is sent goes to the socket from the caller's thread or into the lane's outbox.
class NetworkPath final : public DirectPath,
                          private FramedLane::Owner,
                          public std::enable_shared_from_this<NetworkPath> {
  public:
    /// `secured`: what paths over TLS need; null: there are none.
    NetworkPath(std::shared_ptr<LaneReaders> readers, const LaneHome& signal, DirectOffer offer, Id128 number,
                std::shared_ptr<Backlog> backlog, const Clock& clock, std::weak_ptr<DirectPathEvents> events,
                std::shared_ptr<Communicators> secured = nullptr);
    ~NetworkPath() override;

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
    struct SignalLane {
        std::shared_ptr<Axon::DirectComm::DirectGatePrx> gate;
        std::shared_ptr<transport::DirectConnection> connection;
        std::shared_ptr<Axon::DirectComm::DirectSessionPrx> session;  // oneway
        std::shared_ptr<transport::Outbox> outbox;
        Ice::Identity callback;
    };

    // FramedLane::Owner.
    void laneOpen() override { openSignals(); }
    void laneMessage(const direct::lane::MessageView& message) override;
    void laneRead() override;
    void laneOver(const std::string& why) override { close(why); }

    bool overTls() const { return DirectOffer::overTls(offer_.data_endpoint); }
    std::unique_ptr<direct::lane::Channel> channelOver(direct::lane::Wire& socket) const;
    void openSignals();
    void challenged(const Axon::CommUtil::Bytes& nonce);
    void opened(const Axon::DirectComm::Opened& its);
    std::function<void(std::exception_ptr)> failure();
    template <class Use>
    void step(Use use);
    template <class Send>
    void post(transport::Traffic traffic, Send send) const;

    const std::shared_ptr<LaneReaders> readers_;
    const LaneHome plain_home_;  // of signals
    const std::shared_ptr<Communicators> secured_;
    const std::shared_ptr<Backlog> backlog_;
    const std::weak_ptr<DirectPathEvents> events_;
    int timeout_ms_ = 0;
    // Each written by one step of the opening, and read after open_ by others.
    LaneHome home_;
    std::shared_ptr<FramedLane> data_;
    SignalLane signal_;
    mutable std::mutex mutex_;
    // Guarded by mutex_: what is to be closed, as far as it is there, and why it was.
    std::vector<std::function<void(const std::string& why)>> closing_;
    std::string reason_;
};

}  // namespace axon::client
