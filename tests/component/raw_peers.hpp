// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/entitycomm.h>
#include <axon/frontendcomm.h>

#include <atomic>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::test {

using transport::ByteRange;
using transport::toRange;
using transport::toView;

/// What a peer was told, as lines: "msg TASK hello", "signal stop requested client1". Thread-safe.
class Log {
  public:
    void add(std::string line) {
        const std::lock_guard lock(mutex_);
        lines_.push_back(std::move(line));
    }
    std::vector<std::string> lines() const {
        const std::lock_guard lock(mutex_);
        return lines_;
    }
    std::size_t count(std::string_view beginning) const {
        const std::lock_guard lock(mutex_);
        std::size_t found = 0;
        for (const auto& line : lines_) found += line.rfind(beginning, 0) == 0 ? 1 : 0;
        return found;
    }
    bool has(std::string_view beginning) const { return count(beginning) > 0; }

  private:
    mutable std::mutex mutex_;
    std::vector<std::string> lines_;  // guarded by mutex_
};

/// " heartbeat of 0.1.0" where the server tells its release.
inline std::string heartbeatLine(const Ice::Current& current) {
    const auto release = transport::releaseIn(current.ctx);
    return release.empty() ? " heartbeat" : " heartbeat of " + release;
}

/// The two lanes of a peer that speaks the contracts without any library of ours: docs/reference/sessions.md,
/// step by step.
template <class GatePrx, class SessionPrx, class CallbackPrx>
class RawPeer {
  public:
    explicit RawPeer(const std::map<std::string, std::string>& properties = {})
        : data_(transport::makeCommunicator({"raw-data", Lane::Data, 1, 1, properties})),
          signal_(transport::makeCommunicator({"raw-signal", Lane::Signal, 1, 1, properties})) {}
    virtual ~RawPeer() = default;
    RawPeer(const RawPeer&) = delete;
    RawPeer& operator=(const RawPeer&) = delete;

    const std::shared_ptr<SessionPrx>& data() const { return data_session_; }
    const std::shared_ptr<SessionPrx>& signal() const { return signal_session_; }
    std::shared_ptr<SessionPrx> dataOneway() const {
        return data_session_->ice_oneway()->ice_invocationTimeout(-1);
    }
    std::shared_ptr<SessionPrx> signalOneway() const {
        return signal_session_->ice_oneway()->ice_invocationTimeout(-1);
    }
    void cutData() { data_session_->ice_getCachedConnection()->close(Ice::ConnectionClose::Forcefully); }
    void cutSignal() { signal_session_->ice_getCachedConnection()->close(Ice::ConnectionClose::Forcefully); }
    const std::shared_ptr<Ice::Communicator>& communicator() const { return data_.communicator(); }

  protected:
    using Open = std::function<std::shared_ptr<SessionPrx>(const std::shared_ptr<GatePrx>&)>;

    std::shared_ptr<CallbackPrx> openData(const std::string& gate, const Open& open,
                                          const std::shared_ptr<Ice::Object>& servant) {
        return openLane(*data_.communicator(), gate, open, servant, data_session_);
    }
    std::shared_ptr<CallbackPrx> openSignal(const std::string& gate, const Open& open,
                                            const std::shared_ptr<Ice::Object>& servant) {
        return openLane(*signal_.communicator(), gate, open, servant, signal_session_);
    }

    std::shared_ptr<CallbackPrx> openThrough(Lane lane, const std::string& router, const std::string& token,
                                             const std::shared_ptr<Ice::Object>& servant) {
        auto& communicator = lane == Lane::Signal ? *signal_.communicator() : *data_.communicator();
        std::promise<transport::RoutedSession> promise;
        transport::openRoutedSession(
            transport::routerProxy(communicator, router), {"client1", "secret1", "client1@lab", token, 5000},
            [&](transport::RoutedSession session) { promise.set_value(std::move(session)); },
            [&](const std::exception_ptr& error) { promise.set_exception(error); });
        const auto routed = promise.get_future().get();
        const auto adapter = communicator.createObjectAdapter("");
        auto callback = Ice::uncheckedCast<CallbackPrx>(routed.callback(*adapter, servant));
        adapter->activate();
        routed.connection->setAdapter(adapter);
        (lane == Lane::Signal ? signal_session_ : data_session_) =
            Ice::uncheckedCast<SessionPrx>(routed.session);
        return callback;
    }

    /// To be called by the destructors of derived classes, whose members the callbacks use.
    void close() {
        data_.communicator()->destroy();
        signal_.communicator()->destroy();
    }

  private:
    static std::shared_ptr<CallbackPrx> openLane(Ice::Communicator& communicator,
                                                 const std::string& gate_text, const Open& open,
                                                 const std::shared_ptr<Ice::Object>& servant,
                                                 std::shared_ptr<SessionPrx>& session) {
        const auto gate = Ice::uncheckedCast<GatePrx>(
            communicator.stringToProxy(gate_text)->ice_context(transport::contractContext()));
        const auto opened = open(gate);
        const auto connection = gate->ice_getCachedConnection();
        const auto adapter = communicator.createObjectAdapter("");
        auto callback = Ice::uncheckedCast<CallbackPrx>(adapter->addWithUUID(servant));
        adapter->activate();
        connection->setAdapter(adapter);
        session = Ice::uncheckedCast<SessionPrx>(connection->createProxy(opened->ice_getIdentity()));
        return callback;
    }

    Ice::CommunicatorHolder data_;
    Ice::CommunicatorHolder signal_;
    std::shared_ptr<SessionPrx> data_session_;
    std::shared_ptr<SessionPrx> signal_session_;
};

/// A stub of an Entity Manager.
class RawEntity : public RawPeer<Axon::EntityComm::EntityGatePrx, Axon::EntityComm::EntitySessionPrx,
                                 Axon::EntityComm::EntityCallbackPrx> {
  public:
    explicit RawEntity(const std::string& address, std::string uuid, const std::string& name = "Robot",
                       const std::string& user = {}, const std::string& password = {},
                       const std::map<std::string, std::string>& properties = {})
        : RawPeer(properties) {
        const auto open = [&](const std::shared_ptr<Axon::EntityComm::EntityGatePrx>& gate) {
            return gate->open(user, password);
        };
        const auto callback = openData("EntityGate:" + transport::tcpEndpoint(address), open,
                                       std::make_shared<Callback>(*this, "data"));
        const auto facts = data()->setCallback(callback);
        const auto signal_callback = openSignal("EntityGate:" + facts.signalEndpoint, open,
                                                std::make_shared<Callback>(*this, "signal"));
        signal()->attachSignalLane(facts.token, signal_callback);
        registration.entity = std::move(uuid);
        registration.name = name;
        registration.category = "ROBOT";
        registration.type = "MOBILE";
    }
    ~RawEntity() override {
        resume();
        close();
    }
    void resume() {
        stalled = false;
        stalled.notify_all();
    }
    void join() {
        data()->sendBasicPrfl(transport::toIce(registration), toRange("profile of " + registration.name), {});
    }
    void status(EntityState state, const std::string& holder = {}) {
        EntityStatus status;
        status.state = state;
        status.holder = {holder, holder.empty() ? "" : "somebody", Role::Operator};
        data()->sendStatus(transport::toIce(status));
    }
    Header headTo(const std::string& client) const {
        Header head;
        head.sender.id = client;
        head.msg_type = kMsgText;
        return head;
    }

    Registration registration;
    Log log;
    /// Data dispatches wait while this is set.
    std::atomic<bool> stalled{false};
    std::atomic<std::uint64_t> data_received{0};
    std::atomic<std::uint64_t> messages_received{0};
    std::atomic<Role> last_role{Role::Observer};  // of whoever sent a message last
    std::function<void(const Header&)> on_stop;   // besides the log; set before there are any

  private:
    class Callback final : public Axon::EntityComm::EntityCallback {
      public:
        Callback(RawEntity& entity, std::string lane) : entity_(entity), lane_(std::move(lane)) {}
        void newClientMsg(Axon::CommUtil::Header head, ByteRange message, const Ice::Current&) override {
            wait();
            ++entity_.messages_received;
            entity_.last_role = static_cast<Role>(head.sender.role);
            entity_.log.add((lane_ == "signal" ? "signal msg " : "msg ") + head.sender.name + " " +
                            head.msgType + " " + std::string(toView(message)));
        }
        void newClientMsgDataSeq(Axon::CommUtil::Header head, ByteRange, const Ice::Current&) override {
            wait();
            ++entity_.data_received;
            entity_.log.add("data " + std::to_string(static_cast<long>(head.seq)));
        }
        void stopSignal(Axon::CommUtil::Header head, Axon::CommUtil::StopCause cause,
                        const Ice::Current&) override {
            entity_.log.add(lane_ + " stop " + toString(transport::fromIce(cause)) + " " + head.sender.name);
            if (entity_.on_stop) entity_.on_stop(transport::fromIce(Axon::CommUtil::Header(head)));
            if (head.msgType != kMsgDrill) return;
            // As an Entity Manager whose Entity Interfacer acknowledges at once.
            Header receipt;
            receipt.sender.id = head.sender.id;
            receipt.msg_type = kMsgDrill;
            entity_.signalOneway()->sendToClientAsync(transport::toIce(receipt), toRange("receipt"), [] {},
                                                      {}, {});
        }
        void resetSignal(Axon::CommUtil::Header, const Ice::Current&) override {
            entity_.log.add(lane_ + " reset");
        }
        void clearSignal(Axon::CommUtil::Header, const Ice::Current&) override {
            entity_.log.add(lane_ + " clear");
        }
        void newClientUpdate(Axon::CommUtil::Header head, Axon::CommUtil::ClientChange change,
                             const Ice::Current&) override {
            const char* text[] = {"lost", "ended"};
            entity_.log.add(lane_ + " client " + text[static_cast<int>(change)] + " " + head.sender.id);
        }
        void newRefusalMsg(Axon::CommUtil::Header head, int code, std::string, const Ice::Current&) override {
            entity_.log.add((lane_ == "signal" ? "signal refused " : "refused ") + std::to_string(code) +
                            " " + head.msgType);
        }
        void newHeartbeat(double, const Ice::Current& current) override {
            entity_.log.add(lane_ + heartbeatLine(current));
        }

      private:
        void wait() const { entity_.stalled.wait(true); }
        RawEntity& entity_;
        const std::string lane_;
    };
};

/// A stub of a client.
class RawClient : public RawPeer<Axon::FrontEndComm::ClientGatePrx, Axon::FrontEndComm::ClientSessionPrx,
                                 Axon::FrontEndComm::ClientCallbackPrx> {
  public:
    explicit RawClient(const std::string& address, const std::string& name = "client1@lab",
                       bool with_signal_lane = true, const std::string& user = {},
                       const std::string& password = {},
                       const std::map<std::string, std::string>& properties = {})
        : RawPeer(properties) {
        const auto open = [&](const std::shared_ptr<Axon::FrontEndComm::ClientGatePrx>& gate) {
            return gate->open(user, password, name);
        };
        const auto callback = openData("ClientGate:" + transport::tcpEndpoint(address), open,
                                       std::make_shared<Callback>(*this, "data"));
        facts = data()->setCallback(callback);
        if (!with_signal_lane) return;
        const auto signal_callback = openSignal("ClientGate:" + facts.signalEndpoint, open,
                                                std::make_shared<Callback>(*this, "signal"));
        signal()->attachSignalLane(facts.token, signal_callback);
    }
    /// In a browser, over WebSocket: endpoints in Ice's form.
    struct Socket {
        std::string endpoint;
        std::string signal = {};  ///< in place of the one that the server names; empty: one lane
    };
    RawClient(const Socket& socket, const std::string& user, const std::string& password,
              const std::map<std::string, std::string>& properties = {})
        : RawPeer(properties) {
        const auto callback = openData(
            "ClientGate:" + socket.endpoint,
            [&](const std::shared_ptr<Axon::FrontEndComm::ClientGatePrx>& gate) {
                return gate->open(user, password, "page@browser");
            },
            std::make_shared<Callback>(*this, "data"));
        facts = data()->setCallback(callback);
        if (!socket.signal.empty()) attach(socket.signal, facts.token);
    }
    /// Opens the signal lane of a session at this endpoint.
    void attach(const std::string& endpoint, const std::string& token) {
        const auto signal_callback = openSignal(
            "ClientGate:" + endpoint,
            [](const std::shared_ptr<Axon::FrontEndComm::ClientGatePrx>& gate) {
                return gate->open("", "", "");
            },
            std::make_shared<Callback>(*this, "signal"));
        signal()->attachSignalLane(token, signal_callback);
    }
    /// Behind a router: `first` for the data lane, `second` for the signal lane.
    struct Routers {
        std::string first, second;
    };
    explicit RawClient(const Routers& routers, const std::map<std::string, std::string>& properties = {})
        : RawPeer(properties) {
        const auto callback =
            openThrough(Lane::Data, routers.first, {}, std::make_shared<Callback>(*this, "data"));
        facts = data()->setCallback(callback);
        const auto signal_callback = openThrough(Lane::Signal, routers.second, facts.token,
                                                 std::make_shared<Callback>(*this, "signal"));
        signal()->attachSignalLane(facts.token, signal_callback);
    }
    ~RawClient() override {
        stalled = false;
        stalled.notify_all();
        close();
    }
    Header headTo(const std::string& entity, std::int64_t sequence = 1) const {
        Header head;
        head.sender = {"forged", "forged", Role::Admin};
        head.entity = entity;
        head.msg_type = kMsgText;
        head.sequence = sequence;
        return head;
    }
    void text(const std::string& entity, const std::string& text, std::int64_t sequence = 1) {
        dataOneway()->sendToEntity(transport::toIce(headTo(entity, sequence)), toRange(text));
    }
    /// As whoever wants to hold it does first.
    void asksFor(const std::string& entity) {
        auto head = headTo(entity);
        head.msg_type = kMsgCheckOut;
        data()->sendToEntity(transport::toIce(head), toRange("check-out"));
    }
    void stop(const std::string& entity) {
        signalOneway()->sendStopSignal(transport::toIce(headTo(entity)),
                                       Axon::CommUtil::StopCause::Requested);
    }

    Axon::FrontEndComm::SessionFacts facts;
    Log log;
    std::atomic<bool> stalled{false};

  private:
    class Callback final : public Axon::FrontEndComm::ClientCallback {
      public:
        Callback(RawClient& client, std::string lane) : client_(client), lane_(std::move(lane)) {}
        void newBasicPrflMsg(Axon::CommUtil::Presence presence, Axon::CommUtil::Registration registration,
                             ByteRange profile, const Ice::Current&) override {
            const char* text[] = {"joined", "changed", "left"};
            client_.log.add(std::string(text[static_cast<int>(presence)]) + " " + registration.name + " " +
                            registration.entity + " " + std::string(toView(profile)));
        }
        void newStatusMsg(Axon::CommUtil::EntityStatus status, const Ice::Current&) override {
            client_.log.add("status " + status.entity + " " +
                            toString(static_cast<EntityState>(status.state)));
            if (status.stopLatencyUs > 0)
                client_.log.add("a stop takes " + std::to_string(status.stopLatencyUs));
        }
        void newEntityMsg(Axon::CommUtil::Header head, ByteRange message, const Ice::Current&) override {
            wait();
            client_.log.add(lane_ + " msg " + head.entity + " " + std::string(toView(message)));
        }
        void newEntityMsgDataSeq(Axon::CommUtil::Header head, ByteRange, const Ice::Current&) override {
            wait();
            client_.log.add("data " + std::to_string(static_cast<long>(head.seq)));
        }
        void newRefusalMsg(Axon::CommUtil::Header head, int code, std::string, const Ice::Current&) override {
            client_.log.add("refused " + std::to_string(code) + " of " +
                            std::to_string(static_cast<long>(head.seq)));
        }
        void newStopAccepted(Axon::CommUtil::Header, int entities, const Ice::Current&) override {
            client_.log.add(lane_ + " stop accepted for " + std::to_string(entities));
        }
        void newUpdateMsg(int, std::string text, const Ice::Current&) override {
            client_.log.add("update " + text);
        }
        void newHeartbeat(double, const Ice::Current& current) override {
            client_.log.add(lane_ + heartbeatLine(current));
        }

      private:
        void wait() const { client_.stalled.wait(true); }
        RawClient& client_;
        const std::string lane_;
    };
};

}  // namespace axon::test
