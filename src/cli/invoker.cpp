// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/invoker.hpp"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <thread>
#include <utility>

#include "cli/agent.hpp"
#include "cli/agent_link.hpp"
#include "cli/caretaker.hpp"
#include "cli/common_options.hpp"
#include "cli/desktop.hpp"
#include "cli/holding.hpp"
#include "cli/view.hpp"
#include "cli/words.hpp"
#include "common/clock.hpp"
#include "messages/text.hpp"

extern char** environ;

namespace axon::cli {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kLinger{30'000};
/// An agent takes a request within microseconds; one that does not is stopped or stuck.
constexpr milliseconds kAccept{2000};
/// A stop does not wait for an agent: a connection of its own costs less than this.
constexpr milliseconds kAcceptStop{200};

bool holds(const Station& station, const std::string& id) {
    const auto held = station.held();
    return std::any_of(held.begin(), held.end(), [&](const Entity& entity) { return entity.id == id; });
}

/// The agent of the `axon checkout X -- command` around this one, when it is at the server that is wanted
/// here: a stop must not go to another laboratory than the one it names.
const char* namedAgent(const Settings& settings) {
    const char* named = std::getenv("AXON_AGENT");
    const char* server = std::getenv("AXON_AGENT_SERVER");
    const bool ours = named != nullptr && *named != '\0' && server != nullptr && settings.server == server;
    return ours ? named : nullptr;
}

/// The agent that this command may join: the one named by AXON_AGENT (inside `axon checkout X -- command`),
/// or the one of the server's address.
std::optional<AgentLink> openAgent(const Settings& settings) {
    if (const char* named = namedAgent(settings)) return AgentLink::open(named);
    const auto place = agentPlace(settings.server);
    return place ? AgentLink::open(place->socket) : std::nullopt;
}

/// The agent's log, and what its users should know of a lease that is gone.
class AgentLog final : public Events {
  public:
    void emit(const Json& event) override { write(line(event)); }
    static void write(const std::string& text) {
        const auto now = std::time(nullptr);
        std::tm parts{};
        ::localtime_r(&now, &parts);
        char stamp[32];
        std::strftime(stamp, sizeof stamp, "%F %T", &parts);
        std::fprintf(stderr, "%s %s\n", stamp, text.c_str());
    }
};

bool isStop(std::string_view verb) {
    return verb == "stop" || verb == "global stop";
}

/// What a verb may ask of the agent itself: members of Session.
struct AgentHooks {
    std::function<void()> end = {};
    std::function<void(const Json&)> notify = {};
    std::function<void(double)> set_idle = {};
};

/// Runs the verbs that others ask for on the one kept station.
std::optional<int> performKept(const Agent::Work& work, const std::shared_ptr<Station>& station,
                               const Settings& settings, const AgentHooks& hooks) {
    const auto* verb = findVerb(work.verb);
    if (verb == nullptr || verb->runs == Runs::Local) {
        work.events.emit(usageEvent("the agent does not know the verb " + work.verb));
        return kUsage;
    }
    // An agent that waits for the server to come back knows nothing new, and a stop must not wait with it.
    if (verb->runs == Runs::Anywhere && !station->connected()) return std::nullopt;
    if (verb->runs == Runs::Holder) {
        const auto name = work.args.at("entity").get<std::string>();
        const auto found = station->find(name);
        if (!found) {
            work.events.emit(errorEvent(found.refusal(), name));
            return exitOf(found.refusal());
        }
        if (!holds(*station, found->id)) {
            if (const auto lost = whyLost(*station, found->id)) {
                work.events.emit({{"event", "lost"},
                                  {"entity", callName(found.value(), station->entities())},
                                  {"code", refusalName(lost->code)},
                                  {"message", lost->message},
                                  {"holder", lost->holder}});
            }
            return std::nullopt;
        }
    }
    Session session{work.args, work.events, work.mailbox, station, settings, true};
    session.end_agent = hooks.end;
    session.notify = hooks.notify;
    session.set_idle = hooks.set_idle;
    // Who holds something should learn that somebody asks for it, whatever they came for; a stop has no time.
    if (!isStop(work.verb) && work.verb != "handover") {
        for (const auto& question : station->questions())
            work.events.emit(
                toJson(question.request, callName(question.entity, station->entities()), "axon handover"));
    }
    return verb->perform(session);
}

/// Waits for the child and for what the agent's thread serves meanwhile.
int statusOf(int wait_status) {
    if (WIFEXITED(wait_status)) return WEXITSTATUS(wait_status);
    if (WIFSIGNALED(wait_status)) return 128 + WTERMSIG(wait_status);
    return kRefused;
}

/// Starts the agent and waits until it says that it serves; its refusal to a person otherwise.
std::optional<Json> spawnAgent(const Settings& settings, const AgentPlace& place) {
    int ends[2];
    if (::pipe2(ends, O_CLOEXEC) != 0)
        return usageEvent(std::string("cannot create a pipe: ") + std::strerror(errno));
    Descriptor reading(ends[0]);
    Descriptor writing(ends[1]);
    auto words = wordsForAgent(settings);
    words.insert(words.begin(), {"axon", "agent", "run"});
    auto pointers = pointersTo(words);
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    // The descriptor for the ready line is the agent's standard output.
    ::posix_spawn_file_actions_adddup2(&actions, writing.get(), STDOUT_FILENO);
    ::posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, place.log.c_str(),
                                       O_WRONLY | O_CREAT | O_TRUNC | O_NOFOLLOW, 0600);
    const SpawnAttributes attributes(POSIX_SPAWN_SETSID);
    pid_t child = 0;
    // Only this user may read the environment of a process; of its command line that is not so.
    auto variables = environmentWithoutPassword();
    if (!settings.password.empty()) variables.push_back("AXON_PASSWORD=" + settings.password);
    auto environment = pointersTo(variables);
    const int failed = ::posix_spawn(&child, "/proc/self/exe", &actions, attributes.get(), pointers.data(),
                                     environment.data());
    ::posix_spawn_file_actions_destroy(&actions);
    if (failed != 0) return usageEvent(std::string("cannot start the agent: ") + std::strerror(failed));
    writing = Descriptor();
    std::string said;
    char bytes[4096];
    const auto patience = static_cast<int>(settings.timeout_s * 1000) + 5000;
    pollfd watched{reading.get(), POLLIN, 0};
    while (said.find('\n') == std::string::npos && ::poll(&watched, 1, patience) > 0) {
        const auto count = ::read(reading.get(), bytes, sizeof bytes);
        if (count <= 0) break;
        said.append(bytes, static_cast<std::size_t>(count));
    }
    const auto answer = Json::parse(said, nullptr, false);
    if (answer.is_object() && answer.value("ready", false)) return std::nullopt;
    if (answer.is_object() && answer.contains("event")) return answer;
    return usageEvent("the agent did not start; see its log: " + place.log.string());
}

}  // namespace

Invoker::Invoker(Settings settings, Connect connect, AskPassword ask_password)
    : settings_(std::move(settings)), connect_(std::move(connect)), ask_password_(std::move(ask_password)) {}

void Invoker::needPassword() {
    if (settings_.user.empty() || !settings_.password.empty() || !ask_password_ || !may_ask_) return;
    settings_.password = ask_password_(settings_).value_or("");
}

void Invoker::onInterrupt(std::function<void(int)> what) {
    const std::lock_guard lock(mutex_);
    on_interrupt_ = std::move(what);
    if (on_interrupt_ && pending_ > 0) {
        pending_ = 0;
        on_interrupt_(SIGINT);
    }
}

bool Invoker::interrupt(int signal) {
    const std::lock_guard lock(mutex_);
    if (on_interrupt_) {
        on_interrupt_(signal);
    } else {
        ++pending_;
    }
    return !holding_;
}

bool Invoker::takeInterrupt() {
    const std::lock_guard lock(mutex_);
    return std::exchange(pending_, 0U) > 0;
}

int Invoker::perform(const Verb& verb, Json args, Events& events) {
    interrupts_ = verb.interrupts;
    if (verb.runs == Runs::Local) {
        const auto mailbox = std::make_shared<Mailbox>();
        may_ask_ = !verb.hidden;
        if (std::string_view(verb.name) == "doctor") needPassword();
        Session session{std::move(args), events, mailbox, nullptr, settings_};
        session.connect = connect_;
        session.perform = [this](const std::string& name, const Json& other_args, Events& sink) {
            return perform(*findVerb(name), other_args, sink);
        };
        onInterrupt([mailbox](int) { mailbox->interrupt(); });
        const int exit = verb.perform(session);
        onInterrupt({});
        return exit;
    }
    const bool stopping = isStop(verb.name);
    if (auto link = openAgent(settings_)) {
        onInterrupt([&link](int) { link->interrupt(); });
        const auto outcome = link->request(verb.name, args, events, stopping ? kAcceptStop : kAccept);
        onInterrupt({});
        using Ending = AgentLink::Ending;
        if (outcome.ending == Ending::Done) return outcome.exit;
        if (outcome.ending == Ending::Broken || (outcome.ending == Ending::NoAnswer && !stopping)) {
            // A stop goes on by itself below; anything else might be done twice.
            if (!stopping) {
                const bool gone = outcome.ending == Ending::Broken;
                events.emit(
                    {{"event", "error"},
                     {"code", refusalName(RefusalCode::NotConnected)},
                     {"message",
                      gone ? "the agent that keeps your check-outs has ended; the server stops the robots "
                             "that it held"
                           : "the agent that keeps your check-outs does not answer"},
                     {"fix",
                      gone ? "see with axon ls what is left; then run axon checkout and axon rearm again"
                           : "end the process that axon doctor names, then run axon checkout again"}});
                return kNoServer;
            }
        }
    }
    switch (verb.runs) {
        case Runs::Keeper:
            return start(verb, args, events);
        case Runs::Kept: {
            const auto names = args.find("entity");
            if (const auto task = args.find("task");
                names == args.end() && task != args.end() && !task->empty()) {
                const Refusal refusal{RefusalCode::UnknownTask,
                                      "no task " + inQuotes(task->front().get<std::string>()) +
                                          " is known here: nothing is checked out",
                                      {}};
                events.emit(errorEvent(refusal));
                return exitOf(refusal);
            }
            if (names == args.end() || names->empty()) {
                // Nothing is held, so nothing is left to release and there are no tasks.
                if (std::string_view(verb.name) == "agent") {
                    events.emit({{"event", "agent"}, {"running", false}});
                } else {
                    events.emit({{"event", "notice"}, {"message", "nothing is checked out here"}});
                }
                return kDone;
            }
            const auto name =
                names->is_array() ? names->front().get<std::string>() : names->get<std::string>();
            const Refusal refusal{RefusalCode::NotHolder, name + " is not checked out here", {}};
            events.emit(errorEvent(refusal, name));
            return exitOf(refusal);
        }
        default:
            return withoutAgent(verb, std::move(args), events);
    }
}

int Invoker::withoutAgent(const Verb& verb, Json args, Events& events) {
    needPassword();
    auto settings = settings_;
    // A stop of everything needs no list of the entities, which may be slow to come.
    settings.await_entities =
        std::string_view(verb.name) != "stop" ||
        (!args.value("entity", std::vector<std::string>{}).empty() && !args.value("all", false));
    auto station = connect_(settings);
    if (!station) {
        auto event = noServerEvent(station.refusal(), settings_.server);
        if (isStop(verb.name)) {
            event["fix"] = "NOTHING WAS STOPPED: use the robot's own stop now";
        }
        events.emit(event);
        return station.refusal().code == RefusalCode::PermissionDenied ? kRefused : kNoServer;
    }
    const auto mailbox = std::make_shared<Mailbox>();
    Session session{std::move(args), events, mailbox, station.value(), settings_};
    onInterrupt([mailbox](int) { mailbox->interrupt(); });
    const int exit = verb.perform(session);
    onInterrupt({});
    return exit;
}

int Invoker::start(const Verb& verb, const Json& args, Events& events) {
    if (const char* named = namedAgent(settings_)) {
        events.emit(
            usageEvent(std::string("the agent named by AXON_AGENT is gone: ") + named, "unset AXON_AGENT"));
        return kUsage;
    }
    const auto place = agentPlace(settings_.server);
    if (!place) {
        events.emit(errorEvent(place.refusal()));
        return kUsage;
    }
    needPassword();
    if (const auto refused = spawnAgent(settings_, place.value())) {
        events.emit(*refused);
        if (refused->value("code", "") == "USAGE") return kUsage;
        return refused->value("code", "") == "PERMISSION_DENIED" ? kRefused : kNoServer;
    }
    auto link = AgentLink::open(place->socket);
    if (!link) {
        events.emit(usageEvent("the agent has ended again; see its log: " + place->log.string()));
        return kUsage;
    }
    onInterrupt([&link](int) { link->interrupt(); });
    const auto outcome = link->request(verb.name, args, events, kAccept);
    onInterrupt({});
    return outcome.ending == AgentLink::Ending::Done ? outcome.exit : static_cast<int>(kNotConfirmed);
}

int Invoker::serveAgent(int ready_fd) {
    const auto say = [ready_fd](const Json& json) {
        const auto text = line(json) + "\n";
        static_cast<void>(::write(ready_fd, text.data(), text.size()) > 0);
    };
    const auto place = agentPlace(settings_.server);
    if (!place) {
        say(errorEvent(place.refusal()));
        return kUsage;
    }
    const Descriptor lock(::open(place->lock.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
    const auto locked = [&lock] { return lock.open() && ::flock(lock.get(), LOCK_EX | LOCK_NB) == 0; };
    // Another one may be faster (two `axon checkout` at once) and on its way to listening, or about to end:
    // then it does not listen any more, and gives the lock up.
    bool ours = locked();
    for (int i = 0; i < 50 && !ours; ++i) {
        if (AgentLink::open(place->socket)) {
            say({{"ready", true}});
            return kDone;
        }
        std::this_thread::sleep_for(milliseconds(100));
        ours = locked();
    }
    if (!ours) {
        say(usageEvent("another agent holds " + place->lock.string() + " but does not listen"));
        return kUsage;
    }
    auto station = connect_(settings_);
    if (!station) {
        say(noServerEvent(station.refusal(), settings_.server));
        return kNoServer;
    }
    auto listening = listenAt(place->socket);
    if (!listening) {
        say(errorEvent(listening.refusal()));
        return kUsage;
    }
    const auto kept = station.value();
    const SteadyClock clock{};
    IdleWatch idle(clock.now());
    const auto notifier = std::make_shared<Notifier>();
    RequestWatch requests(notifier);
    Untold untold;
    std::unique_ptr<Agent> agent;
    const AgentHooks hooks{[&agent] { agent->stop(); },
                           [&](const Json& where) {
                               notifier->aim(where);
                               requests.follow(*kept);
                           },
                           [&idle](double seconds) { idle.setLimit(Seconds(seconds)); }};
    agent = std::make_unique<Agent>(
        std::move(listening).value(),
        [&](const Agent::Work& work) {
            AgentLog::write(work.verb + " " + line(work.args));
            const auto exit = performKept(work, kept, settings_, hooks);
            requests.follow(*kept);
            if (const auto* verb = findVerb(work.verb); verb != nullptr && verb->runs != Runs::Anywhere)
                untold.told();
            AgentLog::write(work.verb + (exit ? ": exit " + std::to_string(*exit) : ": not for this agent"));
            return exit;
        },
        [&] { return !kept->held().empty() || untold.any(clock.now()); }, kLinger);
    agent->onLook([&](bool used) {
        if (giveBackUnused(*kept, idle, *notifier, AgentLog::write, clock.now(), used))
            untold.add(clock.now());
    });
    onInterrupt([&](int) { agent->stop(); });
    AgentLog::write("serving " + kept->server() + " as " + kept->self().name);
    say({{"ready", true}});
    // Not closed: it is standard output, and the next socket would get its number.
    if (const Descriptor nowhere(::open("/dev/null", O_WRONLY | O_CLOEXEC)); nowhere.open())
        ::dup2(nowhere.get(), ready_fd);
    agent->serve();
    onInterrupt({});
    ::unlink(place->socket.c_str());
    for (const auto& entity : kept->held()) static_cast<void>(kept->release(entity.id).ok());
    AgentLog::write("ended");
    return kDone;
}

int Invoker::holdWhile(const Json& args, const std::vector<std::string>& command, Events& events) {
    if (args.contains("notify")) {
        events.emit(usageEvent(
            "--notify is for the agent that axon checkout starts, not for axon checkout … -- COMMAND",
            "leave it out: requests are shown here while the command runs"));
        return kUsage;
    }
    const auto place = agentPlace(settings_.server);
    if (!place) {
        events.emit(errorEvent(place.refusal()));
        return kUsage;
    }
    needPassword();
    auto connected = connect_(settings_);
    if (!connected) {
        events.emit(noServerEvent(connected.refusal(), settings_.server));
        return connected.refusal().code == RefusalCode::PermissionDenied ? kRefused : kNoServer;
    }
    const auto station = connected.value();
    const auto mailbox = std::make_shared<Mailbox>();
    Session session{args, events, mailbox, station, settings_};
    onInterrupt([mailbox](int) { mailbox->interrupt(); });
    const auto taken = takeOut(session);
    onInterrupt({});
    if (taken.exit != kDone) return taken.exit;
    const auto& names = taken.items;
    std::vector<std::string> ids;
    for (const auto& entity : taken.entities) ids.push_back(entity.id);
    events.emit({{"event", "checked_out"}, {"entities", names}, {"kept", false}, {"for", "command"}});
    if (mailbox->takeInterrupt() || takeInterrupt()) {
        for (const auto& id : ids) static_cast<void>(station->release(id).ok());
        events.emit({{"event", "notice"}, {"message", "interrupted; the command was not run"}});
        return kInterrupted;
    }

    const auto socket = place->directory / ("run-" + std::to_string(::getpid()) + ".sock");
    // From any terminal, where the command itself, which has these in its environment, may be busy.
    const auto answer = "AXON_AGENT=" + shellWord(socket.string()) +
                        " AXON_AGENT_SERVER=" + shellWord(settings_.server) + " axon --server " +
                        shellWord(settings_.server) + " handover";
    std::vector<std::shared_ptr<void>> listening;
    std::mutex telling;
    for (std::size_t i = 0; i < ids.size(); ++i) {
        Listener listener;
        listener.lost = [&events, &telling, name = names[i]["call"]](const Refusal& refusal) {
            const std::lock_guard lock(telling);
            events.emit({{"event", "lost"},
                         {"entity", name},
                         {"code", refusalName(refusal.code)},
                         {"message", refusal.message},
                         {"holder", refusal.holder}});
        };
        const auto say = [&events, &telling](const Json& event) {
            const std::lock_guard lock(telling);
            events.emit(event);
        };
        listener.hand_over = [say, answer, name = names[i]["call"]](const HandOverRequest& request) {
            say(toJson(request, name, answer));
        };
        listener.orphaned = [say, name = names[i]["call"]](const std::string& reason) {
            say({{"event", "orphaned"}, {"entity", name}, {"message", reason}});
        };
        listener.resumed = [say, name = names[i]["call"]] { say({{"event", "resumed"}, {"entity", name}}); };
        listening.push_back(station->listen(ids[i], std::move(listener)));
    }

    auto listened = listenAt(socket);
    if (!listened) {
        events.emit(errorEvent(listened.refusal()));
        return kUsage;
    }
    // Ends with the command, not by itself.
    std::unique_ptr<Agent> agent;
    agent = std::make_unique<Agent>(
        std::move(listened).value(),
        [&](const Agent::Work& work) { return performKept(work, station, settings_, {}); },
        [] { return true; }, kLinger);
    std::thread serving([&agent] { agent->serve(); });

    ::setenv("AXON_AGENT", socket.c_str(), 1);
    ::setenv("AXON_AGENT_SERVER", settings_.server.c_str(), 1);
    ::setenv("AXON_SERVER", settings_.server.c_str(), 1);
    if (!settings_.config.empty()) ::setenv("AXON_CONFIG", settings_.config.c_str(), 1);
    auto words = command;
    auto pointers = pointersTo(words);
    const SpawnAttributes attributes;
    pid_t child = 0;
    int exit = kDone;
    if (const int failed = ::posix_spawnp(&child, words.front().c_str(), nullptr, attributes.get(),
                                          pointers.data(), environ);
        failed != 0) {
        events.emit(usageEvent("cannot run " + words.front() + ": " + std::strerror(failed)));
        exit = failed == ENOENT ? 127 : 126;
    } else {
        // Ctrl-C reaches the command by itself, which shares our terminal; other requests to end are passed
        // on.
        {
            const std::lock_guard lock(mutex_);
            holding_ = true;
        }
        if (takeInterrupt()) ::kill(child, SIGINT);  // it may have come before the command was there
        onInterrupt([child](int signal) {
            if (signal != SIGINT) ::kill(child, signal);
        });
        int status = 0;
        while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
        }
        onInterrupt({});
        exit = statusOf(status);
    }
    agent->stop();
    serving.join();
    ::unlink(socket.c_str());
    listening.clear();
    for (const auto& id : ids) {
        // Refused when it was lost, which has been said.
        static_cast<void>(station->release(id).ok());
    }
    return exit;
}

}  // namespace axon::cli
