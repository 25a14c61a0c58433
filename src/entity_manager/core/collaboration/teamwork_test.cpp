// SPDX-License-Identifier: GPL-2.0-or-later
// The entity's part in the run of another master, without the rest of the Entity Manager. How whole runs go
// is claimed in collaborations_test.cpp.
#include "entity_manager/core/collaboration/teamwork.hpp"

#include <gtest/gtest.h>

#include "collaboration/sub_lease.hpp"
#include "messages/values.hpp"
#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

const std::string kRun(16, 'r');

proto::ServicesProfile oneService() {
    proto::ServicesProfile profile;
    profile.add_services()->set_name("Driving");
    return profile;
}

/// What the tasks and the way to other entities would do.
struct NotingOthers final : Teamwork::Others {
    struct Told {
        Lane lane;
        std::string entity;
        std::string type;
        proto::ToEntity message;
    };
    Sender self() const override { return {"self", "This robot", Role::Operator}; }
    void tellPeer(Lane lane, const std::string& entity, const char* type,
                  const proto::ToEntity& message) override {
        told.push_back({lane, entity, type, message});
    }
    bool hasTasks() const override { return !steps.empty(); }
    Refusal admitStep(const proto::TaskRequest& request) override {
        steps.push_back(request);
        return {};
    }
    void controlTask(const Incident&) override {}
    std::vector<Told> told;
    std::vector<proto::TaskRequest> steps;
};

struct Teamworks : testing::Test {
    Teamworks() {
        profiler.load(oneService(), "self", {});
        LeaseBook::Held held;
        held.number = {1, 7};
        held.key = Id128::random(random);
        held.holder = {"client", "Ada", Role::Operator};
        held.root = std::string(16, 'x');
        turn.lease = held;
    }
    proto::FromMaster invitation() const {
        proto::FromMaster message;
        message.set_run_id(kRun);
        auto& lease = *message.mutable_invitation()->mutable_lease();
        lease.set_epoch(1);
        lease.set_number(7);
        lease.set_root(turn.lease->root);
        lease.set_stop_generation(turn.stopped.required);
        collaboration::seal(lease, {kRun, master.id, "self"}, turn.lease->key.bytes());
        return message;
    }
    const proto::FromSlave& answered() const { return others.told.back().message.from_slave(); }
    RefusalCode refused() const { return toRefusal(answered().answer().problems(0).refusal()).code; }
    void hear(proto::FromMaster said) {
        proto::ToEntity message;
        said.set_run_id(kRun);
        message.mutable_from_master()->Swap(&said);
        Header head;
        head.sender = master;
        EXPECT_TRUE(teamwork.hear(head, message));
    }
    Id128 order(std::int32_t step) {
        const auto id = Id128::random(random);
        proto::FromMaster said;
        said.mutable_order()->set_step(step);
        said.mutable_order()->mutable_task()->set_task_id(id.bytes());
        said.mutable_order()->mutable_task()->set_service("Driving");
        hear(said);
        return id;
    }
    static proto::TaskEvent event(const Id128& id, proto::TaskState state) {
        proto::TaskEvent made;
        made.set_task_id(id.bytes());
        made.set_state(state);
        return made;
    }

    const Sender master{"master", "Leader", Role::Operator};
    SeededRandom random{1};
    test::MemoryStorage storage;
    test::FakeTurn turn;
    ServiceProfiler profiler;
    TaskMemory memory;
    JournalWriter journal{turn, nullptr};
    NotingOthers others;
    Teamwork teamwork{turn, others, journal, storage, random, profiler, memory, {"self", 250ms}};
};

TEST_F(Teamworks, AMasterIsObeyedThatTheHolderHasGivenTheRight) {
    teamwork.considerInvitation(master, invitation());
    EXPECT_TRUE(teamwork.takesPart());
    EXPECT_EQ(answered().answer().problems_size(), 0);
    ASSERT_EQ(turn.fired.size(), 1U);
    EXPECT_EQ(turn.fired[0].event, Event::CollaborationJoined);

    teamwork.considerInvitation(master, invitation());
    EXPECT_EQ(refused(), RefusalCode::WrongState) << "one run at a time";
}

TEST_F(Teamworks, ASealOfAnotherLeaseOrFromBeforeAStopIsRefused) {
    auto forged = invitation();
    forged.mutable_invitation()->mutable_lease()->set_proof(std::string(32, '0'));
    teamwork.considerInvitation(master, forged);
    EXPECT_EQ(refused(), RefusalCode::NotHolder);

    const auto old = invitation();
    turn.stopped.required = turn.stopped.generation = 1;
    teamwork.considerInvitation(master, old);
    EXPECT_EQ(refused(), RefusalCode::OldGeneration);

    turn.latch = true;
    teamwork.considerInvitation(master, invitation());
    EXPECT_EQ(refused(), RefusalCode::Latched);
    EXPECT_FALSE(teamwork.takesPart());
    EXPECT_TRUE(turn.fired.empty());
}

TEST_F(Teamworks, AStepIsATaskWhoseReportsGoToTheMaster) {
    teamwork.considerInvitation(master, invitation());
    const auto id = order(4);
    ASSERT_EQ(others.steps.size(), 1U);
    EXPECT_EQ(others.steps[0].service(), "Driving");

    teamwork.onTimer();  // its first beat
    const auto before = others.told.size();
    auto running = event(id, proto::TASK_RUNNING);
    EXPECT_TRUE(teamwork.tellStep(running));
    EXPECT_EQ(others.told.size(), before) << "a short step is told with its end";
    EXPECT_EQ(teamwork.nextDeadline(), turn.now() + 5ms);
    auto succeeded = event(id, proto::TASK_SUCCEEDED);
    EXPECT_TRUE(teamwork.tellStep(succeeded));
    ASSERT_EQ(others.told.size(), before + 1);
    EXPECT_EQ(answered().report().step(), 4);
    EXPECT_EQ(answered().report().event().state(), proto::TASK_SUCCEEDED);
    EXPECT_FALSE(teamwork.tellStep(succeeded)) << "it is no step any more";
}

TEST_F(Teamworks, ASilentMasterIsLostAndHearsWhyWhenItSpeaksAgain) {
    teamwork.considerInvitation(master, invitation());
    proto::FromMaster beat;
    beat.mutable_beat();
    hear(beat);
    turn.clock.advance(249ms);
    teamwork.onTimer();
    EXPECT_TRUE(teamwork.takesPart());
    turn.clock.advance(1ms);
    teamwork.onTimer();
    EXPECT_FALSE(teamwork.takesPart());
    EXPECT_EQ(turn.fired.back().event, Event::MasterLost);

    others.told.clear();
    hear(beat);
    ASSERT_EQ(others.told.size(), 1U);
    EXPECT_EQ(toRefusal(answered().departure().reason()).code, RefusalCode::TimedOut);
}

TEST_F(Teamworks, TheMastersEndEndsItsPartForGood) {
    teamwork.considerInvitation(master, invitation());
    proto::FromMaster end;
    end.mutable_end();
    hear(end);
    EXPECT_FALSE(teamwork.takesPart());
    EXPECT_EQ(turn.fired.back().event, Event::CollaborationEnded);

    teamwork.considerInvitation(master, invitation());
    EXPECT_EQ(refused(), RefusalCode::Duplicate) << "a run has one beginning";
}

TEST_F(Teamworks, AnEndWithAStepUnderWayIsAStop) {
    teamwork.considerInvitation(master, invitation());
    order(0);
    proto::FromMaster end;
    end.mutable_end();
    hear(end);
    EXPECT_EQ(turn.fired.back().event, Event::CollaborationStopped);
}

TEST_F(Teamworks, RawDataWithoutARunGoesNowhereAndIsAnsweredSeldom) {
    proto::LinkRaw raw;
    raw.set_to("Leader");
    teamwork.sendRaw(raw);
    teamwork.sendRaw(raw);
    EXPECT_EQ(turn.counted.undelivered, 2U);
    ASSERT_EQ(turn.to_application.size(), 1U);
    EXPECT_EQ(toRefusal(turn.to_application[0].not_sent().reason()).code, RefusalCode::WrongState);
}

TEST_F(Teamworks, RawDataOfAPartnerThatTheLinkDoesNotTakeIsCountedAsUndelivered) {
    auto invited = invitation();
    invited.mutable_invitation()->add_participants()->set_entity(master.id);
    teamwork.considerInvitation(master, invited);
    Header head;
    head.sender = master;
    const auto hearRaw = [&] {
        proto::ToEntity message;
        message.mutable_raw()->add_data("blocks");
        EXPECT_TRUE(teamwork.hear(head, message));
    };
    hearRaw();
    ASSERT_EQ(turn.to_application.size(), 1U);
    EXPECT_EQ(turn.counted.undelivered, 0U);
    turn.link_takes = false;
    hearRaw();
    EXPECT_EQ(turn.to_application.size(), 1U);
    EXPECT_EQ(turn.counted.undelivered, 1U);
}

}  // namespace
}  // namespace axon::entity_manager
