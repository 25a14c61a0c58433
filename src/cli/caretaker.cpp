// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/caretaker.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <set>

#include "cli/holding.hpp"
#include "cli/table.hpp"
#include "cli/view.hpp"
#include "cli/words.hpp"
#include "common/descriptor.hpp"

namespace axon::cli {
namespace {

void tellTerminal(const std::string& path, const std::string& text) {
    const Descriptor terminal(::open(path.c_str(), O_WRONLY | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
    struct stat found {};
    // It may be somebody else's by now.
    if (!terminal.open() || ::isatty(terminal.get()) == 0 || ::fstat(terminal.get(), &found) != 0 ||
        found.st_uid != ::getuid())
        return;
    const auto message = "\a\r\naxon: " + text + "\r\n";
    static_cast<void>(::write(terminal.get(), message.data(), message.size()) > 0);
}

/// Desktops read a part of HTML in a notification, and notify-send takes \n and its kind for itself; the text
/// has names and reasons that others chose.
std::string asText(const std::string& text) {
    std::string escaped;
    for (const char c : text) {
        switch (c) {
            case '&':
                escaped += "&amp;";
                break;
            case '<':
                escaped += "&lt;";
                break;
            case '>':
                escaped += "&gt;";
                break;
            case '\\':
                escaped += "\\\\";
                break;
            default:
                escaped += c;
        }
    }
    return escaped;
}

void tellDesktop(const Desktop& desktop, const std::string& text) {
    desktop.start({"notify-send", "--app-name=axon", "--urgency=critical", "--", "Axon", asText(text)});
}

}  // namespace

IdleWatch::Says IdleWatch::look(TimePoint now, bool used) {
    const auto limit = Seconds(limit_s_);
    if (used || limit.count() <= 0) {
        used_at_ = now;
        again_at_.reset();
        warned_ = false;
        return Says::Nothing;
    }
    if (again_at_) {
        if (now < *again_at_) return Says::Nothing;
        again_at_.reset();
        used_at_ = now;
        return Says::Release;
    }
    const Seconds unused = now - used_at_;
    if (unused >= limit) {
        used_at_ = now;
        warned_ = false;
        return Says::Release;
    }
    if (warned_ || unused < limit - warning()) return Says::Nothing;
    warned_ = true;
    return Says::Warn;
}

std::string terminalOf(int fd, uid_t user) {
    char name[256];
    struct stat found {};
    const bool theirs =
        ::ttyname_r(fd, name, sizeof name) == 0 && ::fstat(fd, &found) == 0 && found.st_uid == user;
    return theirs ? name : "";
}

Json reachableAt() {
    Json where = Json::object();
    for (const int fd : {STDIN_FILENO, STDERR_FILENO}) {
        if (where.contains("terminal")) continue;
        if (const auto terminal = terminalOf(fd, ::getuid()); !terminal.empty()) where["terminal"] = terminal;
    }
    if (const auto desktop = Desktop::here(); desktop.takesNotifications())
        where["environment"] = desktop.json();
    return where;
}

bool refuseUnreachable(Session& session, const Json& where) {
    if (where.contains("terminal") || where.contains("environment")) return false;
    misused(
        session,
        "--notify has no way to tell you anything: there is no desktop here, and no terminal of this user "
        "(after su it is another user's)",
        "log in as this user, or leave --notify out");
    return true;
}

void Notifier::aim(const Json& where) {
    const std::lock_guard lock(mutex_);
    aimed_ = true;
    terminal_ = where.value("terminal", "");
    desktop_ = Desktop::of(where.value("environment", Json::object()));
}

bool Notifier::aimed() const {
    const std::lock_guard lock(mutex_);
    return aimed_;
}

void Notifier::tell(const std::string& text) const {
    std::string terminal;
    Desktop desktop;
    {
        const std::lock_guard lock(mutex_);
        if (!aimed_) return;
        terminal = terminal_;
        desktop = desktop_;
    }
    const auto harmless = printable(text);
    if (!terminal.empty()) tellTerminal(terminal, harmless);
    if (desktop.takesNotifications()) tellDesktop(desktop, harmless);
}

bool isBusy(const Station& station) {
    const auto tasks = station.tasks().list;
    const auto runs = station.runs();
    return std::any_of(tasks.begin(), tasks.end(),
                       [](const KeptTask& task) { return !client::isFinal(task.report.state); }) ||
           std::any_of(runs.begin(), runs.end(),
                       [](const RunReport& run) { return !client::isFinal(run.state); });
}

bool giveBackUnused(Station& station, IdleWatch& idle, const Notifier& notifier,
                    const std::function<void(const std::string&)>& log, TimePoint now, bool used) {
    const auto held = station.held();
    const auto says = idle.look(now, used || held.empty() || isBusy(station));
    if (says == IdleWatch::Says::Nothing) return false;
    const auto all = station.entities();
    std::string names;
    const auto add = [&](const Entity& entity) {
        names += (names.empty() ? "" : ", ") + callName(entity, all);
    };
    const auto say = [&](const std::string& text) {
        log(text);
        notifier.tell(text);
    };
    if (says == IdleWatch::Says::Warn) {
        for (const auto& entity : held) add(entity);
        say(names + " is checked out and not used: it is released in " + duration(idle.warning().count()) +
            ", unless an axon command uses the check-out, such as axon agent status");
        return false;
    }
    const auto unused = duration(idle.limit().count());
    const Refusal why{RefusalCode::Expired, "it was released because nobody used it for " + unused, {}};
    bool any_refused = false;
    for (const auto& entity : held) {
        if (const auto done = station.giveBack(entity.id, why); done) {
            add(entity);
        } else {
            any_refused = true;
            log("cannot release " + callName(entity, all) + ": " + done.refusal().message +
                "; it is tried again in a minute");
        }
    }
    if (any_refused) idle.refused(now);
    if (names.empty()) return false;
    say(names + " was released: it was not used for " + unused);
    return true;
}

void RequestWatch::follow(Station& station) {
    const std::lock_guard lock(mutex_);
    if (!notifier_->aimed()) return;
    std::set<std::string> held;
    const auto all = station.entities();
    for (const auto& entity : station.held()) {
        held.insert(entity.id);
        if (listening_.count(entity.id) != 0) continue;
        const auto name = callName(entity, all);
        Listener listener;
        listener.hand_over = [notifier = notifier_, name](const HandOverRequest& request) {
            if (request.withdrawn) return notifier->tell(request.by + " no longer asks for " + name);
            const auto why = request.reason.empty() ? std::string() : ": " + request.reason;
            const auto time = request.answer_within.count();
            notifier->tell(request.by + " asks for " + name + why + ". Answer" +
                           (time > 0 ? " within " + duration(time) : "") + ": axon handover " +
                           shellWord(name) + " accept, or refuse; no answer " +
                           (request.yield ? "hands it over" : "refuses"));
        };
        listening_[entity.id] = station.listen(entity.id, std::move(listener));
    }
    std::erase_if(listening_, [&](const auto& one) { return held.count(one.first) == 0; });
}

}  // namespace axon::cli
