// SPDX-License-Identifier: GPL-2.0-or-later
// What the client library logs of a server's release, which is a front-end server of this file.
#include <axon/frontendcomm.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>
#include <axon/client.hpp>

#include <memory>
#include <mutex>
#include <string>

#include "common/release.hpp"
#include "support/log_lines.hpp"
#include "support/loopback.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"

namespace axon::client {
namespace {

using transport::ByteRange;
namespace slice = ::Axon::FrontEndComm;
namespace wire = ::Axon::CommUtil;

/// Of the signal lane's session that was attached last. Threads: any.
class Attached {
  public:
    void set(std::shared_ptr<slice::ClientCallbackPrx> callback) {
        const std::lock_guard lock(mutex_);
        callback_ = std::move(callback);
    }
    std::shared_ptr<slice::ClientCallbackPrx> get() const {
        const std::lock_guard lock(mutex_);
        return callback_;
    }

  private:
    mutable std::mutex mutex_;
    std::shared_ptr<slice::ClientCallbackPrx> callback_;  // guarded by mutex_
};

class Session final : public slice::ClientSession {
  public:
    explicit Session(Attached& attached) : attached_(attached) {}
    slice::SessionFacts setCallback(std::shared_ptr<slice::ClientCallbackPrx>, const Ice::Current&) override {
        slice::SessionFacts facts{};  // no signal endpoint: the same as that of the data lane
        facts.me = {"id", "client1@lab", wire::Role::Operator};
        facts.token = "token";
        return facts;
    }
    void attachSignalLane(std::string, std::shared_ptr<slice::ClientCallbackPrx> callback,
                          const Ice::Current& current) override {
        attached_.set(Ice::uncheckedCast<slice::ClientCallbackPrx>(
            current.con->createProxy(callback->ice_getIdentity())));
    }
    void sendRequest(wire::Header, ByteRange, const Ice::Current&) override {}
    void sendToEntity(wire::Header, ByteRange, const Ice::Current&) override {}
    void sendToEntityDataSeq(wire::Header, ByteRange, const Ice::Current&) override {}
    void sendStopSignal(wire::Header, wire::StopCause, const Ice::Current&) override {}
    void sendStopSignals(wire::Header, wire::StopList, wire::StopCause, const Ice::Current&) override {}
    void sendResetSignal(wire::Header, const Ice::Current&) override {}
    void sendClearSignal(wire::Header, const Ice::Current&) override {}
    void keepAlive(double, const Ice::Current&) override {}
    void leave(const Ice::Current&) override {}
    void destroy(const Ice::Current&) override {}

  private:
    Attached& attached_;
};

class Gate final : public slice::ClientGate {
  public:
    explicit Gate(Attached& attached) : attached_(attached) {}
    void openAsync(std::string, std::string, std::string,
                   std::function<void(const std::shared_ptr<slice::ClientSessionPrx>&)> opened,
                   std::function<void(std::exception_ptr)>, const Ice::Current& current) override {
        release = transport::releaseIn(current.ctx);
        opened(Ice::uncheckedCast<slice::ClientSessionPrx>(
            current.adapter->addWithUUID(std::make_shared<Session>(attached_))));
    }
    std::string release;  ///< of the client; written before it knows that it is connected

  private:
    Attached& attached_;
};

TEST(ServerRelease, AnotherOneIsLoggedOnceAlsoWhenTheClientConnectsAgain) {
    const auto lines = std::make_shared<test::LogLines>();
    spdlog::register_logger(std::make_shared<spdlog::logger>("axon", lines));
    Attached attached;
    const auto gate = std::make_shared<Gate>(attached);
    const Ice::CommunicatorHolder server = transport::makeCommunicator({.name = "server"});
    const auto adapter = transport::listen(*server.communicator(), "Clients",
                                           transport::tcpEndpoint(test::loopbackAddress() + ":0"));
    adapter->add(gate, Ice::stringToIdentity("ClientGate"));
    adapter->activate();
    Options options;
    options.server = transport::addressOf(*adapter);
    auto connected = Client::connect(options);
    ASSERT_TRUE(connected.ok()) << connected.refusal().message;
    EXPECT_EQ(gate->release, kRelease);

    const auto first = attached.get();
    ASSERT_TRUE(first);
    first->newHeartbeat(1);
    first->newHeartbeat(2, transport::releaseContext());
    EXPECT_EQ(lines->all().find("release"), std::string::npos) << lines->all();
    first->newHeartbeat(3, {{transport::kContextRelease, "7.1"}});

    attached.set(nullptr);
    first->ice_getCachedConnection()->close(Ice::ConnectionClose::Forcefully);
    ASSERT_TRUE(test::waitUntil([&] { return attached.get() != nullptr; }));
    const auto second = attached.get();
    for (const auto& release : {std::string("7.1"), std::string(5000, 'x')})
        second->newHeartbeat(1, {{transport::kContextRelease, release}});
    connected.value().reset();

    const auto rest = std::string(", this client has ") + kRelease +
                      "; they work together, because both have " + transport::ourContract() + "\n";
    const auto all = lines->all();
    const auto known = "client: connected with a server of release 7.1" + rest;
    EXPECT_NE(all.find(known), std::string::npos) << all;
    EXPECT_EQ(all.find("of release 7.1"), all.rfind("of release 7.1")) << all;
    EXPECT_NE(all.find("client: connected with a server of an unknown release ('" +
                       std::string(kReleaseMax, 'x') + "...')" + rest),
              std::string::npos)
        << all;
}

}  // namespace
}  // namespace axon::client
