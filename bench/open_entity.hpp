// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <asio/strand.hpp>
#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "board.hpp"
#include "common/ids.hpp"
#include "entity_manager/links/server/entity_communicator.hpp"

namespace axon::bench {

/// What the thesis' changed server let clients do: everybody sends to it. An entity of the benchmark, with
/// the real sessions of an Entity Manager and none of its core: it grants every check-out to whoever asks, so
/// many clients hold it at once, takes everybody's data and signals and notes them on the board, and latches
/// nothing. There is no link to a robot application in it, so it can never be in front of a robot.
///
/// To the servers it is held by nobody, for its status names no holder: they route to it as to any other.
/// Threads: confined to the strand, but what the server pushes, on Ice's, one for each lane. Ownership:
/// shared, for pushes may be under way while it ends.
class OpenEntity final : public entity_manager::ServerEvents,
                         public std::enable_shared_from_this<OpenEntity> {
  public:
    static std::shared_ptr<OpenEntity> create(const asio::any_io_executor& executor,
                                              std::shared_ptr<entity_manager::ServerCommunicators> ice,
                                              const entity_manager::ServerAddress& server, const Clock& clock,
                                              RandomSource& random, std::string name, Slot& slot);
    void start();
    /// Sends this to each who holds it.
    void speak(const std::string& bytes);
    /// Registered at the server.
    bool joined() const { return joined_; }

    // ServerEvents.
    void serverUp() override;
    void serverDown(const std::string& reason) override;
    void clientMsg(Lane lane, Header head, std::string bytes) override;
    void clientMsgDataSeq(Header head, std::string bytes) override;
    void stopSignal(Header head, StopCause cause) override;
    void resetSignal(Header head) override { confirm(std::move(head), StopCause::Reset, generation_); }
    void clearSignal(Header head) override { confirm(std::move(head), StopCause::Clear, generation_); }
    void clientUpdate(Header, ClientChange) override {}
    void serverHeartbeat() override {}
    void undeliverable(Lane, Header, const Refusal&) override {}

  private:
    OpenEntity(const asio::any_io_executor& executor, std::string name, std::string uuid, Slot& slot);
    /// By two receipts, as an Entity Manager does: its own, and that there is no application.
    void confirm(Header head, StopCause cause, std::uint32_t generation);
    /// On the strand.
    void answer(const Header& head, const std::string& bytes);
    void tell(Lane lane, const Sender& to, const char* type, const proto::ToClient& message);
    Header headFor(const Sender& to, const char* type);

    const asio::strand<asio::any_io_executor> strand_;
    const std::string name_, uuid_;
    Slot& slot_;
    std::atomic<bool> joined_{false};
    std::atomic<std::uint32_t> generation_{0};
    std::uint32_t leases_ = 0;
    std::map<std::string, Sender> holders_;  // by id
    std::int64_t sequence_ = 0;
    std::unique_ptr<entity_manager::EntityCommunicator> server_;
};

}  // namespace axon::bench
