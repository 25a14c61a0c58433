// SPDX-License-Identifier: GPL-2.0-or-later
// Two Entity Managers' ways to the server, and what one sends the other by them.
#include <gtest/gtest.h>

#include <axon/messages.pb.h>
#include <axon/profile.pb.h>
#include <asio/io_context.hpp>
#include <asio/post.hpp>
#include <asio/strand.hpp>

#include <thread>

#include "component/any_ports.hpp"
#include "component/raw_peers.hpp"
#include "entity_manager/links/server/entity_communicator.hpp"
#include "entity_manager/links/server/server_communicators.hpp"

namespace axon::test {
namespace {

using entity_manager::EntityCommunicator;

/// Registers itself when there is a session, and writes down what comes.
class Peer final : public entity_manager::ServerEvents, public std::enable_shared_from_this<Peer> {
  public:
    Peer(asio::io_context& executor, std::string uuid, std::string name)
        : strand_(asio::make_strand(executor)), name_(std::move(name)) {
        registration_.entity = std::move(uuid);
        registration_.name = name_;
    }
    void start(const std::shared_ptr<entity_manager::ServerCommunicators>& ice, std::uint16_t port) {
        way_ = std::make_unique<EntityCommunicator>(
            strand_, ice, entity_manager::ServerAddress{loopbackAddress(), port, name_, ""}, clock_,
            weak_from_this());
        asio::post(strand_, [this] { way_->wantConnection(true); });
    }
    void send(Lane lane, const std::string& to, const std::string& text) {
        asio::post(strand_, [this, lane, to, text] {
            Header head;
            head.entity = to;
            head.msg_type = kMsgCollaboration;
            proto::ToEntity message;
            message.mutable_text()->set_text(text);
            way_->sendToPeer(lane, head, message);
        });
    }

    void serverUp() override { way_->sendBasicPrfl(registration_, proto::BasicProfile()); }
    void serverDown(const std::string&) override {}
    void clientMsg(Lane lane, Header head, std::string bytes) override {
        proto::ToEntity message;
        message.ParseFromString(bytes);
        log.add((lane == Lane::Signal ? "signal from " : "data from ") + head.sender.id + ": " +
                message.text().text());
    }
    void clientMsgDataSeq(Header, std::string) override {}
    void stopSignal(Header, StopCause) override {}
    void resetSignal(Header) override {}
    void clearSignal(Header) override {}
    void clientUpdate(Header, ClientChange) override {}
    void serverHeartbeat() override {}
    void undeliverable(Lane lane, Header head, const Refusal& refusal) override {
        log.add((lane == Lane::Signal ? "signal refused " : "data refused ") + head.entity + " " +
                std::string(refusalName(refusal.code)));
    }

    Log log;

  private:
    asio::strand<asio::io_context::executor_type> strand_;
    const std::string name_;
    const SteadyClock clock_{};
    Registration registration_;
    std::unique_ptr<EntityCommunicator> way_;
};

TEST(Peers, AnEntityManagerReachesAnotherOnBothLanesAndHearsOfWhatDidNotArrive) {
    server::Server server(onLoopback());
    const auto address = server.entityAddress(Lane::Data);
    const auto port = static_cast<std::uint16_t>(std::stoi(address.substr(address.rfind(':') + 1)));

    asio::io_context executor;
    const auto work = asio::make_work_guard(executor);
    std::thread thread([&] { executor.run(); });
    {
        const auto ice = std::make_shared<entity_manager::ServerCommunicators>();
        const auto master = std::make_shared<Peer>(executor, kFirst, "Master");
        const auto slave = std::make_shared<Peer>(executor, kSecond, "Slave");
        master->start(ice, port);
        slave->start(ice, port);
        EXPECT_TRUE(waitUntil([&] { return server.entityCore().entities() == 2; }));
        master->send(Lane::Data, kSecond, "step");
        EXPECT_TRUE(waitUntil([&] { return slave->log.has(std::string("data from ") + kFirst + ": step"); }));
        master->send(Lane::Signal, kSecond, "beat");
        EXPECT_TRUE(
            waitUntil([&] { return slave->log.has(std::string("signal from ") + kFirst + ": beat"); }));
        master->send(Lane::Data, "nobody", "step");
        EXPECT_TRUE(waitUntil([&] { return master->log.has("data refused nobody UNKNOWN_ENTITY"); }));
        master->send(Lane::Signal, "nobody", "beat");
        EXPECT_TRUE(waitUntil([&] { return master->log.has("signal refused nobody UNKNOWN_ENTITY"); }));
        ice->destroy();
        executor.stop();
        thread.join();  // the communicators are destroyed where their strands no longer run
    }
}

}  // namespace
}  // namespace axon::test
