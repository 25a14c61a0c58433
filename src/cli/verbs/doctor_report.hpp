// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <ctime>
#include <string>

#include "cli/reach.hpp"
#include "cli/session.hpp"

namespace axon::cli {

/// Emits the findings of `axon doctor` as they are made, and remembers whether one of them is bad. One
/// thread.
class Report {
  public:
    explicit Report(Events& events) : events_(events) {}
    void ok(const std::string& name, const std::string& message) { say("ok", name, message, {}); }
    void warn(const std::string& name, const std::string& message, const std::string& fix) {
        say("warn", name, message, fix);
    }
    void bad(const std::string& name, const std::string& message, const std::string& fix) {
        say("bad", name, message, fix);
        any_bad_ = true;
    }
    bool anyBad() const { return any_bad_; }

  private:
    void say(const char* level, const std::string& name, const std::string& message, const std::string& fix) {
        Json check{{"event", "finding"}, {"level", level}, {"name", name}, {"message", message}};
        if (!fix.empty()) check["fix"] = fix;
        events_.emit(check);
    }
    Events& events_;
    bool any_bad_ = false;
};

// Parts of `axon doctor`, with what they find out passed in.

/// What keeps a session with this server from being made, as far as it can be seen from here.
void explainNoServer(Report& report, const std::string& server, const Network& network = {});
/// Whether a thread of this user may run with real-time priority.
void reportRealTime(Report& report, bool permitted, const std::string& user);
/// Certificates, and the times in records of runs, go by the clock of the machine. `kind` and `status` are
/// those of adjtimex; with a kind of -1, which says that nothing is known, nothing is said of time servers.
void reportClock(Report& report, std::time_t now, int kind, int status);

/// `axon doctor --security`: what of the set-up lets somebody in who should not be
/// (docs/explanation/threats.md).
void checkSecurity(Report& report, Session& session);
/// The same of the links between servers that this configuration of axon-server, IceStorm or glacier2router
/// sets (docs/reference/tls.md, "Links between servers"), one finding for each link.
void checkLinks(Report& report, const std::string& file);

}  // namespace axon::cli
