// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <charconv>
#include <set>
#include <thread>

#include "cli/holding.hpp"
#include "cli/verbs/global.hpp"
#include "cli/words.hpp"
#include "common/refusal.hpp"

// axon global run, axon global check
namespace axon::cli {
namespace {

using Clock = std::chrono::steady_clock;
using Deadline = std::optional<Clock::time_point>;

/// How long a cancelled run may take to say that it has ended.
constexpr std::chrono::seconds kCancelGrace{3};
/// A run of which nothing is new is told of again, for its time.
constexpr std::chrono::seconds kTick{1};
/// Who waits for robots that others hold looks this often.
constexpr std::chrono::seconds kLookAgain{1};

/// Who plays what in a run, held for as long as this lives.
class Cast {
  public:
    /// `what` for: "run", "check".
    Cast(Session& session, const char* what) : session_(session), what_(what), station_(session.station) {}
    Cast(const Cast&) = delete;
    ~Cast() {
        // A refusal means that it is not ours any more: what was wanted.
        for (const auto& id : own_) static_cast<void>(station_->release(id).ok());
    }

    /// Finds the players, says who they are, checks out who is not held; an exit status when it cannot be.
    std::optional<int> gather(const GlobalService& service) {
        Bindings chosen;
        for (const auto& word : session_.args.value("bind", std::vector<std::string>{})) {
            const auto equals = word.find('=');
            int role = -1;
            const auto* end = word.data() + std::min(equals, word.size());
            const auto read = std::from_chars(word.data(), end, role);
            if (equals == std::string::npos || read.ec != std::errc() || read.ptr != end || role < 0)
                return misused(session_,
                               "expected --bind ROLE=ENTITY, for example 0=PeopleBot, found " + word);
            const auto found = session_.station->find(word.substr(equals + 1));
            if (!found) return refuse(session_, found.refusal(), word.substr(equals + 1));
            if (!chosen.emplace(role, found->id).second)
                return misused(session_, "role " + std::to_string(role) + " is bound twice");
        }
        Deadline until;
        if (const auto wait = session_.args.find("wait"); wait != session_.args.end()) {
            const Seconds time(wait->is_number() ? wait->get<double>() : 86400.0);
            until =
                Clock::now() + std::chrono::duration_cast<Clock::duration>(std::min(time, Seconds(86400)));
        }
        auto proposal = propose(service, chosen, until);
        if (!proposal) {
            if (proposal.refusal().code == RefusalCode::Cancelled) return kInterrupted;
            return refuseGlobal(session_, proposal.refusal());
        }
        for (const auto& [role, id] : chosen) {
            const bool known =
                std::any_of(proposal->roles.begin(), proposal->roles.end(),
                            [role = role](const auto& outlook) { return outlook.role == role; });
            if (!known)
                return misused(session_, service.name + " has no role " + std::to_string(role),
                               "axon global info " + shellWord(service.name) + " shows its roles");
        }
        if (const auto refused = appoint(); refused) return refused;
        // Who is named for every role is asked, whatever seems to be in the way: they say it step by step.
        const bool all_named =
            std::all_of(proposal->roles.begin(), proposal->roles.end(),
                        [&](const auto& outlook) { return chosen.count(outlook.role) != 0; });
        if (!proposal->complete() && !all_named) {
            auto fix =
                "axon global info " + shellWord(service.name) + " shows which robots can play its roles" +
                (proposal->why.code == RefusalCode::AlreadyHeld ? "; --wait waits for what others hold" : "");
            if (const auto stopped = stoppedOnes(proposal.value()); !stopped.empty())
                fix = remedyFor(RefusalCode::Latched, stopped.substr(1), {});
            return refuseWith(session_, proposal->why, fix);
        }
        for (auto& outlook : proposal->roles) {
            if (outlook.entity.empty()) {
                const auto named = session_.station->find(chosen.at(outlook.role));
                if (!named) return refuse(session_, named.refusal());
                outlook.entity = named->id;
                outlook.name = callOf(session_, named.value());
            }
            players_[outlook.role] = outlook.entity;
            names_.push_back(outlook.name);
        }
        if (const auto refused = appointOneOf(proposal->roles); refused) return refused;
        auto roles = toJson(proposal.value());
        for (auto& role : roles) role["chosen"] = chosen.count(role.at("role").get<int>()) != 0;
        session_.events.emit({{"event", "binding"},
                              {"service", service.name},
                              {"roles", std::move(roles)},
                              {"master", master_name_},
                              {"master_id", master_}});
        return take(until);
    }

    const Bindings& players() const { return players_; }
    const std::string& master() const { return master_; }
    bool ownsSome() const { return !own_.empty(); }
    std::vector<std::string> ids() const {
        std::vector<std::string> all;
        for (const auto& [role, id] : players_) all.push_back(id);
        return all;
    }
    std::string namesOfOwn() const {
        std::string text;
        std::size_t place = 0;
        for (const auto& [role, id] : players_) {
            const auto& name = names_[place++];
            if (std::find(own_.begin(), own_.end(), id) != own_.end()) text += " " + shellWord(name);
        }
        return text;
    }

  private:
    /// CANCELLED when the user does not want to wait any more.
    Result<client::Proposal> propose(const GlobalService& service, const Bindings& chosen, Deadline until) {
        while (true) {
            auto proposal = session_.station->propose(service, chosen);
            const bool worth = proposal && (proposal->why.code == RefusalCode::AlreadyHeld ||
                                            proposal->why.code == RefusalCode::Blocked);
            if (!worth || !until || Clock::now() >= *until) return proposal;
            session_.events.emit({{"event", "waiting"},
                                  {"entity_id", ""},
                                  {"place", 0},
                                  {"message", "Waiting. " + proposal->why.message}});
            const auto look = std::min(*until, Clock::now() + kLookAgain);
            while (Clock::now() < look) {
                if (const auto event = session_.mailbox->wait(look)) {
                    session_.events.emit(*event);
                } else if (session_.mailbox->takeInterrupt()) {
                    session_.events.emit(
                        {{"event", "notice"}, {"message", "cancelled; nothing was checked out"}});
                    return Refusal{RefusalCode::Cancelled, "it was cancelled", {}};
                }
            }
        }
    }

    /// " Arm 'Shuttle 2'": the nearest for roles that nobody plays, where a rearm is all that they need.
    static std::string stoppedOnes(const client::Proposal& proposal) {
        std::set<std::string> names;
        for (const auto& outlook : proposal.roles) {
            if (!outlook.entity.empty() || outlook.unfit.empty()) continue;
            const auto& nearest = outlook.unfit.front();
            if (nearest.why.code == RefusalCode::Latched) names.insert(nearest.name);
        }
        std::string text;
        for (const auto& name : names) text += " " + shellWord(name);
        return text;
    }

    /// The master that was named, should one have been.
    std::optional<int> appoint() {
        const auto word = session_.args.value("master", "");
        if (word.empty()) return std::nullopt;
        const auto found = session_.station->find(word);
        if (!found) return refuse(session_, found.refusal(), word);
        master_ = found->id;
        master_name_ = callOf(session_, found.value());
        return std::nullopt;
    }

    std::optional<int> appointOneOf(const std::vector<client::RoleOutlook>& roles) {
        if (master_.empty()) {
            master_ = roles.front().entity;
            master_name_ = roles.front().name;
        }
        for (const auto& outlook : roles) {
            if (outlook.entity == master_) return std::nullopt;
        }
        std::string names;
        for (const auto& name : names_) names += (names.empty() ? "" : ", ") + name;
        return misused(session_, master_name_ + " plays no role, so it cannot be the master",
                       "name one of " + names + ", or give " + master_name_ +
                           " a role with --bind ROLE=" + shellWord(master_name_));
    }

    std::optional<int> take(Deadline until) {
        std::vector<std::string> wanted;
        const auto held = station_->held();
        for (const auto& [role, id] : players_) {
            const bool mine = std::any_of(held.begin(), held.end(),
                                          [id = id](const Entity& entity) { return entity.id == id; });
            if (!mine) wanted.push_back(id);
        }
        if (wanted.empty()) return std::nullopt;
        CheckOutOptions options;
        if (until) options.wait = Seconds(std::max(*until - Clock::now(), Clock::duration{}));
        bool interrupted = false;
        const auto granted = takeAndShow(session_, wanted, "", options, interrupted);
        if (!granted) return interrupted ? kInterrupted : refuse(session_, granted.refusal());
        for (const auto& entity : granted.value()) own_.push_back(entity.id);
        auto items = Json::array();
        for (const auto& entity : granted.value())
            items.push_back({{"id", entity.id}, {"name", entity.name}, {"call", callOf(session_, entity)}});
        session_.events.emit(
            {{"event", "checked_out"}, {"entities", std::move(items)}, {"kept", false}, {"for", what_}});
        return std::nullopt;
    }

    Session& session_;
    const char* const what_;
    const std::shared_ptr<Station> station_;
    Bindings players_;
    std::vector<std::string> names_;  // in order of players_
    std::string master_, master_name_;
    std::vector<std::string> own_;
};

/// Follows one run to its end: shows what is new, cancels when the user has had enough or the time is up, and
/// stops everybody when the user wants it twice.
class RunFollower {
  public:
    RunFollower(Session& session, std::string run, std::vector<std::string> entities,
                ServicesOfSteps services)
        : session_(session),
          run_(std::move(run)),
          entities_(std::move(entities)),
          services_(std::move(services)) {}

    int follow(Deadline wait_until) {
        Deadline deadline = wait_until;
        int ended_by = kDone;
        while (true) {
            const auto tick = Clock::now() + kTick;
            if (const auto event = session_.mailbox->wait(deadline ? std::min(*deadline, tick) : tick)) {
                if (!show(*event) || !event->value("final", false)) continue;
                const auto exit = event->at("exit").get<int>();
                return ended_by != kDone && exit != kDone ? ended_by : exit;
            }
            const bool interrupted = session_.mailbox->takeInterrupt();
            if (!interrupted && (!deadline || Clock::now() < *deadline)) {
                tellTime();
                continue;
            }
            if (ended_by != kDone && interrupted) {
                say("stopping every robot that takes part");
                static_cast<void>(stopAndShow(session_, entities_, {Seconds(1), Seconds(0)}));
                return kInterrupted;
            }
            if (ended_by != kDone) {
                session_.events.emit(errorEvent({RefusalCode::OutcomeUnknown,
                                                 "the run was cancelled, but its end was not reported",
                                                 {}}));
                return ended_by;
            }
            ended_by = interrupted ? kInterrupted : kNotConfirmed;
            say(interrupted ? "cancelling the run; Ctrl-C again stops every robot immediately"
                            : "the time is up: cancelling the run");
            cancel();
            deadline = Clock::now() + kCancelGrace;
        }
    }

    /// Until it is under way, or over.
    int detach(Deadline deadline) {
        while (const auto event = session_.mailbox->wait(deadline)) {
            const bool about_run = event->at("event") == "run";
            if (!about_run || event->value("final", false)) show(*event);
            if (!about_run || event->at("state") == "CHECKING") continue;
            if (event->value("final", false)) return event->at("exit").get<int>();
            session_.events.emit({{"event", "run_begun"},
                                  {"id", run_},
                                  {"service", event->at("service")},
                                  {"master", event->at("master")}});
            say("the run continues: axon global cancel " + shellWord(run_.substr(0, 8)) +
                " ends it, axon global history " + shellWord(run_.substr(0, 8)) + " shows how it ended");
            return kDone;
        }
        if (session_.mailbox->takeInterrupt()) {
            cancel();
            return kInterrupted;
        }
        return refuseWith(session_, {RefusalCode::TimedOut, "nothing was heard of the run", {}},
                          "see how it stands: axon global history " + shellWord(run_.substr(0, 8)));
    }

  private:
    void say(const std::string& message) {
        session_.events.emit({{"event", "notice"}, {"message", message}});
    }

    /// On a thread of its own: the answer comes when the run has ended, and a second Ctrl-C must be heard
    /// before.
    void cancel() {
        std::thread([station = session_.station, mailbox = session_.mailbox, run = run_] {
            if (const auto done = station->controlRun(run, TaskAction::Cancel); !done)
                mailbox->post(errorEvent(done.refusal()));
        }).detach();
    }

    /// Whether it was a report of the run. Only steps that have changed are passed on, until the last report.
    bool show(Json event) {
        if (event.at("event") != "run") {
            session_.events.emit(event);
            return false;
        }
        last_ = event;
        last_.erase("steps");
        last_.erase("exit");
        heard_ = Clock::now();
        event.erase("exit");
        auto steps = Json::array();
        for (auto& step : event.at("steps")) {
            services_.describe(step);
            auto& known = steps_[step.at("step").get<int>()];
            if (known != step || event.value("final", false)) steps.push_back(step);
            known = step;
        }
        event["steps"] = std::move(steps);
        session_.events.emit(event);
        if (event.at("state") == "HELD" && !told_held_) {
            say(session_.kept
                    ? "axon global resume tries again what failed; axon global cancel, or Ctrl-C here, "
                      "ends the run"
                    : "Ctrl-C ends the run; under axon checkout another command could resume it");
        }
        told_held_ = event.at("state") == "HELD";
        return true;
    }

    void tellTime() {
        if (!last_.is_object()) return;
        auto event = last_;
        event["elapsed_s"] = last_.at("elapsed_s").get<double>() + Seconds(Clock::now() - heard_).count();
        event["steps"] = Json::array();
        session_.events.emit(event);
    }

    Session& session_;
    const std::string run_;
    const std::vector<std::string> entities_;
    const ServicesOfSteps services_;
    std::map<int, Json> steps_;
    Json last_;
    Clock::time_point heard_;
    bool told_held_ = false;
};

int perform(Session& session, bool check_only) {
    const bool detached = session.args.value("detach", false);
    const auto service = findGlobal(session, session.args.at("name").get<std::string>());
    if (!service) return refuseGlobal(session, service.refusal());
    if (detached && !session.kept) {
        return misused(session, "--detach needs check-outs that outlive this command",
                       "axon checkout the entities first");
    }
    Cast cast(session, check_only ? "check" : "run");
    if (const auto exit = cast.gather(service.value())) return *exit;
    if (detached && cast.ownsSome()) {
        return misused(session, "--detach needs check-outs that outlive this command",
                       "axon checkout" + cast.namesOfOwn());
    }
    std::vector<std::shared_ptr<void>> listening;
    if (!detached) {
        for (const auto& id : cast.ids()) {
            if (const auto entity = session.station->find(id))
                listening.push_back(listenTo(session, entity.value()));
        }
    }
    // Before it begins: nobody who follows it waits for an answer.
    ServicesOfSteps services(session.station, cast.ids());
    const auto started = Clock::now();
    const auto run = session.station->runGlobal(
        service.value(), cast.players(), cast.master(), check_only,
        [mailbox = session.mailbox](const RunReport& report) {
            auto event = toJson(report);
            event["exit"] = exitOf(report.state, report.reason);
            // A remedy that names an entity has none to name here.
            if (const auto fix = refusalEntry(report.reason.code).remedy;
                !report.reason.ok() && !fix.empty() && fix.find('{') == std::string_view::npos)
                event["fix"] = fix;
            mailbox->post(std::move(event), !client::isFinal(report.state));
        });
    if (!run) return refuseGlobal(session, run.refusal());
    RunFollower follower(session, run.value(), cast.ids(), std::move(services));
    if (detached) return follower.detach(Clock::now() + std::chrono::seconds(10));
    Deadline deadline;
    if (session.args.contains("at-most")) {
        deadline = started + std::chrono::duration_cast<Clock::duration>(
                                 Seconds(session.args["at-most"].get<double>()));
    }
    return follower.follow(deadline);
}

int run(Session& session) {
    return perform(session, false);
}

int check(Session& session) {
    return perform(session, true);
}

std::vector<Option> bindingOptions() {
    return {{"bind",
             Takes::Binding,
             "The robot that plays a role; repeat it for others. Other roles are bound automatically",
             {},
             true},
            {"master", Takes::Entity,
             "Which participant leads (default: the player of the first role); the result is the same"},
            {"wait", Takes::MaybeDuration, "Wait for robots that others hold, at most this long"}};
}

std::vector<Option> runOptions() {
    auto options = bindingOptions();
    options.push_back(
        {"at-most", Takes::Duration, "Cancel the run if it has not ended after this long (exit status 4)"});
    options.push_back({"detach", Takes::Nothing,
                       "Do not follow the run; needs axon checkout of every robot that takes part"});
    return options;
}

}  // namespace

extern const Verb kGlobalRun{
    "global run",
    "Run a global service and follow it to its end",
    "  axon global run 'Fetch ball'\n"
    "  axon global run fetch_ball --bind 0=PeopleBot#2 --bind 1=Cyton\n"
    "  axon global run 'Fetch ball' --master Cyton --at-most 120\n"
    "  axon global run 'Fetch ball' --json | tail -1     the final report\n"
    "Roles that are not bound are played by robots that can play them and are free or held here; the "
    "command\n"
    "says which. It checks out all of them for this run, or none. Nothing moves before all of them agree.\n"
    "Ctrl-C cancels the run; a second Ctrl-C immediately stops every robot that takes part.\n",
    Runs::Anywhere,
    {{"name", Takes::GlobalService, true, false, "Name of the global service"}},
    runOptions(),
    run,
    nullptr,
    false,
    2};

extern const Verb kGlobalCheck{
    "global check",
    "Ask every robot whether a global service can run; nothing moves",
    "  axon global check 'Fetch ball'\n"
    "  axon global check 'Fetch ball' --bind 0=PeopleBot#2\n"
    "Prints every problem with its step, its entity and how to fix it, and exits with "
    "1 then. The robots\n"
    "are checked out meanwhile.\n",
    Runs::Anywhere,
    {{"name", Takes::GlobalService, true, false, "Name of the global service"}},
    bindingOptions(),
    check};

}  // namespace axon::cli
