// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/turn/state_table.hpp"

#include <algorithm>
#include <array>
#include <initializer_list>
#include <map>
#include <utility>

namespace axon::entity_manager {

namespace {

using S = EntityState;
using E = Event;
using A = Action;

constexpr Next kStay{};
constexpr Next kPrevious{Next::Kind::Previous, S::UNAV};
constexpr Next to(S state) {
    return {Next::Kind::To, state};
}

class Rows {
  public:
    void add(std::initializer_list<S> states, E event, std::vector<A> actions, Next next) {
        for (const auto state : states) rows_.push_back({state, event, actions, next});
    }
    std::vector<Row> take() { return std::move(rows_); }

  private:
    std::vector<Row> rows_;
};

std::vector<Row> makeRows() {
    Rows rows;
    const auto linked = {S::INIT, S::ENVCONN, S::IDLE, S::REG, S::COLLAB, S::SLAVE, S::BUSY, S::ERR};
    const auto linked_unheld = {S::INIT, S::ENVCONN, S::IDLE, S::ERR};
    const auto unready = {S::UNAV, S::INIT, S::ERR};
    const auto held = {S::REG, S::COLLAB, S::SLAVE, S::BUSY};
    const auto any = {
#define AXON_STATE(name, availability) S::name,
#include "common/axon/states.def"
#undef AXON_STATE
    };

    // The rule above all states: a stop. The signal thread has written it to the Entity Interfacer already.
    rows.add({S::UNAV, S::INIT, S::ENVCONN, S::IDLE, S::ERR, S::REG}, E::Stop,
             {A::Latch, A::Acknowledge, A::EndTasks, A::VoidQueue, A::TellStatus}, kStay);
    rows.add({S::COLLAB, S::SLAVE, S::BUSY}, E::Stop,
             {A::Latch, A::Acknowledge, A::LeaveCollaboration, A::EndTasks, A::VoidQueue, A::TellStatus},
             to(S::REG));

    // The link to the robot application. Its end ends everything but the session with the server; the Entity
    // Interfacer stops the robot by itself. An end that nobody wanted latches what somebody held (ADR 0022).
    rows.add({S::UNAV}, E::LinkUp, {A::AwaitProfiles, A::DeliverStops, A::TellStatus}, to(S::INIT));
    const std::vector<Action> unlinked{A::LeaveCollaboration, A::LoseTasks,      A::VoidQueue,
                                       A::AbandonRequests,    A::SuspendUploads, A::DismissWaiting,
                                       A::EndLease,           A::TellStatus};
    auto broken = unlinked;
    broken.insert(broken.begin(), A::Latch);
    rows.add(held, E::LinkDown, broken, to(S::UNAV));
    rows.add(linked_unheld, E::LinkDown, unlinked, to(S::UNAV));
    rows.add(linked, E::LinkEnded, unlinked, to(S::UNAV));
    for (const auto event : {E::LinkDown, E::LinkEnded}) rows.add({S::UNAV}, event, {A::TellStatus}, kStay);

    rows.add({S::INIT}, E::ProfileUploaded, {A::ConsiderProfiles}, kStay);
    rows.add({S::ERR, S::ENVCONN, S::IDLE}, E::ProfileUploaded,
             {A::DismissWaiting, A::TellStatus, A::ConsiderProfiles}, to(S::INIT));
    // Who waits for the entity gets it with its new profiles.
    rows.add({S::IDLE}, E::KeptProfileTaken, {A::TellStatus, A::ConsiderProfiles}, to(S::INIT));
    rows.add({S::INIT}, E::ProfilesGood, {A::TellStatus, A::SeekServer}, to(S::ENVCONN));
    rows.add({S::INIT}, E::ProfilesBad, {A::ReportProfiles, A::TellStatus}, to(S::ERR));

    // The server. Where the session outlived the robot application, the entity is made known again at once.
    rows.add({S::ENVCONN}, E::ServerUp, {A::Register, A::TellStatus}, to(S::IDLE));
    rows.add({S::ENVCONN}, E::ServerReturned, {A::Register, A::TellStatus}, to(S::REG));
    rows.add(unready, E::ServerUp, {A::Register, A::TellStatus}, kStay);
    rows.add({S::IDLE}, E::ServerDown, {A::StopApplication, A::DismissWaiting, A::SeekServer, A::TellStatus},
             to(S::ENVCONN));
    rows.add(
        held, E::ServerDown,
        {A::StopApplication, A::Latch, A::LeaveCollaboration, A::EndTasks, A::VoidQueue, A::AbandonRequests,
         A::SuspendUploads, A::DismissWaiting, A::OrphanLease, A::SeekServer, A::TellStatus},
        to(S::ENVCONN));
    rows.add({S::UNAV, S::INIT, S::ENVCONN, S::ERR}, E::ServerDown, {A::SeekServer}, kStay);

    // Check-out, its end, and the loss of a client.
    rows.add({S::IDLE, S::REG, S::COLLAB, S::SLAVE, S::BUSY}, E::CheckOut, {A::ConsiderCheckOut}, kStay);
    rows.add({S::IDLE}, E::CheckOutGranted, {A::TellStatus, A::SendGrant}, to(S::REG));
    for (const auto event : {E::Release, E::ClientEnded})
        rows.add(held, event,
                 {A::StopApplication, A::LeaveCollaboration, A::EndTasks, A::VoidQueue, A::SuspendUploads,
                  A::EndLease, A::TellStatus},
                 to(S::IDLE));
    // The status is told once it is known whether there is a grace at all.
    rows.add(held, E::ClientLost,
             {A::StopApplication, A::Latch, A::LeaveCollaboration, A::EndTasks, A::VoidQueue,
              A::SuspendUploads, A::OrphanLease},
             to(S::REG));
    // The policy of the services (ADR 0014): the one loss at which the robot is not stopped.
    rows.add({S::BUSY}, E::ClientSpared, {A::SpareTasks, A::VoidQueue, A::SuspendUploads, A::OrphanLease},
             kStay);
    rows.add(held, E::LeaseResumed, {A::TellStatus, A::SendGrant}, kStay);
    for (const auto event : {E::LeaseExpired, E::TakenOver})
        rows.add(held, event,
                 {A::StopApplication, A::LeaveCollaboration, A::EndTasks, A::VoidQueue, A::SuspendUploads,
                  A::EndLease, A::TellStatus},
                 to(S::IDLE));
    rows.add({S::INIT, S::ENVCONN, S::ERR}, E::LeaseExpired, {A::StopApplication, A::EndLease, A::TellStatus},
             kStay);
    rows.add(held, E::HandOver, {A::ConsiderHandOver}, kStay);
    for (const auto event : {E::ClientLost, E::ClientEnded})
        rows.add({S::UNAV, S::INIT, S::ENVCONN, S::IDLE, S::ERR}, event, {A::DismissWaiting}, kStay);

    // The holder's work.
    rows.add(held, E::SetParam, {A::AskParameter}, kStay);
    rows.add(held, E::Resource, {A::CarryResource}, kStay);
    rows.add(held, E::Text, {A::PassText}, kStay);
    rows.add(held, E::Raw, {A::PassRaw}, kStay);
    rows.add({S::REG, S::BUSY}, E::Task, {A::AdmitTask}, kStay);
    rows.add({S::REG, S::COLLAB, S::SLAVE}, E::TaskGranted, {A::TellStatus}, to(S::BUSY));
    rows.add({S::BUSY}, E::TaskGranted, {}, kStay);
    rows.add({S::IDLE, S::REG, S::COLLAB, S::SLAVE, S::BUSY}, E::TaskEnded, {A::DispatchNext}, kStay);
    rows.add({S::BUSY}, E::LastTaskEnded, {A::TellStatus, A::DispatchNext}, kPrevious);
    rows.add({S::REG, S::COLLAB, S::SLAVE}, E::ApplicationBusy, {A::TellStatus}, to(S::BUSY));
    rows.add({S::UNAV, S::INIT, S::ENVCONN, S::IDLE, S::BUSY, S::ERR}, E::ApplicationBusy, {}, kStay);
    rows.add(any, E::ApplicationReady, {A::DispatchNext}, kStay);
    rows.add(held, E::Pause, {A::PauseTask}, kStay);
    rows.add(held, E::Resume, {A::ResumeTask}, kStay);
    rows.add(held, E::Cancel, {A::CancelTask}, kStay);
    rows.add({S::IDLE, S::REG, S::COLLAB, S::SLAVE, S::BUSY}, E::Rearm, {A::Unlatch, A::TellStatus}, kStay);

    // The other two commands. Neither latches.
    rows.add({S::REG, S::BUSY}, E::Reset,
             {A::HaltTasks, A::StopApplication, A::Acknowledge, A::TellStatus, A::DispatchNext}, kStay);
    rows.add(
        held, E::Clear,
        {A::StopApplication, A::Acknowledge, A::LeaveCollaboration, A::EndTasks, A::VoidQueue, A::TellStatus},
        to(S::REG));

    // Anyone, always.
    rows.add(any, E::Status, {A::AnswerStatus}, kStay);
    rows.add(any, E::Watch, {A::NoteWatch}, kStay);

    // A master that is gone is a loss like that of a client; its own word is an order.
    rows.add({S::SLAVE, S::BUSY}, E::MasterLost,
             {A::StopApplication, A::Latch, A::EndTasks, A::VoidQueue, A::TellStatus}, to(S::REG));

    // Collaboration. While it runs, BUSY is on the way back to COLLAB or SLAVE.
    rows.add({S::REG}, E::CollaborativeTask, {A::ConsiderRun}, kStay);
    rows.add({S::REG}, E::CollaborationBegun, {A::TellStatus}, to(S::COLLAB));
    rows.add({S::REG}, E::CollaborationRequest, {A::ConsiderInvitation}, kStay);
    rows.add({S::REG}, E::CollaborationJoined, {A::TellStatus}, to(S::SLAVE));
    rows.add({S::COLLAB, S::SLAVE}, E::CollaborationEnded, {A::TellStatus}, to(S::REG));
    // What runs on is no part of the run any more.
    rows.add({S::BUSY}, E::CollaborationEnded, {A::ReturnToReg}, kStay);
    rows.add({S::COLLAB, S::SLAVE, S::BUSY}, E::CollaborationStopped,
             {A::StopApplication, A::EndTasks, A::VoidQueue, A::TellStatus}, to(S::REG));
    rows.add(any, E::RunHistory, {A::TellRunHistory}, kStay);

    rows.add(any, E::Quit,
             {A::StopApplication, A::LeaveCollaboration, A::EndTasks, A::VoidQueue, A::AbandonRequests,
              A::SuspendUploads, A::DismissWaiting, A::EndLease, A::TellStatus, A::LeaveServer},
             to(S::UNAV));
    return rows.take();
}

struct Table {
    Table() : rows(makeRows()) {
        for (const auto& row : rows)
            index[static_cast<std::size_t>(row.state)][static_cast<std::size_t>(row.event)] = &row;
    }
    const std::vector<Row> rows;
    std::array<std::array<const Row*, kEvents>, kStates> index{};
};

const Table& table() {
    static const Table kTable;
    return kTable;
}

constexpr Needs kNothing{};
constexpr Needs kStopSeen{.stop_generation = true};
constexpr Needs kFree{.not_latched = true};
constexpr Needs kStopSeenAndFree{.stop_generation = true, .not_latched = true};

struct Description {
    const char* name;
    bool request = false;
    Needs needs = {};
    const char* wish = "";
};
constexpr std::array kDescriptions{
#define AXON_FACT(name) Description{#name},
#define AXON_REQUEST(name, needs, wish, is, refuse) Description{#name, true, needs, wish},
#include "entity_manager/core/turn/events.def"
#undef AXON_FACT
#undef AXON_REQUEST
};

const Description& describe(E event) {
    return kDescriptions[static_cast<std::size_t>(event)];
}

}  // namespace

std::span<const Row> stateTable() {
    return table().rows;
}

const Row* findRow(EntityState state, Event event) {
    return table().index[static_cast<std::size_t>(state)][static_cast<std::size_t>(event)];
}

Refusal refusalFor(EntityState state, Event event, const std::string& reason) {
    const std::string because = reason.empty() ? "" : ": " + reason;
    if (event == E::ProfileUploaded)
        return {RefusalCode::WrongState,
                "The entity cannot take new profiles now: it is checked out. The new profile is kept, and "
                "uploaded at its release.",
                {}};
    if (!isRequest(event))
        return {RefusalCode::WrongState,
                std::string(toString(event)) + " is not expected in " + toString(state) + ".",
                {}};
    const std::string cannot = std::string("The entity cannot ") + describe(event).wish + " now";
    switch (state) {
        case S::UNAV:
            return {RefusalCode::Unavailable,
                    cannot + because + ". Start the robot application; the entity comes back by itself.",
                    {}};
        case S::INIT:
            return {RefusalCode::Unavailable,
                    cannot + (reason.empty() ? ": its profiles are being read. Try again in a moment."
                                             : because + "."),
                    {}};
        case S::ERR:
            return {RefusalCode::Unavailable,
                    cannot + ": its profiles have errors" + because +
                        ". Fix the files; they are read again by themselves.",
                    {}};
        case S::ENVCONN:
            return {RefusalCode::NotConnected, cannot + ": it is not registered with the server yet.", {}};
        case S::IDLE:
            return {RefusalCode::NotHolder, cannot + ": nobody has checked it out. Check it out first.", {}};
        case S::COLLAB:
        case S::SLAVE:
            if (event == E::Reset)
                return {RefusalCode::WrongState,
                        cannot +
                            ": it takes part in a collaboration, and none of its tasks runs. Cancel the "
                            "run, or clear the entity, which takes it out.",
                        {}};
            return {RefusalCode::WrongState,
                    cannot + ": it takes part in a collaboration. Wait for its end, or stop it.",
                    {}};
        case S::REG:
        case S::BUSY:
            break;
    }
    return {RefusalCode::WrongState, cannot + " (state " + toString(state) + ").", {}};
}

Needs needsOf(Event event) {
    return describe(event).needs;
}

bool isRequest(Event event) {
    return describe(event).request;
}

const char* toString(Event event) {
    return describe(event).name;
}

const char* toString(Action action) {
    static constexpr std::array kNames{
#define AXON_ACTION(name, call) #name,
#include "entity_manager/core/turn/actions.def"
#undef AXON_ACTION
    };
    return kNames[static_cast<std::size_t>(action)];
}

std::string toString(const Next& next) {
    switch (next.kind) {
        case Next::Kind::Stay:
            return "stay";
        case Next::Kind::Previous:
            return "previous";
        case Next::Kind::To:
            return axon::toString(next.state);
    }
    return "?";
}

std::string stateDiagram() {
    // One arrow per pair of states, with all events that lead that way; Previous leads to each state that
    // BUSY is entered from. What holds in every state is said once, in a note, or the picture could not be
    // read.
    std::map<std::pair<S, S>, std::vector<std::string>> arrows;
    for (const auto& row : stateTable()) {
        if (row.event == E::LinkDown || row.event == E::LinkEnded || row.event == E::Quit) continue;
        if (row.next.kind == Next::Kind::To && row.next.state != row.state)
            arrows[{row.state, row.next.state}].emplace_back(toString(row.event));
        if (row.next.kind == Next::Kind::Previous)
            for (const auto target : {S::REG, S::COLLAB, S::SLAVE})
                arrows[{row.state, target}].emplace_back(toString(row.event));
    }
    std::string text = "stateDiagram-v2\n    [*] --> UNAV\n";
    for (const auto& [pair, events] : arrows) {
        text +=
            std::string("    ") + axon::toString(pair.first) + " --> " + axon::toString(pair.second) + " : ";
        for (std::size_t i = 0; i < events.size(); ++i) text += (i == 0 ? "" : ", ") + events[i];
        text += '\n';
    }
    text += "    note right of UNAV : from any state by LinkDown and LinkEnded, and by Quit at the end\n";
    text += "    note right of REG : Stop is accepted in every state and latches\n";
    return text;
}

std::string stateMachinePage() {
    std::string page =
        "# The state machine of the Entity Manager\n\n"
        "This page is for everybody who wants to know what the Entity Manager does with an event.\n"
        "At the end you know, for each event and each state, what happens or how it is refused.\n\n"
        "The states are those of the thesis (3.3.1).\n"
        "The latch of a stop is a flag beside them.\n"
        "The [glossary](../glossary.md) explains words such as *latch*, *lease* and *run*.\n\n"
        "A test generates this page from `src/entity_manager/core/turn/state_table.cpp`, which the Entity "
        "Manager runs, and fails when the page is stale.\n"
        "To write it again, run `AXON_RERECORD=1 build/dev/tests/entity_manager_core_test "
        "--gtest_filter='StateTable.*'`.\n\n"
        "```mermaid\n" +
        stateDiagram() +
        "```\n\n## Rows\n\n"
        "A row changes the state first and then runs its actions in order.\n"
        "*previous* is the state from which BUSY was entered.\n\n"
        "| event | in | actions | next |\n|---|---|---|---|\n";
    std::vector<bool> done(stateTable().size());
    const auto rows = stateTable();
    for (std::size_t i = 0; i < rows.size(); ++i) {
        if (done[i]) continue;
        std::string states;
        for (std::size_t j = i; j < rows.size(); ++j) {
            if (rows[j].event != rows[i].event || rows[j].actions != rows[i].actions ||
                rows[j].next != rows[i].next)
                continue;
            done[j] = true;
            states += (states.empty() ? "" : " ") + std::string(axon::toString(rows[j].state));
        }
        if (std::ranges::count(states, ' ') == static_cast<std::ptrdiff_t>(kStates) - 1) states = "*any*";
        std::string actions;
        for (const auto action : rows[i].actions)
            actions += (actions.empty() ? "" : ", ") + std::string(toString(action));
        page += std::string("| ") + toString(rows[i].event) + " | " + states + " | " +
                (actions.empty() ? "none" : actions) + " | " + toString(rows[i].next) + " |\n";
    }
    page += "\n## Pairs without a row\n\nThe sender of the request is refused with this code.\n\n| request |";
    for (const auto state : kEntityStates) page += std::string(" ") + axon::toString(state) + " |";
    page += "\n|---|";
    for (std::size_t i = 0; i < kStates; ++i) page += "---|";
    page += '\n';
    for (std::size_t e = 0; e < kEvents; ++e) {
        const auto event = static_cast<Event>(e);
        std::string line;
        bool refused = false;
        for (const auto state : kEntityStates) {
            const bool row = findRow(state, event) != nullptr;
            refused = refused || !row;
            line += row ? " · |" : " " + std::string(refusalName(refusalFor(state, event).code)) + " |";
        }
        if (refused && (isRequest(event) || event == E::ProfileUploaded))
            page += std::string("| ") + toString(event) + " |" + line + '\n';
    }
    page +=
        "\nAn event that is not a request is a fact.\n"
        "A fact without a row is counted and changes nothing.\n\n"
        "## What a request must prove first\n\n"
        "[Who may send an entity what](../reference/rights.md) says who may ask.\n"
        "After that, the request must have seen the newest stop, or find the robot not latched:\n\n"
        "| request | newest stop seen | not latched |\n|---|---|---|\n";
    for (std::size_t e = 0; e < kEvents; ++e) {
        const auto event = static_cast<Event>(e);
        const auto needs = needsOf(event);
        if (!needs.stop_generation && !needs.not_latched) continue;
        page += std::string("| ") + toString(event) + " | " + (needs.stop_generation ? "yes" : "") + " | " +
                (needs.not_latched ? "yes" : "") + " |\n";
    }
    return page;
}

}  // namespace axon::entity_manager
