// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/liars.hpp"

#include <axon/messages.pb.h>

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "common/rights.hpp"

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;

constexpr Duration kBeat = 40ms;

}  // namespace

/// What they are told; from anybody, of anything.
struct Liars::Ears final : public front_end_server::ClientOutbox, public entity_server::EntityOutbox {
    // As a client.
    void newBasicPrflMsg(Presence presence, const Registration& registration, std::string_view) override {
        if (presence == Presence::Left) statuses.erase(registration.entity);
    }
    void newStatusMsg(const EntityStatus& status) override {
        statuses[status.entity] = status;
        if (!status.holder.id.empty()) people[status.holder.id] = status.holder;
    }
    bool newEntityMsg(Lane, const Header&, std::string_view, QueueShare) override { return true; }
    void newEntityMsgDataSeq(const Header&, std::string_view) override {}
    void newStopAccepted(const Header&, std::int32_t) override {}
    void newUpdateMsg(RefusalCode, const std::string&) override {}
    // As an entity.
    bool newClientMsg(const Header& head, std::string_view message, QueueShare) override {
        proto::ToEntity body;
        if (body.ParseFromArray(message.data(), static_cast<int>(message.size())) && body.has_check_out())
            asked.emplace_back(head.sender, body.check_out().request_id());
        return true;
    }
    void newClientMsgDataSeq(const Header&, std::string_view) override {}
    bool stopSignal(const Header& head, StopCause) override {
        stops.push_back(head.sender.id + ':' + std::to_string(head.sequence));
        return true;
    }
    bool resetSignal(const Header&) override { return true; }
    bool clearSignal(const Header&) override { return true; }
    void newClientUpdate(const Header&, ClientChange) override {}
    // As both.
    void newRefusalMsg(const Header&, const Refusal&) override {}
    void newHeartbeat(std::int64_t) override {}
    void disconnect(bool, const std::string&) override { disconnected = true; }

    std::map<std::string, EntityStatus> statuses;
    std::map<std::string, Sender> people;
    std::vector<std::pair<Sender, std::string>> asked;
    std::vector<std::string> stops;
    bool disconnected = false;
};

Liars::Liars(Timeline& timeline, Process& outside, ServerStation& server, Observer& observer,
             DirectLiars& direct, std::uint64_t seed, TimePoint from, TimePoint until)
    : timeline_(timeline),
      outside_(outside),
      server_(server),
      observer_(observer),
      direct_(direct),
      dice_(seed),
      random_(seed),
      until_(until),
      ears_(std::make_shared<Ears>()),
      uuid_(Id128::uuid(random_).toString()) {
    timeline_.at(from, outside_, [this] {
        logIn();
        lie();
        beat();
    });
}

Liars::~Liars() = default;

void Liars::logIn() {
    auto& front_end = *server_.frontEnd();
    client_ = front_end.setCallback("liar@lab", Role::Operator, ears_).value();
    auto& entities = *server_.entityServer();
    entity_ = entities.open(ears_);
    if (!front_end.attach(front_end_server::FrontEndCore::token(*client_), ears_).ok() ||
        !entities.attach(entity_server::EntityServerCore::token(*entity_), ears_).ok() ||
        !entities.sendBasicPrfl(entity_, {uuid_, "Liar", "ROBOT", "MOBILE"}, "\x0a\x01x").ok())
        observer_.violated(Invariant::Unhurt, "the liars could not log in, so nothing was tried");
    EntityStatus idle;
    idle.entity = uuid_;
    idle.state = EntityState::IDLE;
    entities.sendStatus(entity_, idle);
}

void Liars::beat() {
    if (timeline_.now() >= until_) return leave();
    server_.frontEnd()->keepAlive(client_);
    server_.entityServer()->keepAlive(entity_);
    timeline_.after(kBeat, outside_, [this] { beat(); });
}

void Liars::leave() {
    server_.frontEnd()->leave(client_, front_end_server::Ending::Lost, "the liar is gone");
    server_.entityServer()->leave(entity_, false, "the liar is gone");
}

void Liars::lie() {
    if (timeline_.now() >= until_) return;
    if (ears_->disconnected)
        return observer_.violated(Invariant::Unhurt, "a liar's session has ended, so nothing more was tried");
    ++observer_.counts().lies;
    if (dice_.chance(0.5)) {
        lieAsClient();
    } else {
        lieAsEntity();
    }
    timeline_.after(dice_.chance(0.2) ? dice_.between(1us, 2ms) : dice_.between(5ms, 250ms), outside_,
                    [this] { lie(); });
}

/// Of an honest entity; empty where none is known yet.
EntityStatus Liars::anyStatus() {
    std::vector<EntityStatus> honest;
    for (const auto& [entity, status] : ears_->statuses)
        if (entity != uuid_) honest.push_back(status);
    return honest.empty() ? EntityStatus{} : honest[dice_.roll(honest.size())];
}

/// As its holder would have it, now and then a little off.
Header Liars::headTo(const EntityStatus& target, const char* msg_type) {
    Header head;
    head.sender = target.holder;
    head.entity = target.entity;
    head.msg_type = msg_type;
    head.held = target.held;
    head.stop_generation = target.stop_generation;
    if (dice_.chance(0.1)) head.held.number += 1;
    if (dice_.chance(0.1)) head.stop_generation += dice_.chance(0.5) ? 1 : -1;
    const auto kind = dice_.roll(10);
    head.sequence = kind == 0 ? 0 : kind == 1 ? -5 : kind == 2 ? kServerSequences + 7 : ++sequence_;
    return head;
}

void Liars::lieAsClient() {
    const auto target = anyStatus();
    if (target.entity.empty()) return;
    auto& front_end = *server_.frontEnd();
    proto::ToEntity body;
    const auto request = Id128::random(random_).bytes();
    switch (dice_.roll(15)) {
        case 0:
            return front_end.sendResetSignal(client_, headTo(target, ""));
        case 1:
            return front_end.sendClearSignal(client_, headTo(target, ""));
        case 2:
            return front_end.sendToEntity(client_, headTo(target, kMsgTask), request + request);
        case 3:
            body.mutable_task()->set_task_id(request);
            body.mutable_task()->set_service("Driving");
            break;
        case 4:
            body.mutable_rearm()->set_request_id(request);
            break;
        case 5:
            body.mutable_release();
            break;
        case 6:
            body.mutable_set_param()->set_request_id(request);
            body.mutable_set_param()->set_service("Driving");
            break;
        case 7:
            body.mutable_task_control()->set_task_id(request);
            body.mutable_task_control()->set_action(proto::CANCEL);
            break;
        case 8:
            body.mutable_check_out()->set_request_id(request);
            body.mutable_check_out()->set_phase(dice_.chance(0.5) ? proto::ABORT : proto::COMMIT);
            break;
        case 9: {
            auto& resume = *body.mutable_check_out();
            resume.set_request_id(request);
            resume.set_phase(proto::RESUME_LEASE);
            resume.mutable_resume()->set_epoch(static_cast<std::uint32_t>(target.held.epoch));
            resume.mutable_resume()->set_number(static_cast<std::uint32_t>(target.held.number));
            resume.mutable_resume()->set_key(request);
            break;
        }
        case 10:
            body.mutable_hand_over_answer()->set_accept(true);
            break;
        case 11:
            body.mutable_raw()->add_data("forwards");
            break;
        case 12:
            body.mutable_way()->set_path(direct_.anyPath());
            break;
        case 13:
            body.mutable_from_master()->set_run_id(request);
            body.mutable_from_master()->mutable_end()->set_stop(true);
            break;
        default:
            body.mutable_text()->set_text("go");
            break;
    }
    // Under its own name, or under another's.
    const auto all = rights();
    const auto* right = rightOf(body.body_case());
    const auto& name = dice_.chance(0.8) ? *right : all[dice_.roll(all.size())];
    front_end.sendToEntity(client_, headTo(target, std::string(name.msg_type).c_str()),
                           body.SerializeAsString());
}

void Liars::lieAsEntity() {
    auto& entities = *server_.entityServer();
    const auto target = anyStatus();
    const auto request = Id128::random(random_).bytes();
    Sender somebody;
    if (!ears_->people.empty()) {
        auto person = ears_->people.begin();
        std::advance(person, static_cast<std::ptrdiff_t>(dice_.roll(ears_->people.size())));
        somebody = person->second;
    }
    Header head;
    head.sender = somebody;
    head.entity = dice_.chance(0.5) ? uuid_ : target.entity;
    head.held = target.held;
    head.stop_generation = target.stop_generation;
    head.sequence = ++sequence_;
    proto::ToClient message;
    const auto tell = [&](const char* msg_type, Lane lane = Lane::Data) {
        head.msg_type = msg_type;
        entities.sendToClient(entity_, lane, head, message.SerializeAsString());
    };
    switch (dice_.roll(13)) {
        case 0:
        case 1: {
            EntityStatus status;
            status.entity = dice_.chance(0.8) ? uuid_ : target.entity;
            status.state = static_cast<EntityState>(dice_.roll(9));
            if (dice_.chance(0.5)) status.state = EntityState::BUSY;
            status.holder = somebody;
            status.held = {1, static_cast<std::int32_t>(dice_.roll(9))};
            status.latched = dice_.chance(0.5);
            status.stop_generation = static_cast<std::int32_t>(dice_.roll(50));
            status.waiting = static_cast<std::int32_t>(dice_.roll(5));
            status.orphaned = dice_.chance(0.2);
            return entities.sendStatus(entity_, status);
        }
        case 2: {  // the name and the UUID of another
            const auto ears = std::make_shared<Ears>();
            const auto session = entities.open(ears);
            static_cast<void>(entities.attach(entity_server::EntityServerCore::token(*session), ears));
            static_cast<void>(
                entities.sendBasicPrfl(session, {target.entity, "left", "ROBOT", "MOBILE"}, "\x0a\x01x"));
            return entities.leave(session, dice_.chance(0.5), "the liar is gone");
        }
        case 3: {  // a grant to who has asked for it, or has not
            auto& reply = *message.mutable_check_out();
            reply.set_request_id(request);
            if (!ears_->asked.empty() && dice_.chance(0.8)) {
                const auto& [who, id] = ears_->asked[dice_.roll(ears_->asked.size())];
                head.sender = who;
                head.entity = uuid_;
                reply.set_request_id(id);
            }
            reply.set_phase(proto::TAKE);
            reply.mutable_lease()->set_epoch(static_cast<std::uint32_t>(dice_.roll(3)));
            reply.mutable_lease()->set_number(static_cast<std::uint32_t>(dice_.roll(9)));
            reply.mutable_lease()->set_key(request);
            reply.set_stop_generation(static_cast<std::uint32_t>(dice_.roll(1000)));
            direct_.sayEndpoints(reply);
            return tell(kMsgCheckOut);
        }
        case 4: {
            auto& ended = *message.mutable_lease_ended();
            ended.mutable_lease()->set_epoch(static_cast<std::uint32_t>(target.held.epoch));
            ended.mutable_lease()->set_number(static_cast<std::uint32_t>(target.held.number));
            return tell(kMsgRelease);
        }
        case 5: {
            auto& receipt = *message.mutable_receipt();
            receipt.set_stop_id(ears_->stops.empty() ? somebody.id + ":1"
                                                     : ears_->stops[dice_.roll(ears_->stops.size())]);
            receipt.set_stage(proto::StopReceipt::STANDSTILL);
            receipt.set_stop_generation(static_cast<std::uint32_t>(dice_.roll(1000)));
            return tell(kMsgReceipt, Lane::Signal);
        }
        case 6:
            message.mutable_task()->set_task_id(request);
            message.mutable_task()->set_state(proto::TASK_SUCCEEDED);
            return tell(kMsgTask);
        case 7:
            message.mutable_hand_over()->set_request_id(request);
            return tell(kMsgHandOver);
        case 8:  // a mark of another's path, or of its own
            message.mutable_way()->set_path(direct_.anyPath());
            return tell(kMsgWay);
        case 9:
            head.msg_type = kMsgReply;
            return entities.sendToClient(entity_, Lane::Data, head, request + request);
        default:
            break;
    }
    if (target.entity.empty()) return;
    // To a peer.
    head = headTo(target, kMsgCollaboration);
    proto::ToEntity body;
    switch (dice_.roll(6)) {
        case 5:
            body.mutable_way()->set_path(direct_.anyPath());
            head.msg_type = kMsgWay;
            break;
        case 0:
            body.mutable_from_master()->set_run_id(request);
            body.mutable_from_master()->mutable_end()->set_stop(true);
            break;
        case 1: {
            body.mutable_from_master()->set_run_id(request);
            auto& invitation = *body.mutable_from_master()->mutable_invitation();
            invitation.set_by(somebody.name);
            invitation.set_watchdog_ms(1);
            auto& step = *invitation.add_steps();
            step.mutable_task()->set_task_id(request);
            step.mutable_task()->set_service("Driving");
            break;
        }
        case 2:
            body.mutable_from_slave()->set_run_id(request);
            body.mutable_from_slave()->mutable_departure();
            break;
        case 3:
            body.mutable_raw()->add_data("forwards");
            head.msg_type = kMsgRaw;
            break;
        default:
            body.mutable_task()->set_task_id(request);
            body.mutable_task()->set_service("Driving");
            if (dice_.chance(0.5)) head.msg_type = kMsgTask;
            break;
    }
    entities.sendToPeer(entity_, dice_.chance(0.2) ? Lane::Signal : Lane::Data, head,
                        body.SerializeAsString());
}

}  // namespace axon::simulation
