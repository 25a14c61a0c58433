// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/arguments.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"

// axon run
namespace axon::cli {
namespace {

using Clock = std::chrono::steady_clock;
using Deadline = std::optional<Clock::time_point>;

/// How long a cancelled task may take to say that it has ended.
constexpr std::chrono::seconds kCancelGrace{2};

/// Follows one task: shows each change, cancels when the user has had enough or the time is up.
class Follower {
  public:
    /// To its end; `until_admitted`: until the Entity Manager lets it wait or the robot's application has
    /// begun it.
    Follower(Session& session, std::string task, std::string entity, const Service& service,
             Clock::time_point started, bool until_admitted)
        : session_(session),
          task_(std::move(task)),
          entity_(std::move(entity)),
          units_(unitsOf(service)),
          live_(feedbackOf(service)),
          started_(started),
          until_admitted_(until_admitted) {}

    int follow(Deadline wait_until) {
        Deadline deadline = wait_until;
        int ended_by = kDone;
        while (true) {
            if (const auto event = session_.mailbox->wait(deadline)) {
                const bool report = show(*event);
                if (!report) continue;
                if (event->value("final", false)) {
                    const auto exit = event->at("exit").get<int>();
                    return ended_by != kDone && exit != kDone ? ended_by : exit;
                }
                if (until_admitted_ && ended_by == kDone && sayIfAdmitted(*event)) return kDone;
                continue;
            }
            const bool interrupted = session_.mailbox->takeInterrupt();
            if (ended_by != kDone) {
                // Cancelled before, and not over in time; or a second Ctrl-C.
                session_.events.emit(errorEvent(
                    {RefusalCode::OutcomeUnknown, "the task was cancelled, but its end was not reported", {}},
                    entity_));
                return ended_by;
            }
            ended_by = interrupted ? kInterrupted : kNotConfirmed;
            if (!interrupted) {
                session_.events.emit(
                    {{"event", "notice"}, {"message", "the time is up: cancelling the task"}});
            }
            if (const auto done = session_.station->control(task_, TaskAction::Cancel); !done) {
                session_.events.emit(errorEvent(done.refusal(), entity_));
            }
            deadline = Clock::now() + kCancelGrace;
        }
    }

  private:
    /// Whether it was a report of the task.
    bool show(Json event) {
        if (event.at("event") != "task") {
            session_.events.emit(event);
            return false;
        }
        // A user who does not follow the task wants one answer, and a request that nobody has answered is not
        // queued yet.
        if (until_admitted_ && !event.at("accepted").get<bool>() && !event.at("final").get<bool>())
            return true;
        event.erase("exit");
        event.erase("accepted");
        event["elapsed_s"] = Seconds(Clock::now() - started_).count();
        event["units"] = units_;
        event["live"] = live_;
        session_.events.emit(event);
        return true;
    }

    /// DISPATCHED is no answer yet: the robot's application may still refuse it.
    bool sayIfAdmitted(const Json& event) {
        const auto state = event.at("state").get<std::string>();
        if (!event.at("accepted").get<bool>() || state == client::toString(TaskState::Dispatched))
            return false;
        const auto id = task_.substr(0, 8);
        const bool waits = state == client::toString(TaskState::Queued);
        session_.events.emit(
            {{"event", "notice"},
             {"message",
              (waits ? "the task is waiting for its turn, and the robot has not been asked yet: axon wait "
                     : "the task continues: axon wait ") +
                  id + " waits for its end, axon cancel " + shellWord(entity_) + " " + id + " ends it"}});
        return true;
    }

    Session& session_;
    const std::string task_, entity_;
    const Json units_, live_;
    const Clock::time_point started_;
    const bool until_admitted_;
};

int run(Session& session) {
    const auto name = session.args.at("entity").get<std::string>();
    const bool detached = session.args.value("detach", false);
    if (detached && !session.kept) {
        return misused(session, "--detach needs a check-out that outlives this command",
                       "axon checkout " + shellWord(name));
    }
    if (detached && session.args.contains("wait")) {
        return misused(session,
                       "--wait cancels a task that this command follows, and --detach does not follow it",
                       "axon run … --detach, then axon wait --for SECONDS");
    }
    const auto found = session.station->find(name);
    if (!found) return refuse(session, found.refusal(), name);
    const auto services = session.station->services(found->id);
    if (!services) return refuse(session, services.refusal(), name);
    const auto service = findService(services.value(), session.args.at("service").get<std::string>());
    if (!service) return refuse(session, service.refusal(), name);
    const auto arguments =
        readArguments(*service.value(), session.args.value("parameters", std::vector<std::string>{}));
    if (!arguments) {
        if (arguments.refusal().code == RefusalCode::Malformed)
            return misused(session, arguments.refusal().message,
                           "axon info " + shellWord(name) + " " + shellWord(service.value()->name) +
                               " shows what it takes");
        return refuse(session, arguments.refusal(), name);
    }

    int exit = kDone;
    const auto holding = Holding::of(session, name, "run", exit);
    if (!holding) return exit;
    const auto& entity = holding->entity();
    const auto listening = detached ? nullptr : listenTo(session, entity);
    const auto started = Clock::now();
    const auto mailbox = session.mailbox;
    const auto task = session.station->run(
        entity.id, service.value()->name, arguments.value(), Seconds(session.args.value("not-after", 0.0)),
        [mailbox, entity_name = holding->call()](const TaskReport& report) {
            auto event = taskEvent(report, entity_name, {});
            event["exit"] = exitOf(report.state, report.reason);
            event["accepted"] = report.accepted;
            mailbox->post(std::move(event), !client::isFinal(report.state));
        });
    if (!task) return refuse(session, task.refusal(), name);

    Follower follower(session, task.value(), holding->call(), *service.value(), started, detached);
    Deadline deadline;
    if (session.args.contains("wait")) {
        deadline = started +
                   std::chrono::duration_cast<Clock::duration>(Seconds(session.args["wait"].get<double>()));
    }
    return follower.follow(deadline);
}

}  // namespace

extern const Verb kRun{
    "run",
    "Run a service as a task and follow it to its end",
    "  axon run PeopleBot Driving Distance=1000\n"
    "  axon run PeopleBot Driving Distance=1000mm 'Range Threshold=500'\n"
    "  axon run PeopleBot Driving distance=1000 range_threshold=500   the same\n"
    "  axon run PeopleBot Driving Distance=1000 --json | tail -1      the final report\n"
    "  axon run PeopleBot Driving Distance=1000 --detach              start it, and do not follow it\n"
    "  axon wait                                                      wait until it has ended\n"
    "Ctrl-C cancels the task. Without axon checkout the entity is checked out for this run only.\n"
    "--detach ends with status 0 when the robot has started the task, or its Entity Manager has put it "
    "behind others.\n"
    "If the task is refused, the reason is shown, and the exit status is that of the refusal.\n",
    Runs::Holder,
    {{"entity", Takes::Entity, true, false, "The entity"},
     {"service", Takes::Service, true, false, "Name or global id of the service"},
     {"parameters", Takes::KeyValue, false, true,
      "PARAMETER=VALUE; repeat it for a parameter that takes several values"}},
    {{"wait", Takes::Duration, "Cancel the task if it has not ended after this long (exit status 4)"},
     {"not-after", Takes::Duration, "Refuse the task if it cannot start within this long"},
     {"detach", Takes::Nothing, "Do not follow the task after its admission; needs axon checkout"}},
    run};

}  // namespace axon::cli
