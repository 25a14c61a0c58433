// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/caretaker.hpp"

#include <fcntl.h>
#include <spawn.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <set>
#include <thread>

#include "cli/table.hpp"
#include "cli/view.hpp"
#include "cli/words.hpp"
#include "common/descriptor.hpp"

extern char** environ;

namespace axon::cli {
namespace {

constexpr const char* kOfDesktop[] = {"DISPLAY", "WAYLAND_DISPLAY", "XAUTHORITY", "DBUS_SESSION_BUS_ADDRESS",
                                      "XDG_RUNTIME_DIR"};

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

void tellDesktop(const std::vector<std::string>& variables, const std::string& text) {
    std::vector<std::string> words{"notify-send", "--app-name=axon", "--urgency=critical", "--", "Axon",
                                   text};
    std::vector<std::string> environment = variables;
    for (char** variable = environ; *variable != nullptr; ++variable) {
        const std::string_view one = *variable;
        const auto name = one.substr(0, one.find('=') + 1);
        const bool told = std::any_of(variables.begin(), variables.end(),
                                      [&](const std::string& other) { return other.starts_with(name); });
        if (!told && !one.starts_with("AXON_PASSWORD")) environment.emplace_back(one);
    }
    const auto pointers = [](std::vector<std::string>& texts) {
        std::vector<char*> list;
        for (auto& one : texts) list.push_back(one.data());
        list.push_back(nullptr);
        return list;
    };
    pid_t child = 0;
    if (::posix_spawnp(&child, "notify-send", nullptr, nullptr, pointers(words).data(),
                       pointers(environment).data()) != 0)
        return;
    std::thread([child] {
        int status = 0;
        ::waitpid(child, &status, 0);
    }).detach();
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
    Json environment = Json::object();
    for (const auto* name : kOfDesktop) {
        const char* value = std::getenv(name);
        if (value != nullptr && *value != '\0') environment[name] = value;
    }
    const bool desktop = environment.contains("DISPLAY") || environment.contains("WAYLAND_DISPLAY") ||
                         environment.contains("DBUS_SESSION_BUS_ADDRESS");
    if (desktop) where["environment"] = std::move(environment);
    return where;
}

void Notifier::aim(const Json& where) {
    const std::lock_guard lock(mutex_);
    aimed_ = true;
    terminal_ = where.value("terminal", "");
    environment_.clear();
    const auto variables = where.value("environment", Json::object());
    for (const auto* name : kOfDesktop)
        if (variables.contains(name) && variables[name].is_string())
            environment_.push_back(std::string(name) + "=" + variables[name].get<std::string>());
}

bool Notifier::aimed() const {
    const std::lock_guard lock(mutex_);
    return aimed_;
}

void Notifier::tell(const std::string& text) const {
    std::string terminal;
    std::vector<std::string> environment;
    {
        const std::lock_guard lock(mutex_);
        if (!aimed_) return;
        terminal = terminal_;
        environment = environment_;
    }
    const auto harmless = printable(text);
    if (!terminal.empty()) tellTerminal(terminal, harmless);
    if (!environment.empty()) tellDesktop(environment, harmless);
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
