// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/turn/state_table.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <set>
#include <sstream>

namespace axon::entity_manager {
namespace {

template <class Each>
void forEveryPair(Each each) {
    for (std::size_t s = 0; s < kStates; ++s)
        for (std::size_t e = 0; e < kEvents; ++e) each(static_cast<EntityState>(s), static_cast<Event>(e));
}

TEST(StateTable, EveryPairIsARowOrATypedRefusal) {
    int rows = 0;
    forEveryPair([&](EntityState state, Event event) {
        if (findRow(state, event) != nullptr) {
            ++rows;
            return;
        }
        const auto refusal = refusalFor(state, event);
        EXPECT_NE(refusal.code, RefusalCode::Ok) << axon::toString(state) << ' ' << toString(event);
        EXPECT_NE(refusal.code, RefusalCode::Internal) << axon::toString(state) << ' ' << toString(event);
        EXPECT_GT(refusal.message.size(), 20U) << axon::toString(state) << ' ' << toString(event);
    });
    EXPECT_EQ(rows, static_cast<int>(stateTable().size())) << "two rows for one pair";
}

TEST(StateTable, AStopIsARowOfEveryStateAndLatchesAndVoidsAndIsAcknowledged) {
    for (std::size_t s = 0; s < kStates; ++s) {
        const auto* row = findRow(static_cast<EntityState>(s), Event::Stop);
        ASSERT_NE(row, nullptr);
        for (const auto action : {Action::Latch, Action::Acknowledge, Action::EndTasks, Action::VoidQueue})
            EXPECT_NE(std::find(row->actions.begin(), row->actions.end(), action), row->actions.end())
                << axon::toString(row->state) << ' ' << toString(action);
    }
    for (const auto state : {EntityState::BUSY, EntityState::COLLAB, EntityState::SLAVE})
        EXPECT_EQ(findRow(state, Event::Stop)->next, (Next{Next::Kind::To, EntityState::REG}));
}

TEST(StateTable, WhateverEndsALeaseAtALivingApplicationStopsIt) {
    for (const auto& row : stateTable()) {
        const auto has = [&](Action action) {
            return std::find(row.actions.begin(), row.actions.end(), action) != row.actions.end();
        };
        if (row.event != Event::LinkDown && row.event != Event::LinkEnded && has(Action::EndLease)) {
            EXPECT_TRUE(has(Action::StopApplication))
                << axon::toString(row.state) << ' ' << toString(row.event);
        }
    }
}

TEST(StateTable, WhateverOrphansALeaseStopsTheApplicationAndEndsItsWork) {
    for (const auto& row : stateTable()) {
        const auto has = [&](Action action) {
            return std::find(row.actions.begin(), row.actions.end(), action) != row.actions.end();
        };
        if (!has(Action::OrphanLease) || row.event == Event::ClientSpared) continue;
        for (const auto action :
             {Action::StopApplication, Action::EndTasks, Action::VoidQueue, Action::SuspendUploads})
            EXPECT_TRUE(has(action)) << axon::toString(row.state) << ' ' << toString(row.event) << ' '
                                     << toString(action);
    }
}

TEST(StateTable, OnlyWhatRunsIsSparedAndNothingNewStartsWithoutTheClient) {
    for (const auto& row : stateTable()) {
        if (row.event != Event::ClientSpared) continue;
        EXPECT_EQ(row.state, EntityState::BUSY);
        EXPECT_EQ(row.next, Next{});
        for (const auto action : {Action::SpareTasks, Action::VoidQueue, Action::OrphanLease})
            EXPECT_NE(std::find(row.actions.begin(), row.actions.end(), action), row.actions.end());
    }
}

TEST(StateTable, AnOrphanedLeaseCanExpireInEveryStateThatItCanBeIn) {
    for (const auto state : {EntityState::INIT, EntityState::ENVCONN, EntityState::REG, EntityState::COLLAB,
                             EntityState::SLAVE, EntityState::BUSY, EntityState::ERR})
        EXPECT_NE(findRow(state, Event::LeaseExpired), nullptr) << axon::toString(state);
}

TEST(StateTable, StopsAndLossesLatchOrderlyEndsDoNotAndOnlyRearmUnlatches) {
    const std::set losses{Event::ClientLost, Event::ServerDown, Event::LinkDown, Event::MasterLost};
    for (const auto& row : stateTable()) {
        const auto has = [&](Action action) {
            return std::find(row.actions.begin(), row.actions.end(), action) != row.actions.end();
        };
        const bool held = row.state == EntityState::REG || row.state == EntityState::COLLAB ||
                          row.state == EntityState::SLAVE || row.state == EntityState::BUSY;
        EXPECT_EQ(has(Action::Latch), row.event == Event::Stop || (losses.contains(row.event) && held))
            << axon::toString(row.state) << ' ' << toString(row.event);
        EXPECT_EQ(has(Action::Unlatch), row.event == Event::Rearm);
    }
}

TEST(StateTable, TheLossOfTheLinkLeadsFromEveryStateToUnav) {
    for (std::size_t s = 1; s < kStates; ++s)
        for (const auto event : {Event::LinkDown, Event::LinkEnded})
            EXPECT_EQ(findRow(static_cast<EntityState>(s), event)->next,
                      (Next{Next::Kind::To, EntityState::UNAV}));
}

TEST(StateTable, EveryEventAndEveryActionIsUsed) {
    std::set<Event> events;
    std::set<Action> actions;
    for (const auto& row : stateTable()) {
        events.insert(row.event);
        actions.insert(row.actions.begin(), row.actions.end());
    }
    EXPECT_EQ(events.size(), kEvents);
    EXPECT_EQ(actions.size(), static_cast<std::size_t>(Action::TellStatus) + 1);
}

TEST(StateTable, ThePageInTheDocumentationIsFresh) {
    const char* path = "docs/design/state-machine.md";
    if (std::getenv("AXON_RERECORD") != nullptr) std::ofstream(path, std::ios::binary) << stateMachinePage();
    std::stringstream page;
    page << std::ifstream(path, std::ios::binary).rdbuf();
    EXPECT_EQ(page.str(), stateMachinePage()) << path << " is stale: run this test with AXON_RERECORD=1";
}

}  // namespace
}  // namespace axon::entity_manager
