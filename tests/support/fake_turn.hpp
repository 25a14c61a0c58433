// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/core_settings.hpp"

namespace axon::test {

/// What one owner of the Entity Manager's state sees of the rest, set by its unit test; keeps what the owner
/// tells.
struct FakeTurn final : entity_manager::Turn {
    struct Told {
        Sender to;
        std::string type;
        proto::ToClient message;
        Lane lane;
    };
    struct ToldPeer {
        Lane lane;
        std::string entity;
        std::string type;
        proto::ToEntity message;
    };
    struct Fired {
        entity_manager::Event event;
        Refusal reason;
    };
    TimePoint now() const override { return clock.now(); }
    EntityState state() const override { return in_state; }
    bool latched() const override { return latch; }
    bool linked() const override { return link; }
    bool connected() const override { return session; }
    Stops stops() const override { return stopped; }
    const entity_manager::LeaseBook::Held* held() const override { return lease ? &*lease : nullptr; }
    Refusal checkGeneration(std::int32_t seen) const override {
        if (static_cast<std::uint32_t>(seen) >= stopped.required) return {};
        return {RefusalCode::OldGeneration, "", {}};
    }
    Refusal checkLease(const Sender& sender, LeaseNumber under) const override {
        if (lease && lease->holder.id == sender.id && lease->number == under) return {};
        return {RefusalCode::NotHolder, "", {}};
    }
    Sender self() const override { return {"self", "This robot", Role::Operator}; }

    void fire(entity_manager::Incident& incident) override {
        fired.push_back({incident.event, incident.reason});
        if (on_fire) on_fire(incident);
    }
    void refuse(const entity_manager::Incident&, const Refusal& refusal) override {
        refused.push_back(refusal);
    }
    void reply(const Sender&, const std::string&, const Refusal& refusal) override {
        replies.push_back(refusal);
    }
    void tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane) override {
        told.push_back({to, type, message, lane});
    }
    void tellDroppable(const Sender& to, const char* type, const proto::ToClient& message) override {
        told.push_back({to, type, message, Lane::Data});
    }
    void tellPeer(Lane lane, const std::string& entity, const char* type,
                  const proto::ToEntity& message) override {
        told_peers.push_back({lane, entity, type, message});
    }
    bool toApplication(const proto::EmToEi& message) override {
        to_application.push_back(message);
        return true;
    }
    void serverLost(const std::string& reason) override { lost_servers.push_back(reason); }
    void warn(std::string text) override { warnings.push_back(std::move(text)); }
    entity_manager::CoreCounters& count() override { return counted; }

    bool hasTasks() const override { return !steps.empty(); }
    Refusal admitStep(const proto::TaskRequest& request) override {
        steps.push_back(request);
        return {};
    }
    void controlTask(const entity_manager::Incident&) override {}

    bool takesPart() const override { return false; }
    bool isReserved() const override { return false; }
    bool tellStep(proto::TaskEvent&) override { return false; }
    void lookAgain() override {}
    void removeResource(const std::string&, const std::string&) override {}

    Refusal leavesRoom(int, const proto::Param&) const override { return room; }
    void reconfigure(int, const proto::Param& param) override { reconfigured.push_back(param); }

    bool finishesAlone() const override { return task_finishes_alone; }
    void loseHolder(entity_manager::Incident& lost) override { fire(lost); }
    void endSpared(const std::string&) override {}
    void granted(entity_manager::Incident& granted) override { fire(granted); }
    void takeKeptProfiles() override {}
    void tellNews(std::string) override {}
    void notReady(std::string why) override { not_ready = std::move(why); }
    void tellStatus() override {}
    void profilesAreGood(const proto::BasicProfile&) override {
        entity_manager::Incident good{entity_manager::Event::ProfilesGood};
        fire(good);
    }

    ManualClock clock;
    EntityState in_state = EntityState::REG;
    std::optional<entity_manager::LeaseBook::Held> lease;
    Stops stopped;
    bool latch = false;
    bool link = true;
    bool session = true;
    bool task_finishes_alone = false;
    std::function<void(entity_manager::Incident&)> on_fire;  ///< what the state table would do
    std::vector<Fired> fired;
    std::vector<Refusal> refused, replies;
    Refusal room;  ///< what leavesRoom() says
    std::vector<proto::Param> reconfigured;
    std::vector<Told> told;
    std::vector<ToldPeer> told_peers;
    std::vector<proto::EmToEi> to_application;
    std::vector<std::string> warnings, lost_servers;
    std::string not_ready;
    std::vector<proto::TaskRequest> steps;
    entity_manager::CoreCounters counted;
};

}  // namespace axon::test
