// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <string>
#include <utility>
#include <vector>

#include "client/core/session_core.hpp"
#include "client/stops/stop_desk.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"

/// What the tests of the client's cores put in place of the world.
namespace axon::client::test {

struct SentMessage {
    std::string kind;  ///< "entity", "data", "request", "reset", "clear"
    Header head;
    proto::ToEntity body;
};

class RecordingLink final : public ServerLink {
  public:
    void sendToEntity(const Header& head, std::string bytes) override { record("entity", head, bytes); }
    void sendToEntityDataSeq(const Header& head, std::string bytes) override { record("data", head, bytes); }
    void sendRequest(const Header& head, std::string bytes) override { record("request", head, bytes); }
    void sendReset(const Header& head) override { record("reset", head, {}); }
    void sendClear(const Header& head) override { record("clear", head, {}); }
    void keepAlive(std::int64_t sequence, bool busy) override { beats.emplace_back(sequence, busy); }

    std::vector<SentMessage> take() { return std::exchange(sent, {}); }

    std::vector<SentMessage> sent;
    std::vector<std::pair<std::int64_t, bool>> beats;

  private:
    void record(const char* kind, const Header& head, const std::string& bytes) {
        SentMessage message{kind, head, {}};
        message.body.ParseFromString(bytes);
        sent.push_back(std::move(message));
    }
};

class RecordingObserver final : public SessionObserver {
  public:
    void onEntity(Presence presence, const Entity& entity) override {
        entities.emplace_back(presence, entity);
    }
    void onTask(const TaskReport& report) override { tasks.push_back(report); }
    void onRun(const RunReport& report) override { runs.push_back(report); }
    void onText(const Held&, const std::string& text) override { texts.push_back(text); }
    void onRaw(const Held&, const std::string& bytes) override { raws.push_back(bytes); }
    void onService(const Held&, const Service& service) override { services.push_back(service); }
    void onLost(const Held& held, const Refusal& why) override { lost.emplace_back(held, why); }
    void onOrphaned(const Held& held, const std::string&) override { orphaned.push_back(held); }
    void onResumed(const Held& held) override { resumed.push_back(held); }
    void onHandOver(const Held&, const HandOverRequest& request) override { hand_overs.push_back(request); }
    void onSample(Sample sample) override { samples.push_back(std::move(sample)); }
    void onTransferCredit(const Id128&, std::uint64_t offset, std::uint64_t limit) override {
        credits.emplace_back(offset, limit);
    }
    void onServerText(int code, const std::string& text) override { server_texts.emplace_back(code, text); }

    std::vector<std::pair<Presence, Entity>> entities;
    std::vector<TaskReport> tasks;
    std::vector<RunReport> runs;
    std::vector<std::string> texts, raws;
    std::vector<Service> services;
    std::vector<std::pair<Held, Refusal>> lost;
    std::vector<Held> orphaned, resumed;
    std::vector<HandOverRequest> hand_overs;
    std::vector<Sample> samples;
    std::vector<std::pair<std::uint64_t, std::uint64_t>> credits;
    std::vector<std::pair<int, std::string>> server_texts;
};

/// UUIDs that sort in the order of their numbers.
inline std::string uuid(int number) {
    auto digits = std::to_string(number);
    return "0000000" + digits.substr(0, 1) + "-1111-4111-8111-11111111111" + digits.substr(0, 1);
}

inline const Sender kMe{"99999999-1111-4111-8111-111111111111", "client1@lab", Role::Operator};

/// A core that is connected and knows of PeopleBot, PeopleBot and Cyton.
class CoreWorld {
  public:
    explicit CoreWorld(SessionCoreSettings settings = {})
        : core(settings, clock, random, link, observer, marks) {}

    void connect(const Watchdogs& watchdogs = {}) {
        core.onConnected(kMe, 3, watchdogs);
        join(1, "PeopleBot");
        join(2, "PeopleBot");
        join(3, "Cyton");
    }
    /// Its profile, and a status where none has come before.
    void join(int number, const std::string& name, const char* type = "MOBILE") {
        announce(number, name, type);
        if (!core.entities().entity(uuid(number)).ok()) status(number, EntityState::UNAV);
    }
    void announce(int number, const std::string& name, const char* type = "MOBILE") {
        proto::BasicProfile profile;
        profile.set_descr("a robot");
        core.onProfile(Presence::Joined, {uuid(number), name, "ROBOT", type}, profile.SerializeAsString());
    }
    void status(int number, EntityState state, const Sender& holder = {}, LeaseNumber held = {},
                std::int32_t generation = 0) {
        core.onStatus({uuid(number), state, false, generation, holder, held, {}});
    }
    void fromEntity(int number, const proto::ToClient& message) {
        Header head;
        head.entity = uuid(number);
        core.onEntityMsg(head, message.SerializeAsString());
    }
    /// The entity's answer to a check-out message that was sent.
    void answerCheckOut(const SentMessage& asked, RefusalCode code = RefusalCode::Ok, int lease = 1,
                        std::chrono::milliseconds grace = {}, const std::string& root = {}) {
        proto::ToClient message;
        auto& reply = *message.mutable_check_out();
        reply.set_request_id(asked.body.check_out().request_id());
        reply.set_phase(asked.body.check_out().phase());
        if (code != RefusalCode::Ok) {
            reply.mutable_refusal()->set_code(static_cast<proto::RefusalCode>(code));
            reply.mutable_refusal()->set_message("no");
            reply.mutable_refusal()->set_holder("client2@lab");
        } else if (asked.body.check_out().phase() != proto::RESERVE) {
            reply.mutable_lease()->set_epoch(1);
            reply.mutable_lease()->set_number(static_cast<std::uint32_t>(lease));
            reply.mutable_lease()->set_key("0123456789abcdef");
            reply.mutable_lease()->set_root(root);
            reply.set_grace_ms(static_cast<std::uint32_t>(grace.count()));
            auto& service = *reply.mutable_services()->add_services();
            service.set_name("Driving");
            service.set_is_active(true);
            auto& distance = *service.add_params();
            distance.set_name("Distance");
            distance.set_data_type(proto::INT);
            distance.set_units("mm");
            distance.set_minimum(0);
            distance.set_maximum(5000);
            auto& found = *service.add_params();
            found.set_name("Found");
            found.set_type(proto::OUTPUT);
            found.set_data_type(proto::STR);
            service.add_resources()->set_name("Map");
        }
        Header head;
        head.entity = asked.head.entity;
        core.onEntityMsg(head, message.SerializeAsString());
    }
    /// The entity's answer to who waits for it, or has it asked for.
    void answerPlace(const SentMessage& asked, int place, const std::string& kept = {}) {
        proto::ToClient message;
        auto& reply = *message.mutable_check_out();
        reply.set_request_id(asked.body.check_out().request_id());
        reply.set_phase(proto::TAKE);
        reply.set_place(static_cast<std::uint32_t>(place));
        reply.set_kept(kept);
        Header head;
        head.entity = asked.head.entity;
        core.onEntityMsg(head, message.SerializeAsString());
    }
    Held take(const std::string& name, int lease = 1, std::chrono::milliseconds grace = {}) {
        Held held;
        core.checkOuts().checkOut({name}, [&](const Result<std::vector<Held>>& granted) {
            if (granted) held = granted.value().front();
        });
        answerCheckOut(link.sent.back(), RefusalCode::Ok, lease, grace);
        link.sent.clear();
        return held;
    }
    void taskEvent(int number, const Id128& task, proto::TaskState state, double progress = -1) {
        proto::ToClient message;
        message.mutable_task()->set_task_id(task.bytes());
        message.mutable_task()->set_state(state);
        message.mutable_task()->set_progress(progress);
        fromEntity(number, message);
    }
    void reply(int number, const std::string& request, RefusalCode code = RefusalCode::Ok) {
        proto::ToClient message;
        message.mutable_reply()->set_request_id(request);
        message.mutable_reply()->mutable_refusal()->set_code(static_cast<proto::RefusalCode>(code));
        fromEntity(number, message);
    }
    void advance(Duration by) {
        clock.advance(by);
        core.onTimer();
        core.onHeartbeatTimer();
    }

    ManualClock clock;
    SeededRandom random{7};
    RecordingLink link;
    RecordingObserver observer;
    SignalMarks marks;
    SessionCore core;
};

/// The one answer of a request; a second one fails the test that looks.
template <class T>
struct Answer {
    int count = 0;
    Refusal refusal;
    std::function<void(Result<T>)> taker() {
        return [this](const Result<T>& result) {
            ++count;
            refusal = result.ok() ? Refusal{} : result.refusal();
        };
    }
};

}  // namespace axon::client::test
