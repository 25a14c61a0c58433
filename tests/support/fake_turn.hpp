// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "entity_manager/entity_manager_core.hpp"
#include "entity_manager/turn.hpp"

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
    TimePoint now() const override { return clock.now(); }
    EntityState state() const override { return in_state; }
    const Sender* holder() const override { return held_by ? &*held_by : nullptr; }
    bool linked() const override { return link; }
    bool connected() const override { return session; }
    void tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane) override {
        told.push_back({to, type, message, lane});
    }
    void tellDroppable(const Sender& to, const char* type, const proto::ToClient& message) override {
        told.push_back({to, type, message, Lane::Data});
    }
    bool toApplication(const proto::EmToEi& message) override {
        to_application.push_back(message);
        return true;
    }
    void warn(std::string text) override { warnings.push_back(std::move(text)); }
    entity_manager::CoreCounters& counters() override { return counted; }

    ManualClock clock;
    EntityState in_state = EntityState::REG;
    std::optional<Sender> held_by;
    bool link = true;
    bool session = true;
    std::vector<Told> told;
    std::vector<proto::EmToEi> to_application;
    std::vector<std::string> warnings;
    entity_manager::CoreCounters counted;
};

}  // namespace axon::test
