// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/direct_liars.hpp"

#include <axon/messages.pb.h>

#include <algorithm>

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;
using direct::Keeping;

constexpr Duration kBeat = 40ms;
constexpr std::int64_t kFar = std::int64_t{1} << 52U;

}  // namespace

/// A stranger at an honest door: one connection, one or two openings. What it is told, it must be a refusal.
class DirectLiars::Knock final : public DirectCaller, public std::enable_shared_from_this<Knock> {
  public:
    Knock(DirectLiars& liars, const Robot& robot, Lane lane) : liars_(liars), robot_(robot), lane_(lane) {}
    bool honest() const override { return false; }
    /// Asks for a nonce, or does not.
    void begin(bool asks) {
        connection_ = &liars_.network_.connect(liars_.road_, liars_.outside_, robot_.manager->process());
        const auto weak = std::weak_ptr<DirectCaller>(weak_from_this());
        if (!asks) return open({});
        connection_->send(liars_.outside_, [to = robot_.manager, connection = connection_, lane = lane_,
                                            weak] { to->challenge(*connection, lane, weak); });
    }
    void challenged(Lane, const Id128& nonce) override {
        open(nonce);
        if (liars_.dice_.chance(0.3)) open(nonce);  // which was used
    }
    void opened(Lane, const std::string&) override {
        liars_.observer_.violated(Invariant::Unhurt,
                                  robot_.name + ": a stranger has opened a lane of a direct path");
    }
    void refused(Lane, const Refusal&) override {
        if (liars_.dice_.chance(0.5)) connection_->close(liars_.outside_);
    }
    void newEntityMsg(Lane, Keeping, const Header&, const std::string&) override {}
    void newHeartbeat(std::int64_t, bool) override {}

  private:
    void open(const Id128& nonce) {
        auto& dice = liars_.dice_;
        const auto& overheard = robot_.manager->overheard();
        const auto* core = robot_.manager->core();
        SaidOpening said;
        said.claim.lane = lane_;
        said.claim.nonce = nonce;
        said.claim.path = Id128::random(liars_.random_);
        // As if it were the holder's, which anybody is told who that is.
        if (core->held() != nullptr) {
            said.claim.lease = core->held()->number;
            said.claim.client = Id128::parse(uuidOf(core->held()->holder.id)).value_or(Id128{});
        }
        if (overheard && dice.chance(0.5)) said.claim.path = overheard->claim.path;
        const auto past = liars_.observer_.endedLeases();
        std::string key = Id128::random(liars_.random_).bytes();
        switch (dice.roll(5)) {
            case 0:
                break;
            case 1:  // the key of a lease that has ended, maybe another robot's
            case 2:
                if (past.empty()) break;
                {
                    const auto& [number, its_key] = past[dice.roll(past.size())];
                    key = its_key;
                    if (dice.chance(0.5)) said.claim.lease = number;
                }
                break;
            case 3:
                key = {};
                break;
            default:  // word for word, with the nonce of another connection
                if (overheard) {
                    said = *overheard;
                    said.claim.lane = dice.chance(0.8) ? lane_ : overheard->claim.lane;
                    return send(said);
                }
        }
        said.proof = dice.chance(0.1) ? std::string()
                                      : direct::proofOf(said.claim,
                                                        dice.chance(0.9) ? direct::Prover::Client
                                                                         : direct::Prover::EntityManager,
                                                        key);
        send(said);
    }
    void send(const SaidOpening& said) {
        ++liars_.observer_.counts().lies;
        connection_->send(liars_.outside_, [to = robot_.manager, connection = connection_, lane = lane_, said,
                                            weak = std::weak_ptr<DirectCaller>(weak_from_this())] {
            to->open(*connection, lane, said, weak);
        });
    }

    DirectLiars& liars_;
    const Robot robot_;
    const Lane lane_;
    Connection* connection_ = nullptr;
};

/// The holder's path, opened as it should be.
class DirectLiars::OwnPath final : public DirectCaller, public std::enable_shared_from_this<OwnPath> {
  public:
    OwnPath(DirectLiars& liars, const Robot& robot, LeaseNumber lease, std::string key,
            const std::string& client)
        : liars_(liars), robot_(robot), key_(std::move(key)) {
        claim_.lease = lease;
        claim_.client = Id128::parse(uuidOf(client)).value_or(Id128{});
        claim_.path = Id128::random(liars_.random_);
    }
    bool honest() const override { return false; }
    void begin() { connect(Lane::Data); }
    void close() {
        for (auto* connection : {data_, signal_})
            if (connection != nullptr) connection->close(liars_.outside_);
    }
    void challenged(Lane lane, const Id128& nonce) override {
        claim_.lane = lane;
        claim_.nonce = nonce;
        const SaidOpening said{claim_, direct::proofOf(claim_, direct::Prover::Client, key_)};
        auto* connection = lane == Lane::Data ? data_ : signal_;
        connection->send(liars_.outside_, [to = robot_.manager, connection, lane, said,
                                           weak = std::weak_ptr<DirectCaller>(weak_from_this())] {
            to->open(*connection, lane, said, weak);
        });
    }
    void opened(Lane lane, const std::string&) override {
        if (lane == Lane::Data) return connect(Lane::Signal);
        if (liars_.dice_.chance(0.8)) mark(claim_.path.bytes());
        open_ = true;
    }
    void refused(Lane, const Refusal&) override {}
    void newEntityMsg(Lane, Keeping, const Header&, const std::string&) override {}
    void newHeartbeat(std::int64_t, bool) override {}

    void mark(const std::string& path) {
        proto::ToEntity body;
        body.mutable_way()->set_path(path);
        Header head;
        head.entity = *liars_.entity_;
        head.msg_type = kMsgWay;
        head.held = claim_.lease;
        head.sequence = ++liars_.sequence_;
        liars_.server_.frontEnd()->sendToEntity(liars_.client_, head, body.SerializeAsString());
    }
    void lie() {
        if (!open_) return;
        ++liars_.observer_.counts().lies;
        auto& dice = liars_.dice_;
        Header head;
        head.held = claim_.lease;
        head.sequence = liars_.anyNumber(liars_.sequence_);
        switch (dice.roll(8)) {
            case 0:
            case 1:
            case 2:
                signal_->send(liars_.outside_,
                              [to = robot_.manager, connection = signal_, received = liars_.anyNumber(0),
                               busy = dice.chance(0.5)] { to->keepAlive(*connection, received, busy); });
                return;
            case 3:
                return mark(liars_.anyPath());
            case 4: {  // on the wrong lane
                auto* wrong = dice.chance(0.5) ? signal_ : nullptr;
                if (wrong != nullptr)
                    wrong->send(liars_.outside_, [to = robot_.manager, wrong, head] {
                        to->sendToEntity(*wrong, Keeping::Kept, head, "");
                    });
                else
                    data_->send(liars_.outside_, [to = robot_.manager, wrong = data_, head] {
                        to->sendStopSignal(*wrong, head, StopCause::ServerLost);
                    });
                return;
            }
            default:
                break;
        }
        proto::ToEntity body;
        static const char* const kTypes[] = {kMsgText,  kMsgRaw,      kMsgStatus, kMsgWay,
                                             kMsgRearm, kMsgCheckOut, kMsgText,   kMsgText};
        head.msg_type = kTypes[dice.roll(std::size(kTypes))];
        if (dice.chance(0.6)) body.mutable_text()->set_text("go");
        if (dice.chance(0.1)) body.mutable_rearm()->set_request_id(Id128::random(liars_.random_).bytes());
        if (dice.chance(0.1)) body.mutable_check_out()->set_phase(proto::TAKE);
        data_->send(liars_.outside_, [to = robot_.manager, connection = data_,
                                      keeping = dice.chance(0.8) ? Keeping::Kept : Keeping::Droppable, head,
                                      bytes = body.SerializeAsString()] {
            to->sendToEntity(*connection, keeping, head, bytes);
        });
    }

  private:
    void connect(Lane lane) {
        auto*& connection = lane == Lane::Data ? data_ : signal_;
        connection = &liars_.network_.connect(liars_.road_, liars_.outside_, robot_.manager->process());
        connection->send(liars_.outside_, [to = robot_.manager, connection, lane,
                                           weak = std::weak_ptr<DirectCaller>(weak_from_this())] {
            to->challenge(*connection, lane, weak);
        });
    }

    DirectLiars& liars_;
    const Robot robot_;
    const std::string key_;
    direct::Claim claim_;
    Connection* data_ = nullptr;
    Connection* signal_ = nullptr;
    bool open_ = false;
};

/// Of the holder.
struct DirectLiars::Ears final : public front_end_server::ClientOutbox {
    explicit Ears(DirectLiars& liars) : liars_(liars) {}
    void newBasicPrflMsg(Presence presence, const Registration& registration, std::string_view) override {
        if (presence != Presence::Left) names[registration.name] = registration.entity;
    }
    void newStatusMsg(const EntityStatus&) override {}
    bool newEntityMsg(Lane, const Header& head, std::string_view message, QueueShare) override {
        proto::ToClient body;
        if (!body.ParseFromArray(message.data(), static_cast<int>(message.size()))) return true;
        if (body.has_check_out() && liars_.wants_) {
            const auto& robot = liars_.robots_[*std::exchange(liars_.wants_, std::nullopt)];
            if (!body.check_out().has_lease() || head.entity != names[robot.name]) return true;
            const auto& lease = body.check_out().lease();
            liars_.entity_ = head.entity;
            liars_.lease_ = {static_cast<std::int32_t>(lease.epoch()),
                             static_cast<std::int32_t>(lease.number())};
            liars_.releases_at_ = liars_.timeline_.now() + liars_.dice_.between(200ms, 2500ms);
            liars_.path_ = std::make_shared<OwnPath>(liars_, robot, liars_.lease_, lease.key(),
                                                     front_end_server::FrontEndCore::me(*liars_.client_).id);
            liars_.callers_.push_back(liars_.path_);
            liars_.path_->begin();
        }
        if (body.has_lease_ended() && liars_.entity_ && head.entity == *liars_.entity_)
            liars_.releases_at_ = {};
        return true;
    }
    void newEntityMsgDataSeq(const Header&, std::string_view) override {}
    void newRefusalMsg(const Header&, const Refusal&) override {}
    void newStopAccepted(const Header&, std::int32_t) override {}
    void newUpdateMsg(RefusalCode, const std::string&) override {}
    void newHeartbeat(std::int64_t) override {}
    void disconnect(bool, const std::string&) override {
        if (!leaves)
            liars_.observer_.violated(Invariant::Unhurt,
                                      "a liar's session has ended, so nothing more was tried");
    }

    std::map<std::string, std::string> names;
    bool leaves = false;

  private:
    DirectLiars& liars_;
};

DirectLiars::DirectLiars(Timeline& timeline, Network& network, Process& outside, ServerStation& server,
                         Observer& observer, std::uint64_t seed, TimePoint from, TimePoint until,
                         std::vector<Robot> robots)
    : timeline_(timeline),
      network_(network),
      outside_(outside),
      server_(server),
      observer_(observer),
      dice_(seed),
      random_(seed),
      until_(until),
      robots_(std::move(robots)),
      ears_(std::make_shared<Ears>(*this)) {
    timeline_.at(from, outside_, [this] {
        logIn();
        beat();
        knock();
        hold();
    });
}

DirectLiars::~DirectLiars() = default;

void DirectLiars::knock() {
    if (timeline_.now() >= until_) return;
    knockOnce();
    timeline_.after(dice_.between(5ms, 400ms), outside_, [this] { knock(); });
}

void DirectLiars::knockOnce() {
    const auto& robot = robots_[dice_.roll(robots_.size())];
    const auto made = std::make_shared<Knock>(*this, robot, dice_.chance(0.7) ? Lane::Data : Lane::Signal);
    callers_.push_back(made);
    made->begin(dice_.chance(0.9));
}

std::string DirectLiars::anyPath() {
    const auto& overheard = robots_[dice_.roll(robots_.size())].manager->overheard();
    return overheard && dice_.chance(0.7) ? overheard->claim.path.bytes() : Id128::random(random_).bytes();
}

std::int64_t DirectLiars::anyNumber(std::int64_t last) {
    switch (dice_.roll(6)) {
        case 0:
            return kFar + static_cast<std::int64_t>(dice_.roll(100));
        case 1:
            return -static_cast<std::int64_t>(dice_.roll(100));
        case 2:
            return std::max<std::int64_t>(0, last - static_cast<std::int64_t>(dice_.roll(10)));
        default:
            return last + 1 + static_cast<std::int64_t>(dice_.roll(1000));
    }
}

void DirectLiars::logIn() {
    auto& front_end = *server_.frontEnd();
    client_ = front_end.setCallback("liar2@lab", Role::Operator, ears_).value();
    if (!front_end.attach(front_end_server::FrontEndCore::token(*client_), ears_).ok())
        observer_.violated(Invariant::Unhurt, "a liar could not log in, so nothing was tried");
}

void DirectLiars::beat() {
    if (timeline_.now() >= until_ && !entity_) {
        ears_->leaves = true;
        return server_.frontEnd()->leave(client_, front_end_server::Ending::Lost, "the liar is gone");
    }
    server_.frontEnd()->keepAlive(client_);
    timeline_.after(kBeat, outside_, [this] { beat(); });
}

void DirectLiars::hold() {
    if (entity_ && timeline_.now() >= releases_at_) release();
    if (timeline_.now() >= until_ && !entity_) return;
    if (entity_) {
        path_->lie();
    } else if (!wants_ && timeline_.now() < until_ - 4s && dice_.chance(0.02)) {
        checkOut();
    }
    timeline_.after(dice_.between(1ms, 80ms), outside_, [this] { hold(); });
}

void DirectLiars::checkOut() {
    const auto which = dice_.roll(robots_.size());
    const auto known = ears_->names.find(robots_[which].name);
    if (known == ears_->names.end()) return;
    wants_ = which;
    proto::ToEntity body;
    body.mutable_check_out()->set_request_id(Id128::random(random_).bytes());
    body.mutable_check_out()->set_phase(proto::TAKE);
    Header head;
    head.entity = known->second;
    head.msg_type = kMsgCheckOut;
    head.sequence = ++sequence_;
    server_.frontEnd()->sendToEntity(client_, head, body.SerializeAsString());
}

void DirectLiars::release() {
    proto::ToEntity body;
    body.mutable_release();
    Header head;
    head.entity = *std::exchange(entity_, std::nullopt);
    head.msg_type = kMsgRelease;
    head.held = lease_;
    sequence_ = std::max(sequence_, kFar) +
                10'000;  // above all that it has said by its paths, or it would not be heard
    head.sequence = sequence_;
    path_->close();
    server_.frontEnd()->sendToEntity(client_, head, body.SerializeAsString());
}

void DirectLiars::sayEndpoints(proto::CheckOutReply& reply) {
    keys_[{static_cast<std::int32_t>(reply.lease().epoch()),
           static_cast<std::int32_t>(reply.lease().number())}] = reply.lease().key();
    if (dice_.chance(0.2)) return;
    const auto to = [&] {
        return dice_.chance(0.8) ? std::string(kName) : robots_[dice_.roll(robots_.size())].name;
    };
    const auto data = to(), signal = dice_.chance(0.9) ? data : to();
    reply.set_direct_endpoint(endpointOf(data, Lane::Data));
    reply.set_direct_signal_endpoint(endpointOf(signal, Lane::Signal));
}

void DirectLiars::challenge(Connection& connection, Lane port, std::weak_ptr<DirectCaller> caller) {
    const auto nonce = Id128::random(random_);
    nonces_[&connection] = nonce;
    connection.send(outside_, [caller = std::move(caller), port, nonce] {
        if (const auto to = caller.lock()) to->challenged(port, nonce);
    });
}

void DirectLiars::open(Connection& connection, Lane port, const SaidOpening& said,
                       std::weak_ptr<DirectCaller> caller) {
    auto claim = said.claim;
    claim.nonce = nonces_[&connection];
    const auto key = keys_.find(claim.lease);
    const auto proof = direct::proofOf(
        claim, direct::Prover::EntityManager,
        key == keys_.end() || dice_.chance(0.1) ? Id128::random(random_).bytes() : key->second);
    backs_[&connection] = {port, caller, claim.client.toString(), {}};
    connection.onClosed(outside_, [this, &connection] { backs_.erase(&connection); });
    connection.send(outside_, [caller, port, proof] {
        if (const auto to = caller.lock()) to->opened(port, proof);
    });
    lieToHolder(connection);
}

void DirectLiars::sendStopSignal(Connection& connection, const Header& head, StopCause) {
    const auto back = backs_.find(&connection);
    if (back != backs_.end())
        back->second.stops.push_back(back->second.holder + ':' + std::to_string(head.sequence));
}

void DirectLiars::keepAlive(Connection& connection, std::int64_t received, bool) {
    const auto back = backs_.find(&connection);
    if (back == backs_.end() || dice_.chance(0.05)) return;
    connection.send(outside_,
                    [caller = back->second.caller, its = anyNumber(received), asks = dice_.chance(0.2)] {
                        if (const auto to = caller.lock()) to->newHeartbeat(its, asks);
                    });
}

void DirectLiars::lieToHolder(Connection& connection) {
    if (timeline_.now() >= until_) return connection.close(outside_);
    timeline_.after(dice_.between(2ms, 150ms), outside_, [this, &connection] {
        const auto back = backs_.find(&connection);
        if (back != backs_.end()) lieToHolder(connection);
    });
    const auto& back = backs_.at(&connection);
    ++observer_.counts().lies;
    Header head;
    head.held = keys_.empty() ? LeaseNumber{} : keys_.rbegin()->first;
    head.sequence = anyNumber(said_);
    proto::ToClient body;
    const auto something = Id128::random(random_).bytes();
    switch (dice_.roll(6)) {
        case 0:
            head.msg_type = kMsgReceipt;
            body.mutable_receipt()->set_stop_id(back.stops.empty()
                                                    ? back.holder + ":" + std::to_string(dice_.roll(60))
                                                    : back.stops[dice_.roll(back.stops.size())]);
            body.mutable_receipt()->set_stage(static_cast<proto::StopReceipt::Stage>(dice_.roll(8)));
            body.mutable_receipt()->set_stop_generation(static_cast<std::uint32_t>(dice_.roll(1000)));
            break;
        case 1:
            head.msg_type = kMsgReply;
            body.mutable_reply()->set_request_id(something);
            break;
        case 2:
            head.msg_type = kMsgTask;
            body.mutable_task()->set_task_id(something);
            body.mutable_task()->set_state(proto::TASK_SUCCEEDED);
            break;
        case 3:
            head.msg_type = kMsgWay;
            body.mutable_way()->set_path(anyPath());
            break;
        case 4:
            head.msg_type = kMsgCheckOut;
            body.mutable_check_out()->set_request_id(something);
            body.mutable_check_out()->mutable_lease()->set_number(7);
            break;
        default:
            head.msg_type = kMsgText;
            body.mutable_text()->set_text("hello");
            break;
    }
    said_ = std::max(said_, head.sequence < kFar ? head.sequence : said_);
    connection.send(outside_, [caller = back.caller, lane = back.lane,
                               keeping = dice_.chance(0.8) ? Keeping::Kept : Keeping::Droppable, head,
                               bytes = dice_.chance(0.9) ? body.SerializeAsString() : something] {
        if (const auto to = caller.lock()) to->newEntityMsg(lane, keeping, head, bytes);
    });
}

}  // namespace axon::simulation
