// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "client/direct/lane_readers.hpp"
#include "common/frame.hpp"
#include "direct/lane/channel.hpp"
#include "direct/lane/lane_outbox.hpp"
#include "direct/lane/lane_socket.hpp"
#include "direct/lane/opening.hpp"

namespace axon::client {

/// The data lane of one direct path at the client: frames over TCP or TLS (docs/reference/direct.md).
///
/// Where in the flow: below NetworkPath. States: being opened ─► open ─► over, or at once over. Threads:
/// send() and end() from any; what comes, on one of the readers' threads, one at a time and in order.
/// Ownership: shared, held by the readers until it is over. Failure: it is over, and its owner is told why,
/// once.
class FramedLane final : public LaneReaders::Lane, public std::enable_shared_from_this<FramedLane> {
  public:
    class Owner {
      public:
        virtual ~Owner() = default;
        virtual void laneOpen() = 0;
        virtual void laneMessage(const direct::lane::MessageView& message) = 0;
        /// What had come has been told, and the other thread may read while this one is here.
        virtual void laneRead() = 0;
        virtual void laneOver(const std::string& why) = 0;
    };

    /// What is to be spoken over the socket, which outlives it.
    using Speaks = std::function<std::unique_ptr<direct::lane::Channel>(direct::lane::Wire& socket)>;

    FramedLane(std::shared_ptr<LaneReaders> readers, Descriptor socket, const Speaks& speaks,
               direct::lane::ClientOpening opening, transport::OutboxLimits limits,
               direct::lane::LaneOutbox::Waits waits, const Clock& clock, std::weak_ptr<Owner> owner);

    /// Once. `timeout`: of the connection with the first answer, and of the second answer.
    void start(Duration timeout);
    void send(direct::Keeping keeping, const Header& head, const std::shared_ptr<const std::string>& message);
    /// At once; what is unsent is lost.
    void end(const std::string& why);

    // LaneReaders::Lane.
    int descriptor() const override { return socket_.descriptor(); }
    void ready(LaneReaders::Ready what) override;
    void overdue() override { end("no answer in time"); }

  private:
    bool readAll(Owner& owner, int& reads);
    bool heard(Owner& owner, std::size_t count);
    bool deliver(Owner& owner);
    bool onOpening(std::string_view frame, Owner& owner);

    const std::shared_ptr<LaneReaders> readers_;
    const std::uint64_t number_;  // there
    const Clock& clock_;
    const std::weak_ptr<Owner> owner_;
    Duration timeout_{};  // constant after start()

    direct::lane::LaneSocket socket_;
    const std::unique_ptr<direct::lane::Channel> channel_;
    direct::lane::LaneOutbox outbox_;
    std::atomic<bool> channel_open_{false};
    std::atomic<bool> over_{false};
    std::atomic<bool> closing_{false};   // the other end has, perhaps with something left to read
    std::atomic<unsigned> arrivals_{0};  // that are to be read; who makes it 1 reads until it is 0

    // Of who reads:
    direct::lane::ClientOpening opening_;
    FrameReader reader_{direct::lane::kOpeningMax};
};

}  // namespace axon::client
