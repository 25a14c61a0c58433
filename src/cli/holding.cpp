// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/holding.hpp"

#include <algorithm>
#include <stop_token>
#include <thread>
#include <utility>

#include "cli/words.hpp"

namespace axon::cli {

namespace {

/// What to do where the code of the refusal alone does not tell: it depends on who asks, and who the holder
/// is.
std::string fixFor(const Session& session, const Refusal& refusal, const std::string& entity) {
    const auto x = entity.empty() ? std::string("ENTITY") : shellWord(entity);
    if (refusal.code == RefusalCode::TimedOut && !refusal.holder.empty())
        return "give it more time: axon checkout " + x +
               " --wait=SECONDS; or ask the holder: axon checkout " + x + " --ask REASON";
    const bool held = refusal.code == RefusalCode::AlreadyHeld || refusal.code == RefusalCode::Reserved;
    if (!session.station || !(held || refusal.code == RefusalCode::NotHolder)) return {};
    const auto self = session.station->self();
    if (self.role == Role::Observer)
        return "an observer cannot check out entities: log in as an operator with --user";
    if (!held || refusal.holder.empty()) return {};
    const auto wait = "wait until it is free: axon checkout " + x + " --wait";
    const auto found = session.station->find(entity);
    if (found && found->orphaned)
        return refusal.holder + " has lost its connection, and " + x +
               " becomes free if it does not come back in time; " + wait;
    if (refusal.holder == self.name)
        return "another command of yours holds it: end that command, run axon release " + x +
               " where it was checked out, or " + wait;
    return {};
}

}  // namespace

int refuse(Session& session, const Refusal& refusal, const std::string& entity) {
    return refuseWith(session, refusal, fixFor(session, refusal, entity), entity);
}

int refuseWith(Session& session, const Refusal& refusal, const std::string& fix, const std::string& entity) {
    auto event = errorEvent(refusal, entity);
    if (!fix.empty()) event["fix"] = fix;
    session.events.emit(event);
    return exitOf(refusal);
}

int misused(Session& session, const std::string& message, const std::string& fix) {
    session.events.emit(usageEvent(message, fix));
    return kUsage;
}

namespace {
bool holds(const Station& station, const std::string& id) {
    const auto held = station.held();
    return std::any_of(held.begin(), held.end(), [&](const Entity& entity) { return entity.id == id; });
}

/// How long a check-out that was given up may take to say so.
constexpr std::chrono::seconds kGiveUpTime{2};

}  // namespace

/// The library's call waits: on a thread, so that the wait is shown and Ctrl-C heard. What the thread needs
/// it owns, because a verb that is interrupted twice leaves it behind.
Result<std::vector<Entity>> takeAndShow(Session& session, const std::vector<std::string>& ids,
                                        const std::string& query, CheckOutOptions options,
                                        bool& interrupted) {
    using Answer = Result<std::vector<Entity>>;
    const auto answer = std::make_shared<Answer>(Refusal{RefusalCode::Cancelled, "it was cancelled", {}});
    std::stop_source give_up;
    options.give_up = give_up.get_token();
    const auto started = std::chrono::steady_clock::now();
    options.on_waiting = [mailbox = session.mailbox, started](const client::Waiting& waiting) {
        const Seconds elapsed = std::chrono::steady_clock::now() - started;
        mailbox->post({{"event", "waiting"},
                       {"entity_id", waiting.entity},
                       {"place", waiting.place},
                       {"message", waiting.message},
                       {"elapsed_s", elapsed.count()}},
                      true);
    };
    std::thread([mailbox = session.mailbox, station = session.station, answer, ids, query, options] {
        *answer = query.empty() ? station->checkOut(ids, options) : station->checkOutQuery(query, options);
        mailbox->post({{"event", "end"}});
    }).detach();
    std::optional<std::chrono::steady_clock::time_point> deadline;
    bool answered = false;
    while (!answered) {
        if (const auto event = session.mailbox->wait(deadline)) {
            answered = event->at("event") == "end";
            if (!answered) session.events.emit(*event);
            continue;
        }
        if (!session.mailbox->takeInterrupt() || interrupted) break;  // the thread is left behind
        interrupted = true;
        give_up.request_stop();
        deadline = std::chrono::steady_clock::now() + kGiveUpTime;
    }
    if (!interrupted) return *answer;
    // Granted in the very moment that it was given up.
    if (answered && answer->ok())
        for (const auto& entity : answer->value())
            static_cast<void>(session.station->release(entity.id).ok());
    session.events.emit({{"event", "notice"}, {"message", "cancelled; nothing was checked out"}});
    return Refusal{RefusalCode::Cancelled, "it was cancelled", {}};
}

std::optional<Holding> Holding::of(Session& session, const std::string& name, const std::string& what,
                                   int& exit) {
    const auto found = session.station->find(name);
    if (!found) {
        exit = refuse(session, found.refusal(), name);
        return std::nullopt;
    }
    const auto& entity = found.value();
    if (holds(*session.station, entity.id)) return Holding(session, entity, false);
    bool interrupted = false;
    if (const auto granted = takeAndShow(session, {entity.id}, {}, {}, interrupted); !granted) {
        exit = interrupted ? kInterrupted : refuse(session, granted.refusal(), name);
        return std::nullopt;
    }
    session.events.emit(
        {{"event", "checked_out"},
         {"entities", {{{"id", entity.id}, {"name", entity.name}, {"call", callOf(session, entity)}}}},
         {"kept", false},
         {"for", what}});
    return Holding(session, entity, true);
}

Holding::Holding(Session& session, Entity entity, bool own)
    : station_(session.station), entity_(std::move(entity)), call_(callOf(session, entity_)), own_(own) {}

Holding::Holding(Holding&& other) noexcept
    : station_(std::move(other.station_)),
      entity_(std::move(other.entity_)),
      call_(std::move(other.call_)),
      own_(std::exchange(other.own_, false)) {}

Holding::~Holding() {
    // A refusal here means that it is not ours any more: what was wanted.
    if (own_) static_cast<void>(station_->release(entity_.id).ok());
}

Result<CheckOutOptions> checkOutOptions(const Json& args) {
    CheckOutOptions options;
    if (const auto wait = args.find("wait"); wait != args.end()) {
        // Without a number: until it is granted or given up.
        options.wait = wait->is_number() ? Seconds(wait->get<double>()) : Seconds(86400);
    }
    options.ask = args.contains("ask");
    options.force = args.contains("force");
    if (options.ask && options.force) {
        return Refusal{RefusalCode::Malformed, "expected --ask or --force, found both", {}};
    }
    options.reason = args.value("ask", args.value("force", ""));
    const auto policy = args.value("hand-over", "ask");
    options.hand_over.yield = policy == "yield";
    options.hand_over.refuse = policy == "refuse";
    return options;
}

Taken takeOut(Session& session) {
    Taken taken;
    const auto fail = [&](int exit) {
        taken.exit = exit;
        return taken;
    };
    const auto names = session.args.value("entity", std::vector<std::string>{});
    const auto query = session.args.value("query", "");
    if (names.empty() == query.empty()) {
        return fail(misused(session,
                            names.empty() ? "expected entities or --query, found neither"
                                          : "expected entities or --query, found both",
                            "axon checkout PeopleBot, or axon checkout --query '1 ROBOT/MOBILE'"));
    }
    const auto options = checkOutOptions(session.args);
    if (!options) return fail(misused(session, options.refusal().message));
    std::vector<std::string> ids;
    std::string call;
    for (const auto& name : names) {
        const auto found = session.station->find(name);
        if (!found) return fail(refuse(session, found.refusal(), name));
        call = callOf(session, found.value());
        if (holds(*session.station, found->id)) {
            taken.already.push_back({{"id", found->id}, {"name", found->name}, {"call", call}});
        } else if (std::find(ids.begin(), ids.end(), found->id) == ids.end()) {
            ids.push_back(found->id);
        }
    }
    if (ids.empty() && query.empty()) return taken;
    bool interrupted = false;
    const auto granted = takeAndShow(session, ids, query, options.value(), interrupted);
    if (interrupted) return fail(kInterrupted);
    if (!granted) {
        if (granted.refusal().code == RefusalCode::Malformed && !query.empty())
            return fail(misused(session, granted.refusal().message));
        if (granted.refusal().code == RefusalCode::Duplicate) {
            auto event = errorEvent(granted.refusal(), call);
            event["fix"] =
                "another axon checkout of yours is already waiting for it: end that one with Ctrl-C, or let "
                "it wait";
            session.events.emit(event);
            return fail(exitOf(granted.refusal()));
        }
        return fail(refuse(session, granted.refusal(), ids.size() == 1 ? call : ""));
    }
    taken.entities = granted.value();
    for (const auto& entity : taken.entities) {
        taken.items.push_back({{"id", entity.id}, {"name", entity.name}, {"call", callOf(session, entity)}});
    }
    return taken;
}

std::string callOf(const Session& session, const Entity& entity) {
    return callName(entity, session.station->entities());
}

bool tellLost(Session& session) {
    const auto all = session.station->lost();
    for (const auto& lost : all) {
        session.events.emit({{"event", "notice"},
                             {"message", "the check-out of " + callOf(session, lost.entity) +
                                             " was lost: " + lost.why.message}});
    }
    return !all.empty();
}

std::optional<Refusal> whyLost(const Station& station, const std::string& id) {
    for (const auto& lost : station.lost()) {
        if (lost.entity.id == id) return lost.why;
    }
    return std::nullopt;
}

Result<Entity> findHeld(Session& session, const std::string& name) {
    auto found = session.station->find(name);
    if (!found) return found;
    if (holds(*session.station, found->id)) return found;
    Refusal refusal{RefusalCode::NotHolder, callOf(session, found.value()) + " is not checked out here", {}};
    if (const auto lost = whyLost(*session.station, found->id)) {
        refusal = *lost;
        refusal.message =
            "the check-out of " + callOf(session, found.value()) + " was lost: " + lost->message;
    }
    return refusal;
}

std::shared_ptr<void> listenTo(Session& session, const Entity& entity) {
    Listener listener;
    const auto mailbox = session.mailbox;
    const auto name = callOf(session, entity);
    listener.text = [=](const std::string& text) {
        mailbox->post({{"event", "text"}, {"entity", name}, {"text", text}}, true);
    };
    listener.raw = [=](const std::string& bytes) {
        mailbox->post({{"event", "raw"}, {"entity", name}, {"size", bytes.size()}, {"hex", toHex(bytes)}},
                      true);
    };
    listener.lost = [=](const Refusal& refusal) {
        mailbox->post({{"event", "lost"},
                       {"entity", name},
                       {"code", refusalName(refusal.code)},
                       {"message", refusal.message},
                       {"holder", refusal.holder}});
    };
    listener.orphaned = [=](const std::string& reason) {
        mailbox->post({{"event", "orphaned"}, {"entity", name}, {"message", reason}});
    };
    listener.resumed = [=] { mailbox->post({{"event", "resumed"}, {"entity", name}}); };
    // Only what an agent keeps can be answered for from another command.
    const std::string answer = session.kept ? "axon handover" : "";
    listener.hand_over = [=](const HandOverRequest& request) {
        mailbox->post(toJson(request, name, answer));
    };
    return session.station->listen(entity.id, std::move(listener));
}

std::string toHex(const std::string& bytes) {
    static constexpr char kDigits[] = "0123456789abcdef";
    std::string hex;
    hex.reserve(bytes.size() * 2);
    for (const char c : bytes) {
        const auto byte = static_cast<unsigned char>(c);
        hex += kDigits[byte >> 4U];
        hex += kDigits[byte & 15U];
    }
    return hex;
}

std::optional<std::string> fromHex(const std::string& hex) {
    if (hex.size() % 2 != 0) return std::nullopt;
    const auto digit = [](char c) {
        if (c >= '0' && c <= '9') return c - '0';
        if (c >= 'a' && c <= 'f') return c - 'a' + 10;
        return -1;
    };
    std::string bytes;
    bytes.reserve(hex.size() / 2);
    for (std::size_t i = 0; i < hex.size(); i += 2) {
        const int high = digit(hex[i]);
        const int low = digit(hex[i + 1]);
        if (high < 0 || low < 0) return std::nullopt;
        bytes += static_cast<char>(high * 16 + low);
    }
    return bytes;
}

}  // namespace axon::cli
