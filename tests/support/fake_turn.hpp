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
    Refusal checkLease(const Sender& sender, LeaseNumber under) const override {
        if (lease && lease->holder.id == sender.id && lease->number == under) return {};
        return {RefusalCode::NotHolder, "", {}};
    }

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
    bool toApplication(const proto::EmToEi& message) override {
        if (link_takes) to_application.push_back(message);
        return link_takes;
    }
    void warn(std::string text) override { warnings.push_back(std::move(text)); }
    entity_manager::CoreCounters& count() override { return counted; }

    ManualClock clock;
    EntityState in_state = EntityState::REG;
    std::optional<entity_manager::LeaseBook::Held> lease;
    Stops stopped;
    bool latch = false;
    bool link = true;
    bool link_takes = true;  ///< false: each message is larger than the link takes at once
    bool session = true;
    std::function<void(entity_manager::Incident&)> on_fire;  ///< what the state table would do
    std::vector<Fired> fired;
    std::vector<Refusal> refused, replies;
    std::vector<Told> told;
    std::vector<proto::EmToEi> to_application;
    std::vector<std::string> warnings;
    entity_manager::CoreCounters counted;
};

}  // namespace axon::test
