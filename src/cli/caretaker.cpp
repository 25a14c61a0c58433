// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/caretaker.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <set>

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
        warned_ = false;
        return Says::Nothing;
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

Json reachableAt() {
    Json where = Json::object();
    for (const int fd : {STDIN_FILENO, STDERR_FILENO}) {
        char name[256];
        if (where.contains("terminal") || ::ttyname_r(fd, name, sizeof name) != 0) continue;
        where["terminal"] = name;
    }
    if (const auto desktop = Desktop::here(); desktop.takesNotifications())
        where["environment"] = desktop.json();
    return where;
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
