// SPDX-License-Identifier: GPL-2.0-or-later
// What the robot application uploads, until it is good, without the rest of the Entity Manager.
#include "entity_manager/core/presence/profiles.hpp"

#include <gtest/gtest.h>

#include "messages/values.hpp"
#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

/// What goes by profiles that are good.
struct NotingOthers final : Profiles::Others {
    explicit NotingOthers(test::FakeTurn& its_turn) : turn(its_turn) {}
    void profilesAreGood(const proto::BasicProfile&) override {
        Incident good{Event::ProfilesGood};
        turn.fire(good);
    }
    void tellStatus() override {}
    void tellNews(std::string) override {}
    test::FakeTurn& turn;
};

struct TheProfiles : testing::Test {
    TheProfiles() {
        turn.in_state = EntityState::INIT;
        turn.on_fire = [this](Incident& incident) {
            if (incident.event == Event::ProfileUploaded || incident.event == Event::KeptProfileTaken)
                profiles.consider();
            if (incident.event == Event::ProfilesGood) turn.in_state = EntityState::IDLE;
            if (incident.event == Event::ProfilesBad) profiles.report();
        };
        profiles.linkUp();
        profiles.await();
    }
    void upload(bool services, const std::string& xml) {
        proto::ProfileUpload upload;
        upload.set_services(services);
        upload.set_file_name(services ? "services.xml" : "basic.xml");
        upload.set_xml(xml);
        profiles.uploaded(upload);
    }
    std::string whyNotReady() const { return readiness.whyNot(EntityState::INIT); }
    Refusal toldApplication() const { return toRefusal(turn.to_application.back().profile_error()); }

    test::MemoryResources store;
    test::FakeTurn turn;
    ServiceProfiler profiler;
    NotingOthers others{turn};
    Readiness readiness{"Rig"};
    Profiles profiles{turn, others, readiness, store, profiler, {"self", "Rig", 3s}};
};

TEST_F(TheProfiles, BothAreNeededAndTheServicesAreLoadedThen) {
    upload(false, test::kRigBasicProfile);
    EXPECT_EQ(turn.fired.back().event, Event::ProfileUploaded);
    EXPECT_EQ(profiler.profile().services_size(), 0);
    upload(true, test::kRigServicesProfile);
    EXPECT_EQ(turn.fired.back().event, Event::ProfilesGood);
    EXPECT_GT(profiler.profile().services_size(), 0);
    EXPECT_EQ(profiles.nextDeadline(), TimePoint::max());
}

TEST_F(TheProfiles, WhatIsWrongIsToldToTheApplicationAndToWhoeverAsks) {
    upload(true, test::kRigServicesProfile);
    upload(false, "<BasicProfile/>");
    EXPECT_EQ(turn.fired.back().event, Event::ProfilesBad);
    EXPECT_NE(whyNotReady(), "");
    EXPECT_EQ(toldApplication().message, whyNotReady());
}

TEST_F(TheProfiles, WhatIsMissingIsSaidAfterAWhile) {
    upload(false, test::kRigBasicProfile);
    EXPECT_EQ(profiles.nextDeadline(), turn.now() + 3s);
    turn.clock.advance(3s);
    profiles.onTimer();
    ASSERT_EQ(turn.warnings.size(), 1U);
    EXPECT_NE(turn.warnings[0].find("no services profile"), std::string::npos);
    EXPECT_EQ(whyNotReady(), turn.warnings[0]);
    EXPECT_EQ(profiles.nextDeadline(), TimePoint::max());
}

TEST_F(TheProfiles, WhileSomebodyHoldsTheEntityAProfileIsKeptForTheRelease) {
    upload(false, test::kRigBasicProfile);
    upload(true, test::kRigServicesProfile);
    turn.in_state = EntityState::REG;
    const auto fired = turn.fired.size();
    upload(false, test::kRigBasicProfile);
    profiles.takeKept();
    EXPECT_EQ(turn.fired.size(), fired);
    EXPECT_EQ(toldApplication().code, RefusalCode::WrongState);

    turn.in_state = EntityState::IDLE;
    profiles.takeKept();
    ASSERT_EQ(turn.fired.size(), fired + 2);
    EXPECT_EQ(turn.fired[fired].event, Event::KeptProfileTaken);
    EXPECT_EQ(turn.fired.back().event, Event::ProfilesGood);
    profiles.takeKept();
    EXPECT_EQ(turn.fired.size(), fired + 2) << "it was taken";
}

TEST_F(TheProfiles, AServiceThatIsOffStaysOffWhenTheProfileIsReadAnew) {
    upload(false, test::kRigBasicProfile);
    upload(true, test::kRigServicesProfile);
    proto::ServiceActive off;
    off.set_service(profiler.record(0).name());
    off.set_active(false);
    turn.lease.emplace().holder.id = "client";
    profiles.activeIs(off);
    ASSERT_FALSE(turn.told.empty());
    EXPECT_EQ(turn.told[0].message.service().name(), off.service()) << "its holder is told";
    upload(true, test::kRigServicesProfile);
    EXPECT_FALSE(profiler.record(0).is_active());

    off.set_service("Unheard of");
    profiles.activeIs(off);
    EXPECT_EQ(turn.counted.unexpected, 1U);
}

}  // namespace
}  // namespace axon::entity_manager
