// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/server/entity_communicator.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <axon/entitycomm.h>
#include <axon/messages.pb.h>
#include <axon/profile.pb.h>
#include <asio/io_context.hpp>
#include <asio/post.hpp>
#include <asio/strand.hpp>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <vector>

#include "entity_manager/links/server/server_communicators.hpp"
#include "support/log_lines.hpp"
#include "support/loopback.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"
#include "transport/sessions/fake_router.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using test::waitUntil;
using transport::ByteRange;
namespace slice = ::Axon::EntityComm;
namespace wire = ::Axon::CommUtil;

/// What a server was sent, in the order in which it read it.
struct Read {
    enum class Kind { Registration, Status, Control, Data, Raw, Receipt, Beat, Leave } kind;
    std::int64_t number = 0;
    bool operator==(const Read&) const = default;
};

/// Shared by the servants of both lanes. While it is held, the data lane reads nothing. Threads: any.
class ServerLog {
  public:
    void hold(bool held) {
        const std::lock_guard lock(mutex_);
        held_ = held;
        changed_.notify_all();
    }
    void add(Lane lane, Read read) {
        std::unique_lock lock(mutex_);
        if (lane == Lane::Data) changed_.wait(lock, [this] { return !held_; });
        read_.push_back(read);
    }
    std::vector<std::int64_t> numbers(Read::Kind kind) const {
        const std::lock_guard lock(mutex_);
        std::vector<std::int64_t> found;
        for (const auto& read : read_)
            if (read.kind == kind) found.push_back(read.number);
        return found;
    }
    std::vector<Read> all() const {
        const std::lock_guard lock(mutex_);
        return read_;
    }
    void attached(std::shared_ptr<slice::EntityCallbackPrx> callback) {
        const std::lock_guard lock(mutex_);
        callback_ = std::move(callback);
    }
    /// Of the signal lane.
    std::shared_ptr<slice::EntityCallbackPrx> callback() const {
        const std::lock_guard lock(mutex_);
        return callback_;
    }
    bool has(Read read) const {
        const auto read_until_now = all();
        return std::find(read_until_now.begin(), read_until_now.end(), read) != read_until_now.end();
    }

  private:
    mutable std::mutex mutex_;
    std::condition_variable changed_;
    std::vector<Read> read_;  // guarded by mutex_
    std::shared_ptr<slice::EntityCallbackPrx> callback_;
    bool held_ = false;  // guarded by mutex_
};

class Session final : public slice::EntitySession {
  public:
    Session(Lane lane, std::string signal_endpoint, ServerLog& log)
        : lane_(lane), signal_endpoint_(std::move(signal_endpoint)), log_(log) {}
    slice::SessionFacts setCallback(std::shared_ptr<slice::EntityCallbackPrx>, const Ice::Current&) override {
        return {"token", signal_endpoint_};
    }
    void attachSignalLane(std::string, std::shared_ptr<slice::EntityCallbackPrx> callback,
                          const Ice::Current& current) override {
        log_.attached(Ice::uncheckedCast<slice::EntityCallbackPrx>(
            current.con->createProxy(callback->ice_getIdentity())));
    }
    void sendBasicPrfl(wire::Registration registration, ByteRange, ByteRange, const Ice::Current&) override {
        log_.add(lane_, {Read::Kind::Registration, registration.heartbeatIdleMs});
    }
    void sendStatus(wire::EntityStatus status, const Ice::Current&) override {
        log_.add(lane_, {Read::Kind::Status, status.stopGeneration});
    }
    void sendToClient(wire::Header head, ByteRange, const Ice::Current&) override {
        add(lane_ == Lane::Signal ? Read::Kind::Receipt : Read::Kind::Control, std::move(head));
    }
    void sendToClientDataSeq(wire::Header head, ByteRange, const Ice::Current&) override {
        add(Read::Kind::Data, std::move(head));
    }
    void sendToPeer(wire::Header head, ByteRange, const Ice::Current&) override {
        add(Read::Kind::Raw, std::move(head));
    }
    void keepAlive(double, const Ice::Current&) override { log_.add(lane_, {Read::Kind::Beat}); }
    void leave(const Ice::Current&) override { log_.add(lane_, {Read::Kind::Leave}); }
    void destroy(const Ice::Current&) override {}

  private:
    void add(Read::Kind kind, wire::Header&& head) const {
        log_.add(lane_, {kind, transport::fromIce(std::move(head)).sequence});
    }
    const Lane lane_;
    const std::string signal_endpoint_;
    ServerLog& log_;
};

class Gate final : public slice::EntityGate {
  public:
    Gate(Lane lane, std::string signal_endpoint, ServerLog& log)
        : lane_(lane), signal_endpoint_(std::move(signal_endpoint)), log_(log) {}
    void openAsync(std::string, std::string,
                   std::function<void(const std::shared_ptr<slice::EntitySessionPrx>&)> opened,
                   std::function<void(std::exception_ptr)>, const Ice::Current& current) override {
        opened(Ice::uncheckedCast<slice::EntitySessionPrx>(
            current.adapter->addWithUUID(std::make_shared<Session>(lane_, signal_endpoint_, log_))));
    }

  private:
    const Lane lane_;
    const std::string signal_endpoint_;
    ServerLog& log_;
};

/// A router with the server's servants in it: whoever logs in has a session at once.
class Router final : public transport::FakeRouter {
  public:
    Router(std::shared_ptr<Ice::ObjectAdapter> adapter, ServerLog& log)
        : adapter_(std::move(adapter)), log_(log) {}
    void createSessionAsync(std::string, std::string,
                            std::function<void(const std::shared_ptr<Glacier2::SessionPrx>&)> opened,
                            std::function<void(std::exception_ptr)>, const Ice::Current&) override {
        ++sessions;
        opened(Ice::uncheckedCast<Glacier2::SessionPrx>(
            adapter_->addWithUUID(std::make_shared<Session>(Lane::Data, "", log_))));
    }
    std::shared_ptr<Ice::ObjectPrx> getServerProxy(const Ice::Current&) const override {
        return adapter_->createProxy(Ice::stringToIdentity("back"));
    }

    std::atomic<int> sessions{0};

  private:
    const std::shared_ptr<Ice::ObjectAdapter> adapter_;
    ServerLog& log_;
};

/// An Entity Manager's way to a server whose data lane can be held up: a thread for each lane, so that a lane
/// whose call waits reads nothing.
class EntityCommunicatorTest : public testing::Test {
  protected:
    class Events final : public ServerEvents {
      public:
        void serverUp() override { ++up; }
        void serverDown(const std::string& reason) override {
            const std::lock_guard lock(mutex_);
            downs_.push_back(reason);
        }
        void clientMsg(Lane, Header, std::string) override {}
        void clientMsgDataSeq(Header, std::string) override {}
        void stopSignal(Header, StopCause) override {}
        void resetSignal(Header) override {}
        void clearSignal(Header) override {}
        void clientUpdate(Header, ClientChange) override {}
        void serverHeartbeat() override {}
        void undeliverable(Lane, Header, const Refusal&) override {}
        std::vector<std::string> downs() const {
            const std::lock_guard lock(mutex_);
            return downs_;
        }
        std::atomic<int> up{0};

      private:
        mutable std::mutex mutex_;
        std::vector<std::string> downs_;  // guarded by mutex_
    };

    void SetUp() override {
        const auto any_port = transport::tcpEndpoint(test::loopbackAddress() + ":0");
        const auto signal = transport::listen(*server_.communicator(), "Signal", any_port);
        const auto data = transport::listen(*server_.communicator(), "Data", any_port);
        const auto signal_endpoint = transport::tcpEndpoint(transport::addressOf(*signal));
        const auto name = Ice::stringToIdentity("EntityGate");
        data->add(std::make_shared<Gate>(Lane::Data, signal_endpoint, log), name);
        signal->add(std::make_shared<Gate>(Lane::Signal, "", log), name);
        data->activate();
        signal->activate();
        ServerAddress address;
        address.host = test::loopbackAddress();
        address.port = transport::publishedEndpoints(*data).front().port;
        way_ = std::make_unique<EntityCommunicator>(strand_, ice_, address, clock_, events);
        onStrand([this] { way_->wantConnection(true); });
        ASSERT_TRUE(waitUntil([this] { return events->up > 0; }));
    }
    void TearDown() override {
        log.hold(false);
        onStrand([this] { way_.reset(); });
        ice_->destroy();
        server_->destroy();
        work_.reset();
        executor_.stop();
        thread_.join();
    }

    /// Another way, to a port where Ice is spoken and no Entity Manager logs in, as that of the clients.
    void seekWhereNoGateIs() {
        const auto other = transport::listen(*server_.communicator(), "Clients",
                                             transport::tcpEndpoint(test::loopbackAddress() + ":0"));
        other->activate();
        ServerAddress address;
        address.host = test::loopbackAddress();
        address.port = transport::publishedEndpoints(*other).front().port;
        onStrand([&] {
            way_ = std::make_unique<EntityCommunicator>(strand_, ice_, address, clock_, events);
            way_->wantConnection(true);
        });
    }

    /// Another way, through any of these routers.
    std::vector<std::shared_ptr<Router>> seekThroughRouters(int number) {
        ServerAddress address;
        address.router = "Axon.Entities/router";
        std::vector<std::shared_ptr<Router>> routers;
        for (int i = 0; i < number; ++i) {
            const auto adapter = transport::listen(*server_.communicator(), "Router" + std::to_string(i),
                                                   transport::tcpEndpoint(test::loopbackAddress() + ":0"));
            routers.push_back(std::make_shared<Router>(adapter, log));
            adapter->add(routers.back(), Ice::stringToIdentity("Axon.Entities/router"));
            adapter->activate();
            address.router += ":" + transport::publishedEndpoints(*adapter).front().text();
        }
        onStrand([&] {
            way_ = std::make_unique<EntityCommunicator>(strand_, ice_, address, clock_, events);
            way_->wantConnection(true);
        });
        return routers;
    }

    /// Returns when it has been done.
    void onStrand(const std::function<void()>& act) {
        std::promise<void> done;
        asio::post(strand_, [&] {
            act();
            done.set_value();
        });
        done.get_future().wait();
    }
    static Header numbered(std::int64_t number, const char* type) {
        Header head;
        head.sender.id = "client";
        head.msg_type = type;
        head.sequence = number;
        return head;
    }
    void control(std::int64_t number, std::size_t bytes) {
        onStrand([&] {
            way_->sendToClientBytes(Lane::Data, numbered(number, kMsgTask), std::string(bytes, 'x'));
        });
    }
    void data(std::int64_t number) {
        proto::ToClient message;
        message.mutable_text()->set_text(std::string(kDataBytes, 'x'));
        onStrand([&] { way_->sendToClientDataSeq(numbered(number, kMsgRaw), message); });
    }

    static constexpr std::size_t kDataBytes = 64 * 1024;

    ServerLog log;
    const std::shared_ptr<Events> events = std::make_shared<Events>();
    std::unique_ptr<EntityCommunicator> way_;

  private:
    const SteadyClock clock_{};
    Ice::CommunicatorHolder server_ = transport::makeCommunicator({.name = "server"});
    const std::shared_ptr<ServerCommunicators> ice_ = std::make_shared<ServerCommunicators>();
    asio::io_context executor_;
    asio::executor_work_guard<asio::io_context::executor_type> work_ = asio::make_work_guard(executor_);
    const asio::strand<asio::io_context::executor_type> strand_ = asio::make_strand(executor_);
    std::thread thread_{[this] { executor_.run(); }};
};

std::vector<std::int64_t> upTo(std::int64_t last) {
    std::vector<std::int64_t> numbers;
    for (std::int64_t i = 1; i <= last; ++i) numbers.push_back(i);
    return numbers;
}

TEST_F(EntityCommunicatorTest, OfDataThatIsNotReadTheOldestGivesWayAndControlIsKeptInOrder) {
    log.hold(true);
    constexpr int kControl = 20, kData = 400;  // of the data 25 MiB, more than the sockets take
    std::int64_t sent = 0;
    for (std::int64_t i = 1; i <= kControl; ++i) {
        control(i, 100);
        for (int j = 0; j < kData / kControl; ++j) data(++sent);
    }
    log.hold(false);
    ASSERT_TRUE(waitUntil([this] { return log.has({Read::Kind::Data, kData}); })) << "the newest";
    EXPECT_EQ(log.numbers(Read::Kind::Control), upTo(kControl));
    const auto data = log.numbers(Read::Kind::Data);
    EXPECT_TRUE(std::is_sorted(data.begin(), data.end()));
    EXPECT_LT(data.size(), kData);
    EXPECT_GE(data.size(), 4U * 1024 * 1024 / kDataBytes);
    EXPECT_THAT(events->downs(), testing::IsEmpty());
}

TEST_F(EntityCommunicatorTest, RawDataForAPeerGivesWayAsWell) {
    log.hold(true);
    constexpr int kRaw = 400;
    proto::ToEntity message;
    message.mutable_text()->set_text(std::string(kDataBytes, 'x'));
    for (int i = 1; i <= kRaw; ++i)
        onStrand([&] { way_->sendToPeer(Lane::Data, numbered(i, kMsgRaw), message); });
    log.hold(false);
    ASSERT_TRUE(waitUntil([this] { return log.has({Read::Kind::Raw, kRaw}); }));
    EXPECT_LT(log.numbers(Read::Kind::Raw).size(), kRaw);
    EXPECT_THAT(events->downs(), testing::IsEmpty());
}

TEST_F(EntityCommunicatorTest, AReceiptDoesNotWaitBehindData) {
    log.hold(true);
    for (int i = 1; i <= 200; ++i) data(i);
    onStrand([&] { way_->sendToClientBytes(Lane::Signal, numbered(7, kMsgReceipt), "stopped"); });
    EXPECT_TRUE(waitUntil([this] { return log.has({Read::Kind::Receipt, 7}); }));
    EXPECT_TRUE(log.numbers(Read::Kind::Data).empty());
}

TEST_F(EntityCommunicatorTest, AProfileAndAStatusKeepTheirPlaceAmongTheMessages) {
    log.hold(true);
    std::int64_t sent = 0;
    while (sent < 200) control(++sent, kDataBytes);  // 12.5 MiB: some of it waits
    Registration registration;
    registration.heartbeat_idle_ms = 1234;
    EntityStatus status;
    status.stop_generation = 5;
    onStrand([&] {
        way_->sendStatus(status);
        way_->sendBasicPrfl(registration, {});
    });
    control(++sent, 1);
    log.hold(false);
    ASSERT_TRUE(waitUntil([&] { return log.has({Read::Kind::Control, sent}); }));
    auto all = log.all();
    all.erase(std::remove(all.begin(), all.end(), Read{Read::Kind::Beat}), all.end());
    ASSERT_EQ(all.size(), 203U);
    EXPECT_EQ(all[200], (Read{Read::Kind::Status, 5}));
    EXPECT_EQ(all[201], (Read{Read::Kind::Registration, 1234}));
}

TEST_F(EntityCommunicatorTest, AServerThatDoesNotReadItsMessagesIsLeftForAnotherSession) {
    log.hold(true);
    for (int i = 1; i <= 160 && events->downs().empty(); ++i) control(i, 256 * 1024);  // 40 MiB
    ASSERT_TRUE(waitUntil([this] { return !events->downs().empty(); }));
    EXPECT_EQ(events->downs().front(), "the server does not read what it is sent");
    log.hold(false);
    EXPECT_TRUE(waitUntil([this] { return events->up > 1; }));
}

TEST_F(EntityCommunicatorTest, WhatWasSentBeforeTheOrderlyEndArrivesBeforeIt) {
    log.hold(true);
    constexpr int kControl = 200;  // 12.5 MiB: some of it waits
    for (int i = 1; i <= kControl; ++i) control(i, kDataBytes);
    onStrand([this] { way_->wantConnection(false); });
    log.hold(false);
    ASSERT_TRUE(waitUntil([this] { return log.has({Read::Kind::Leave}); }));
    EXPECT_EQ(log.numbers(Read::Kind::Control), upTo(kControl));
}

TEST_F(EntityCommunicatorTest, AServerOfAnotherReleaseIsLoggedOnce) {
    const auto lines = std::make_shared<test::LogLines>();
    const auto before = spdlog::default_logger();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("", lines));
    const auto server = log.callback();
    ASSERT_TRUE(server);
    server->newHeartbeat(1);
    server->newHeartbeat(2, transport::releaseContext());
    EXPECT_EQ(lines->all(), "");
    for (const auto* release : {"7.1", "7.1", "7\n1"})
        server->newHeartbeat(3, {{transport::kContextRelease, release}});
    spdlog::set_default_logger(before);
    const auto rest = std::string(", this Entity Manager has ") + kRelease +
                      "; they work together, because both have " + transport::ourContract() + "\n";
    EXPECT_EQ(lines->all(), "connected with an entity server of release 7.1" + rest +
                                "connected with an entity server of an unknown release ('7\\x0a1')" + rest);
}

TEST_F(EntityCommunicatorTest, AfterASessionAnotherRouterIsTriedFirst) {
    const auto routers = seekThroughRouters(2);
    const auto sessions = [&](std::size_t router) { return routers[router]->sessions.load(); };
    ASSERT_TRUE(waitUntil([this] { return events->up == 2; }));
    std::size_t its = sessions(0) > 0 ? 0 : 1;
    for (int times = 1; times <= 8;
         ++times, its = 1 - its) {  // by chance it would be the other one half the time
        const auto before = sessions(its);
        onStrand([this] {  // as Presence does it
            way_->wantConnection(false);
            way_->wantConnection(true);
        });
        ASSERT_TRUE(waitUntil([&] { return events->up == times + 2; }));
        ASSERT_EQ(sessions(its), before);
    }
}

TEST_F(EntityCommunicatorTest, WhereNoEntityManagerLogsInTheLogNamesTheRightPort) {
    const auto lines = std::make_shared<test::LogLines>();
    const auto before = spdlog::default_logger();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("", lines));
    seekWhereNoGateIs();
    EXPECT_TRUE(waitUntil([&] { return lines->all().find("no session") != std::string::npos; }));
    spdlog::set_default_logger(before);
    EXPECT_THAT(lines->all(), testing::HasSubstr("Is it the port of the clients"));
    EXPECT_THAT(lines->all(), testing::HasSubstr("10412"));
}

}  // namespace
}  // namespace axon::entity_manager
