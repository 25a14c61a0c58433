// SPDX-License-Identifier: MIT
#pragma once

/// Bugs that are planted on purpose, to test the tests: the simulation must find each of them
/// (docs/how-to/simulate.md, tools/planted_bugs). `AXON_PLANTED(Name)` stands where the bug would be. It is
/// the constant false in everything that is built for use; only the copies of the cores that
/// axon-simulate-planted is made of are compiled with AXON_PLANTED_BUGS, and there one bug is chosen when the
/// program starts.
#ifdef AXON_PLANTED_BUGS

#include <string_view>

#define AXON_EACH_PLANTED_BUG(X)                                                                             \
    X(EpochNotSaved, "the epoch of the leases is not saved")                                                 \
    X(EpochUnchecked, "a lease of an earlier life is obeyed")                                                \
    X(OlderLeaseObeyed, "a lease that has ended is obeyed while a newer one exists")                         \
    X(LeaseNumberNotRaised, "two check-outs have the same number")                                           \
    X(ReservationNeverExpires, "a reservation holds until its client takes it back")                         \
    X(GrantBeforeStandstill, "a robot is handed over before it has confirmed its stop")                      \
    X(StopsUnderWayOverlooked, "a stop that the signal thread has passed on counts only once it is handled") \
    X(GenerationOffByOne, "a command may be one stop behind: > for >=")                                      \
    X(GenerationUnchecked, "the stop generation of a command is not looked at")                              \
    X(GenerationsNotReserved, "a next life counts the stops from the beginning")                             \
    X(ReleaseKeepsGeneration, "the stop of a release does not raise the generation")                         \
    X(StopNotIdempotent, "the same stop, repeated, is a new one")                                            \
    X(LatchForgotten, "a stop does not latch")                                                               \
    X(LatchNotKept, "a latch does not outlive the process")                                                  \
    X(LatchUnchecked, "a task is accepted while latched, and starts at the rearm")                           \
    X(QueueNotVoided, "a stop leaves the queue alone, so that a rearm dispatches it")                        \
    X(QueueBackwards, "the newest waiting task goes first")                                                  \
    X(TaskIdForgotten, "a task id is accepted again")                                                        \
    X(JournalNotRead, "what an earlier life has written is not read")                                        \
    X(DispatchNotInTheJournal, "a task is dispatched without an entry")                                      \
    X(StopNotInTheJournal, "a stop is carried out without an entry")                                         \
    X(ExpiryUnchecked, "not_after is not looked at")                                                         \
    X(ExpiryByTheSendersClock, "not_after counts from the sender's clock")                                   \
    X(WatchdogAlwaysIdle, "the watchdog of the server is slow while a task runs, too")                       \
    X(WatchdogFedByTheApplication, "the watchdog of the server is fed by what the application sends")        \
    X(LostServerDoesNotStop, "the loss of the server does not stop the robot")                               \
    X(LostClientForgotten, "a lost client's entities are not stopped")                                       \
    X(ClientWatchdogAlwaysIdle, "the watchdog of a client is slow while its task runs, too")                 \
    X(FinishWithoutEnd, "a task that finishes without its client does so for as long as it likes")           \
    X(HeldTaskGoesOn, "a task that is held when its client is lost is not paused")                           \
    X(LoserNotTold, "who loses an entity by a take-over is not told")                                        \
    X(LateGrantLeft, "what is granted to a client that has gone stays its own")                              \
    X(RequestsWaitForEver, "a client's request that nobody answers does not time out")                       \
    X(StrangersObeyed, "a command from a client that does not hold the entity is carried out")               \
    X(UnaskedHolderBelieved, "an entity may name any client as its busy holder")                             \
    X(PathUnproved, "a client that knows the lease and its holder opens a direct path without the key")      \
    X(AnybodysNumbersCount, "others' marks and messages count as those of the direct path's client")         \
    X(MarkNotAwaited, "what comes by a direct path overtakes what the servers still carry")                  \
    X(SentAgainPassesTwice, "what is sent again after the end of a direct path passes again")                \
    X(NotSentAgain, "what a direct path has not acknowledged is lost with it")

namespace axon {

enum class PlantedBug {
    None,
#define AXON_ENUMERATE(name, what) name,
    AXON_EACH_PLANTED_BUG(AXON_ENUMERATE)
#undef AXON_ENUMERATE
};

/// Written once, before any thread starts.
inline PlantedBug planted_bug = PlantedBug::None;

}  // namespace axon

#define AXON_PLANTED(name) (::axon::planted_bug == ::axon::PlantedBug::name)
#else
#define AXON_PLANTED(name) false
#endif
