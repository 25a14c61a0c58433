// SPDX-License-Identifier: GPL-2.0-or-later
#include "raw_client.hpp"

#include <Ice/Ice.h>
#include <axon/frontendcomm.h>

#include <atomic>
#include <condition_variable>
#include <deque>
#include <map>
#include <mutex>
#include <stdexcept>
#include <thread>

#include "common/ids.hpp"
#include "raw_paths.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;
using ::Axon::FrontEndComm::ClientCallback;
using ::Axon::FrontEndComm::ClientCallbackPrx;
using ::Axon::FrontEndComm::ClientGatePrx;
using ::Axon::FrontEndComm::ClientSessionPrx;
using transport::ByteRange;
using transport::toRange;
using transport::toView;

constexpr std::size_t kKept = 4096;
constexpr auto kBeat = 50ms;
constexpr auto kStatusTime = 500ms;

}  // namespace

class RawClient::Session {
  public:
    Session(std::string name, Heard heard)
        : name_(std::move(name)),
          heard_(std::move(heard)),
          data_(transport::makeCommunicator({.name = "faults-data", .lane = Lane::Data})),
          signal_(transport::makeCommunicator({.name = "faults-signal", .lane = Lane::Signal})) {}

    void open(const std::string& address, const std::shared_ptr<Session>& self) {
        try {
            paths_ = std::make_shared<RawPaths>(
                home(signal_.communicator()),
                [this](const Header& head, const std::string& bytes) { relay(head, bytes); },
                [weak = std::weak_ptr<Session>(self)](const Header& head, std::string_view bytes) {
                    if (const auto still = weak.lock()) still->hear(head, bytes);
                });
            const auto callback =
                openLane(Lane::Data, *data_.communicator(), "ClientGate:" + transport::tcpEndpoint(address),
                         self, data_session_);
            const auto facts = data_session_->setCallback(callback);
            id_ = facts.me.id;
            const auto signal = openLane(Lane::Signal, *signal_.communicator(),
                                         "ClientGate:" + facts.signalEndpoint, self, signal_session_);
            signal_session_->attachSignalLane(facts.token, signal);
        } catch (const Ice::Exception&) {
            throw std::runtime_error(name_ + " has no session at " + address + ": " +
                                     transport::translate(std::current_exception()).message);
        }
        data_oneway_ =
            Ice::uncheckedCast<ClientSessionPrx>(data_session_->ice_oneway()->ice_invocationTimeout(-1));
        signal_oneway_ =
            Ice::uncheckedCast<ClientSessionPrx>(signal_session_->ice_oneway()->ice_invocationTimeout(-1));
        paths_->start(id_);
        beats_ = std::thread([this] {
            std::unique_lock lock(mutex_);
            for (double beat = 1; !closing_; ++beat) {
                lock.unlock();
                guarded([&] { signal_oneway_->keepAliveAsync(beat, [] {}, {}, {}); });
                lock.lock();
                changed_.wait_for(lock, kBeat, [this] { return closing_; });
            }
        });
    }

    void close() {
        {
            const std::lock_guard lock(mutex_);
            closing_ = true;
        }
        changed_.notify_all();
        if (beats_.joinable()) beats_.join();
        if (paths_) paths_->close();
        data_.communicator()->destroy();
        signal_.communicator()->destroy();
    }

    template <class Call>
    void guarded(Call call) const {
        try {
            call();
        } catch (const Ice::Exception&) {  // gone: whoever waits for an answer finds out
        }
    }

    Header signalTo(const std::string& entity) {
        Header head;
        head.entity = entity;
        head.sequence = ++signals_;
        return head;
    }
    void relay(const Header& head, const std::string& bytes) const {
        guarded(
            [&] { data_oneway_->sendToEntityAsync(transport::toIce(head), toRange(bytes), [] {}, {}, {}); });
    }

    void told(const std::string& entity, std::string name, bool left) {
        if (left) paths_->left(entity);
        const std::lock_guard lock(mutex_);
        auto& one = entities_[entity];
        if (!name.empty()) one.name = std::move(name);
        one.there = !left;
        if (left) one.state = EntityState::UNAV;
        changed_.notify_all();
    }
    void told(const EntityStatus& status) {
        const std::lock_guard lock(mutex_);
        entities_[status.entity].state = status.state;
        changed_.notify_all();
    }
    void hear(const Header& head, std::string_view bytes) {
        proto::ToClient message;
        if (!message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
        if (message.has_check_out() && message.check_out().has_lease()) {
            const auto& reply = message.check_out();
            if (!reply.direct_endpoint().empty() && !reply.direct_signal_endpoint().empty())
                paths_->offer(head.entity, numberOf(reply.lease()), reply.lease().key(),
                              reply.direct_endpoint(), reply.direct_signal_endpoint());
        }
        if (message.has_lease_ended()) paths_->withdraw(head.entity, numberOf(message.lease_ended().lease()));
        if (heard_) heard_(head, message);
        const std::lock_guard lock(mutex_);
        if (message.has_check_out() && message.check_out().has_lease())
            leases_[head.entity] = numberOf(message.check_out().lease());
        messages_heard_.push_back({head.entity, std::move(message)});
        if (messages_heard_.size() > kKept) messages_heard_.pop_front();
        changed_.notify_all();
    }

    void refused(const Header& head) {
        if (head.msg_type == kMsgWay) paths_->markRefused(head.entity);
        const std::lock_guard lock(mutex_);
        ++undelivered_;
        refused_ = head.sequence;
        changed_.notify_all();
    }
    void ended() {
        const std::lock_guard lock(mutex_);
        connected_ = false;
        changed_.notify_all();
    }

    struct Entity {
        std::string name;
        EntityState state = EntityState::UNAV;
        bool there = false;
        bool usable() const { return there && state >= EntityState::IDLE && state != EntityState::ERR; }
    };

    const std::string name_;
    const Heard heard_;
    std::string id_;
    std::shared_ptr<ClientSessionPrx> data_session_, signal_session_, data_oneway_, signal_oneway_;
    std::shared_ptr<RawPaths> paths_;
    std::atomic<std::int64_t> signals_{0};
    std::atomic<std::size_t> undelivered_{0};
    std::mutex mutex_;
    std::condition_variable changed_;
    // Guarded by mutex_:
    bool closing_ = false;
    bool connected_ = true;
    std::int64_t refused_ = 0;  // the newest message that the server could not deliver
    std::map<std::string, Entity> entities_;
    std::map<std::string, LeaseNumber> leases_;
    std::deque<std::pair<std::string, proto::ToClient>> messages_heard_;

  private:
    class Callback final : public ClientCallback {
      public:
        Callback(std::weak_ptr<Session> session, Lane lane) : session_(std::move(session)), lane_(lane) {}
        void newBasicPrflMsg(::Axon::CommUtil::Presence presence, ::Axon::CommUtil::Registration registration,
                             ByteRange, const Ice::Current&) override {
            if (const auto session = session_.lock())
                session->told(registration.entity, registration.name,
                              transport::fromIce(presence) == Presence::Left);
        }
        void newStatusMsg(::Axon::CommUtil::EntityStatus status, const Ice::Current&) override {
            if (const auto session = session_.lock()) session->told(transport::fromIce(std::move(status)));
        }
        void newEntityMsg(::Axon::CommUtil::Header head, ByteRange message, const Ice::Current&) override {
            const auto session = session_.lock();
            if (!session) return;
            if (lane_ == Lane::Data)
                session->paths_->relayed(transport::fromIce(std::move(head)), toView(message));
            else
                session->hear(transport::fromIce(std::move(head)), toView(message));
        }
        void newEntityMsgDataSeq(::Axon::CommUtil::Header, ByteRange, const Ice::Current&) override {}
        void newRefusalMsg(::Axon::CommUtil::Header head, int, std::string, const Ice::Current&) override {
            if (const auto session = session_.lock()) session->refused(transport::fromIce(std::move(head)));
        }
        void newStopAccepted(::Axon::CommUtil::Header, int, const Ice::Current&) override {}
        void newUpdateMsg(int, std::string, const Ice::Current&) override {}
        void newHeartbeat(double, const Ice::Current&) override {}

      private:
        const std::weak_ptr<Session> session_;
        const Lane lane_;
    };

    static LeaseNumber numberOf(const proto::Lease& lease) {
        return {static_cast<std::int32_t>(lease.epoch()), static_cast<std::int32_t>(lease.number())};
    }

    /// Where the signal lanes of direct paths begin.
    static client::LaneHome home(const std::shared_ptr<Ice::Communicator>& communicator) {
        const auto adapter = communicator->createObjectAdapter("");
        adapter->activate();
        return {communicator, adapter, nullptr};
    }

    std::shared_ptr<ClientCallbackPrx> openLane(Lane lane, Ice::Communicator& communicator,
                                                const std::string& gate_text,
                                                const std::shared_ptr<Session>& self,
                                                std::shared_ptr<ClientSessionPrx>& session) const {
        const auto gate = Ice::uncheckedCast<ClientGatePrx>(communicator.stringToProxy(gate_text)
                                                                ->ice_context(transport::contractContext())
                                                                ->ice_invocationTimeout(3000));
        const auto opened = gate->open("", "", name_);
        const auto connection = gate->ice_getCachedConnection();
        const auto adapter = communicator.createObjectAdapter("");
        auto callback = Ice::uncheckedCast<ClientCallbackPrx>(
            adapter->addWithUUID(std::make_shared<Callback>(self, lane)));
        adapter->activate();
        connection->setAdapter(adapter);
        connection->setCloseCallback(
            [weak = std::weak_ptr<Session>(self)](const std::shared_ptr<Ice::Connection>&) {
                if (const auto still = weak.lock()) still->ended();
            });
        session = Ice::uncheckedCast<ClientSessionPrx>(
            connection->createProxy(opened->ice_getIdentity())->ice_invocationTimeout(3000));
        return callback;
    }

    Ice::CommunicatorHolder data_;
    Ice::CommunicatorHolder signal_;
    std::thread beats_;
};

RawClient::RawClient(const std::string& address, const std::string& name, Heard heard)
    : session_(std::make_shared<Session>(name, std::move(heard))) {
    try {
        session_->open(address, session_);
    } catch (...) {
        session_->close();
        throw;
    }
}
RawClient::~RawClient() {
    session_->close();
}

bool RawClient::connected() const {
    const std::lock_guard lock(session_->mutex_);
    return session_->connected_;
}
const std::string& RawClient::name() const {
    return session_->name_;
}
const std::string& RawClient::id() const {
    return session_->id_;
}
bool RawClient::awaitDirect(const std::string& entity, std::chrono::milliseconds time) {
    return session_->paths_->awaitOpen(entity, time);
}
std::size_t RawClient::sentDirectly() const {
    return session_->paths_->sent();
}
std::size_t RawClient::undelivered() const {
    return session_->undelivered_;
}

std::string RawClient::entity(const std::string& name, std::chrono::milliseconds time) {
    std::unique_lock lock(session_->mutex_);
    std::string found;
    session_->changed_.wait_for(lock, time, [&] {
        for (const auto& [id, entity] : session_->entities_)
            if (entity.name == name && entity.usable()) found = id;
        return !found.empty();
    });
    return found;
}
bool RawClient::available(const std::string& entity) const {
    const std::lock_guard lock(session_->mutex_);
    const auto found = session_->entities_.find(entity);
    return found != session_->entities_.end() && found->second.usable();
}

void RawClient::send(const std::string& entity, const char* type, const proto::ToEntity& body,
                     LeaseNumber lease, std::int32_t generation) {
    Header head;
    head.entity = entity;
    head.msg_type = type;
    head.held = lease;
    head.stop_generation = generation;
    session_->paths_->send(std::move(head), body.SerializeAsString());
}
void RawClient::stop(const std::string& entity) {
    const auto head = session_->signalTo(entity);
    session_->guarded([&] {
        session_->signal_oneway_->sendStopSignalAsync(transport::toIce(head),
                                                      ::Axon::CommUtil::StopCause::Requested, [] {}, {}, {});
    });
    session_->paths_->signal(entity,
                             [&](const auto& path) { path.sendStopSignal(head, StopCause::Requested); });
}
void RawClient::reset(const std::string& entity) {
    const auto head = session_->signalTo(entity);
    session_->guarded(
        [&] { session_->signal_oneway_->sendResetSignalAsync(transport::toIce(head), [] {}, {}, {}); });
    session_->paths_->signal(entity, [&](const auto& path) { path.sendResetSignal(head); });
}
void RawClient::clear(const std::string& entity) {
    const auto head = session_->signalTo(entity);
    session_->guarded(
        [&] { session_->signal_oneway_->sendClearSignalAsync(transport::toIce(head), [] {}, {}, {}); });
    session_->paths_->signal(entity, [&](const auto& path) { path.sendClearSignal(head); });
}

std::optional<proto::ToClient> RawClient::await(const std::string& entity,
                                                const std::function<bool(const proto::ToClient&)>& holds,
                                                std::chrono::milliseconds time) {
    std::unique_lock lock(session_->mutex_);
    std::optional<proto::ToClient> found;
    auto& heard = session_->messages_heard_;
    session_->changed_.wait_for(lock, time, [&] {
        for (auto at = heard.begin(); at != heard.end(); ++at)
            if (at->first == entity && holds(at->second)) {
                found = std::move(at->second);
                heard.erase(at);
                return true;
            }
        return false;
    });
    return found;
}
std::optional<LeaseNumber> RawClient::lease(const std::string& entity) const {
    const std::lock_guard lock(session_->mutex_);
    const auto found = session_->leases_.find(entity);
    if (found == session_->leases_.end()) return std::nullopt;
    return found->second;
}
void RawClient::forget() {
    const std::lock_guard lock(session_->mutex_);
    session_->messages_heard_.clear();
}

Result<Grant> RawClient::checkOut(const std::string& entity, bool force, std::chrono::milliseconds time) {
    proto::ToEntity body;
    const auto id = newId();
    body.mutable_check_out()->set_request_id(id);
    body.mutable_check_out()->set_phase(proto::TAKE);
    body.mutable_check_out()->set_force(force);
    if (force) body.mutable_check_out()->set_reason("axon-faults");
    send(entity, kMsgCheckOut, body);
    const auto answer = await(
        entity, [&](const auto& m) { return m.has_check_out() && m.check_out().request_id() == id; }, time);
    if (!answer) return Refusal{RefusalCode::TimedOut, "no answer to the check-out", {}};
    const auto& reply = answer->check_out();
    if (reply.has_refusal() && reply.refusal().code() != proto::OK)
        return Refusal{static_cast<RefusalCode>(reply.refusal().code()), reply.refusal().message(),
                       reply.refusal().holder()};
    return Grant{
        {static_cast<std::int32_t>(reply.lease().epoch()), static_cast<std::int32_t>(reply.lease().number())},
        static_cast<std::int32_t>(reply.stop_generation()),
        reply.latched()};
}
bool RawClient::release(const std::string& entity, LeaseNumber lease) {
    proto::ToEntity body;
    body.mutable_release();
    send(entity, kMsgRelease, body, lease);
    return await(entity, [](const auto& m) { return m.has_lease_ended(); }).has_value();
}
Result<void> RawClient::rearm(const std::string& entity, LeaseNumber lease, std::int32_t generation) {
    proto::ToEntity body;
    const auto id = newId();
    body.mutable_rearm()->set_request_id(id);
    send(entity, kMsgRearm, body, lease, generation);
    const auto answer =
        await(entity, [&](const auto& m) { return m.has_reply() && m.reply().request_id() == id; });
    if (!answer) return Refusal{RefusalCode::TimedOut, "no answer to the rearm", {}};
    const auto& refusal = answer->reply().refusal();
    return refusal.code() == proto::OK
               ? Result<void>()
               : Refusal{static_cast<RefusalCode>(refusal.code()), refusal.message(), {}};
}
std::optional<std::int32_t> RawClient::stopAndWait(const std::string& entity) {
    // Receipts of earlier stops may still be under way; this one's has our id and the number that the signal
    // lane counts.
    const auto stop_id = session_->id_ + ":" + std::to_string(session_->signals_ + 1);
    stop(entity);
    const auto done = await(entity, [&](const auto& m) {
        return m.has_receipt() && m.receipt().stop_id() == stop_id &&
               m.receipt().stage() >= proto::StopReceipt::CALLBACK_RETURNED;
    });
    if (!done) return std::nullopt;
    return static_cast<std::int32_t>(done->receipt().stop_generation());
}
std::optional<proto::TaskEvent> RawClient::run(const std::string& entity, const proto::TaskRequest& task,
                                               LeaseNumber lease, std::int32_t generation, bool until_final) {
    proto::ToEntity body;
    *body.mutable_task() = task;
    send(entity, kMsgTask, body, lease, generation);
    const auto least = until_final ? proto::TASK_SUCCEEDED : proto::TASK_RUNNING;
    const auto answer = await(entity, [&](const auto& m) {
        return m.has_task() && m.task().task_id() == task.task_id() && m.task().state() >= least;
    });
    if (!answer) return std::nullopt;
    return answer->task();
}
std::optional<proto::EntityStatus> RawClient::status(const std::string& entity) {
    proto::ToEntity body;
    const auto id = newId();
    body.mutable_status_request()->set_request_id(id);
    send(entity, kMsgStatus, body);
    const auto sent = session_->paths_->sequence();
    std::unique_lock lock(session_->mutex_);
    std::optional<proto::EntityStatus> status;
    session_->changed_.wait_for(lock, kStatusTime, [&] {
        for (const auto& [from, message] : session_->messages_heard_)
            if (from == entity && message.has_status() && message.status().request_id() == id)
                status = message.status();
        return status || session_->refused_ == sent || !session_->connected_;
    });
    return status;
}

std::string newId() {
    SystemRandom random;
    return Id128::random(random).bytes();
}
std::string idText(const std::string& bytes) {
    const auto id = Id128::fromBytes(bytes);
    return id ? id->toString() : "";
}
proto::TaskRequest stepTask(const std::string& id, double seconds, double not_after_s) {
    proto::TaskRequest task;
    task.set_task_id(id);
    task.set_service("Step");
    auto& param = *task.add_params();
    param.set_name("Seconds");
    param.add_values()->set_dbl(seconds);
    task.set_not_after_s(not_after_s);
    return task;
}
proto::TaskRequest driveTask(const std::string& id) {
    proto::TaskRequest task;
    task.set_task_id(id);
    task.set_service("Drive");
    return task;
}

}  // namespace axon::faults
