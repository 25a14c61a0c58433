// SPDX-License-Identifier: GPL-2.0-or-later
#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <pthread.h>
#include <pwd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/timex.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <ctime>
#include <map>
#include <thread>

#include "cli/agent_link.hpp"
#include "cli/distribution.hpp"
#include "cli/holding.hpp"
#include "cli/reach.hpp"
#include "cli/verbs/doctor_report.hpp"
#include "cli/view.hpp"
#include "cli/words.hpp"
#include "common/rate_limit.hpp"
#include "common/refusal.hpp"
#include "common/release.hpp"
#include "host/port_range.hpp"
#include "messages/text.hpp"

// axon doctor
namespace axon::cli {
namespace {

using Clock = std::chrono::steady_clock;

// Thesis B.3.1's range of ports for the link between a robot application and its Entity Manager.
constexpr int kFirstPort = 5500;
constexpr int kLastPort = 8000;

/// A server has four ports, one after the other unless it is told otherwise.
constexpr int kServerPorts = 4;
constexpr std::chrono::milliseconds kReach{2000};
constexpr std::time_t kBuiltAfter = 1735689600;  // 2025: this program is younger

double secondsSince(Clock::time_point start) {
    return Seconds(Clock::now() - start).count();
}

/// "all of them are switched off (battery low)", "2 of them are switched off: Driving (battery low),
/// Turning"; empty where none is.
std::string switchedOff(const std::vector<Service>& services) {
    std::vector<const Service*> off;
    for (const auto& service : services)
        if (!service.active) off.push_back(&service);
    if (off.empty()) return {};
    const auto why = [](const Service& service) {
        return service.inactive_reason.empty() ? std::string() : " (" + service.inactive_reason + ")";
    };
    const bool all = off.size() == services.size();
    const bool same = std::all_of(off.begin(), off.end(),
                                  [&](const Service* one) { return why(*one) == why(*off.front()); });
    auto text = std::string(all               ? "all of them are"
                            : off.size() == 1 ? "one of them is"
                                              : fmt::format("{} of them are", off.size()));
    text += " switched off by the robot's application";
    if (all && same) return text + why(*off.front());
    text += ':';
    for (const auto* one : off) text += (one == off.front() ? " " : ", ") + one->name + why(*one);
    return text;
}

void checkEntities(Report& report, Station& station) {
    const auto all = station.entities(Listed::All);
    if (all.empty()) {
        report.warn("entities", "no entity is connected",
                    "start a robot's application and its axon-entity-manager, whose log says if it cannot "
                    "reach the server");
    }
    for (const auto& entity : all) {
        const auto name = callName(entity, all);
        const auto state = std::string(axon::toString(entity.state));
        const auto because = entity.reason.empty() ? std::string() : ": " + entity.reason;
        switch (entity.state) {
            case EntityState::UNAV:
                report.bad(
                    name, state + because,
                    "start the robot's application with the same ports.cfg, or correct --application of "
                    "the Entity Manager; an application that ends at once says why, for example that the "
                    "folder of its profiles is another one");
                continue;
            case EntityState::ERR:
                report.bad(
                    name, state + because,
                    "correct the profiles (axon profile check FILE); they are read again automatically");
                continue;
            case EntityState::INIT:
                if (!entity.reason.empty()) {
                    report.bad(name, state + because,
                               "correct the robot's application; its log says the same");
                    continue;
                }
                [[fallthrough]];
            case EntityState::ENVCONN:
                report.warn(name, state + because, "it is starting: run axon doctor again in a second");
                continue;
            default:
                break;
        }
        const auto start = Clock::now();
        const auto details = station.details(entity.id);
        const auto round_trip = secondsSince(start);
        if (!details) {
            report.bad(name, state + "; it does not list its services: " + details.refusal().message,
                       "see the log of its axon-entity-manager");
            continue;
        }
        for (const auto& finding : details->findings) report.warn(name, finding.message, finding.fix);
        const auto& services = details->services;
        auto message = fmt::format("{}, lists its {} service{} in {}", state, services.size(),
                                   services.size() == 1 ? "" : "s", duration(round_trip));
        const auto off = switchedOff(services);
        if (!off.empty()) message += "; " + off;
        const bool any_on =
            std::any_of(services.begin(), services.end(), [](const Service& one) { return one.active; });
        if (!off.empty() && !any_on) {
            report.warn(name, message + (entity.latched ? "; stopped" : ""),
                        "it takes no tasks until its application switches a service on again: see the reason "
                        "that it gives, or its log");
        } else if (entity.latched) {
            report.warn(name, message + "; stopped", remedyFor(RefusalCode::Latched, shellWord(name), {}));
        } else if (round_trip > 0.1) {
            report.warn(name, message + ": slow", "find out what loads the machine or the network");
        } else {
            report.ok(name, message);
        }
    }
}

/// How long a stop takes to each robot application and back, by a drill: nothing is stopped.
void checkSignalLane(Report& report, Station& station) {
    const auto there = std::max<std::size_t>(1, station.entities(Listed::All).size());
    const int tries = static_cast<int>(std::clamp<std::size_t>(kDrillsPerSecond / there, 1, 10));
    constexpr double kSlow_ms = 20;
    std::map<std::string, Distribution> times;
    for (int i = 0; i < tries; ++i) {
        const auto reports = station.drill({});
        if (!reports) {
            report.bad("signal lane", reports.refusal().message, "axon drill --all shows more");
            return;
        }
        for (const auto& one : reports.value()) {
            if (one.no_application) continue;
            for (const auto& time : one.callback) times[one.entity].add(time);
        }
    }
    const auto all = station.entities();
    for (const auto& [id, measured] : times) {
        const auto entity =
            std::find_if(all.begin(), all.end(), [&id = id](const Entity& e) { return e.id == id; });
        const auto name = entity == all.end() ? id : callName(*entity, all);
        if (measured.never() > 0) {
            report.bad(
                "signal lane",
                fmt::format("{} of {} drills of {} never arrived", measured.never(), measured.count(), name),
                "axon drill " + shellWord(name) + " shows more; see the log of its axon-entity-manager");
            continue;
        }
        const auto slowest = measured.quantile(1).value_or(0);
        const auto message = fmt::format("a stop takes {} to {} and back, at most {} (drills: {})",
                                         duration(measured.quantile(0.5).value_or(0) / 1000), name,
                                         duration(slowest / 1000), tries);
        if (slowest > kSlow_ms) {
            report.warn("signal lane", message, "find out what loads the machine or the network");
        } else {
            report.ok("signal lane", message);
        }
    }
}

/// Whether the ports of a server are free on this machine, where none runs.
void checkServerPorts(Report& report, std::uint16_t first) {
    std::string taken;
    for (int port = first; port < first + kServerPorts && port <= 65535; ++port)
        if (isTaken(static_cast<std::uint16_t>(port)))
            taken += (taken.empty() ? "" : ", ") + std::to_string(port);
    if (taken.empty()) return;
    report.bad(
        "server ports", "in use by another program: " + taken,
        "see with ss -ltnp which one, or start the server at other ports: axon-server --base-port 10510, and "
        "--server 127.0.0.1:10510 here");
}

}  // namespace

void explainNoServer(Report& report, const std::string& server, const Network& network) {
    const auto place = hostPortOf(server);
    if (!place) return;
    const bool here = place->host == "localhost" || isLoopback(place->host);
    const auto at = place->host + " port " + std::to_string(place->port);
    switch (reach(place->host, place->port, kReach, network)) {
        case Reach::UnknownHost:
            report.bad("network", "no machine is called " + inQuotes(place->host),
                       "correct the name in --server, or give the address");
            return;
        case Reach::NoResolver:
            report.bad("network",
                       "whether a machine is called " + inQuotes(place->host) +
                           " cannot be known: the name service (DNS) does not answer",
                       "check the network and the name servers in /etc/resolv.conf, or give the address in "
                       "--server");
            return;
        case Reach::Unreachable:
            report.bad("network", "there is no way to " + place->host,
                       "check the cable, the Wi-Fi and the address");
            return;
        case Reach::Silent:
            report.bad("network",
                       at + " does not answer: a firewall drops connections to it, or the machine is off",
                       fmt::format("on that machine, allow TCP ports {} to {} (docs/reference/ports.md)",
                                   place->port, place->port + kServerPorts - 1));
            return;
        case Reach::Refused:
            if (here) return checkServerPorts(report, place->port);
            report.bad("network", "the machine answers, and nothing listens at " + at,
                       "start axon-server there with --listen and its address; without it, it serves its own "
                       "machine only (docs/how-to/deploy.md)");
            return;
        case Reach::Open:
            break;
    }
    if (place->port == 65535) return;
    // A server tells clients its second port, which is the next one unless it is told otherwise.
    if (reach(place->host, static_cast<std::uint16_t>(place->port + 1), kReach, network) == Reach::Silent) {
        report.bad(
            "network",
            fmt::format("port {} of {} can be reached, and port {} cannot: a firewall lets only one of the "
                        "server's ports through",
                        place->port, place->host, place->port + 1),
            fmt::format("on that machine, allow TCP ports {} to {} (docs/reference/ports.md)", place->port,
                        place->port + kServerPorts - 1));
        return;
    }
    report.bad("network", "a program listens at " + at + " that lets no client of Axon in",
               "check that it is axon-server of the same release, with the same TLS setting (ssl:// or not)");
}

void reportRealTime(Report& report, bool permitted, const std::string& user) {
    if (permitted) {
        report.ok("real time", "the signal lane can run with real-time priority");
        return;
    }
    report.warn("real time", "not permitted (ulimit -r is 0): stops share the processor with everything else",
                "put '" + user + " - rtprio 20' into /etc/security/limits.d/axon.conf, and log in again");
}

void reportClock(Report& report, std::time_t now, int kind, int status) {
    std::tm parts{};
    ::gmtime_r(&now, &parts);
    char text[32];
    std::strftime(text, sizeof text, "%F %T UTC", &parts);
    const auto time = std::string("it is ") + text + " by the clock of this machine";
    if (now < kBuiltAfter) {
        report.bad("clock", time + ", which is too early", "set it: timedatectl set-ntp true, or date -s");
    } else if (kind == -1) {
        report.ok("clock", time);
    } else if (kind == TIME_ERROR || (status & STA_UNSYNC) != 0) {
        report.warn(
            "clock", time + ", which no time server corrects",
            "timedatectl set-ntp true; certificates that are not valid yet, or no longer, come of a wrong "
            "clock");
    } else {
        report.ok("clock", std::string("it is ") + text + ", and a time server corrects the clock");
    }
}

namespace {

void checkServer(Report& report, Session& session) {
    const auto start = Clock::now();
    const auto station = session.connect(session.settings);
    if (!station) {
        const auto event = noServerEvent(station.refusal(), session.settings.server);
        report.bad("server", event.value("message", ""), event.value("fix", ""));
        // One that has answered has said why.
        if (station.refusal().code == RefusalCode::Unavailable ||
            station.refusal().code == RefusalCode::TimedOut)
            explainNoServer(report, session.settings.server);
        return;
    }
    report.ok("server", "session at " + station.value()->server() + " as " + station.value()->self().name +
                            " in " + duration(secondsSince(start)));
    checkEntities(report, *station.value());
    checkSignalLane(report, *station.value());
}

void checkAgent(Report& report, const Settings& settings) {
    const auto directory = runtimeDirectory();
    bool exists = false;
    const auto refusal = checkRuntimeDirectory(directory, exists);
    if (!refusal.ok()) {
        report.bad("agent", refusal.message, {});
        return;
    }
    const auto place = agentPlace(settings.server);
    if (!place) {
        report.bad("agent", place.refusal().message, {});
        return;
    }
    struct stat found {};
    if (::lstat(place->socket.c_str(), &found) != 0) {
        report.ok("agent",
                  "none is running (axon checkout starts one); " + directory.string() + " is private");
    } else if ((found.st_mode & 0777U) != 0600U || found.st_uid != ::getuid()) {
        report.bad("agent", "other users can use " + place->socket.string(),
                   "end it with axon agent stop, and find out who changed the mode");
    } else if (const auto link = AgentLink::open(place->socket); !link) {
        report.ok("agent", "none is running; " + place->socket.string() + " is left over and does no harm");
    } else {
        report.ok("agent", "process " + std::to_string(link->process()) + " at " + place->socket.string());
    }
}

void checkRealTime(Report& report) {
    int refused = 0;
    std::thread([&refused] {
        sched_param param{};
        param.sched_priority = 1;
        refused = ::pthread_setschedparam(::pthread_self(), SCHED_RR, &param);
    }).join();
    const passwd* self = ::getpwuid(::geteuid());
    reportRealTime(report, refused == 0, self != nullptr ? self->pw_name : std::to_string(::geteuid()));
}

void checkClock(Report& report) {
    timex state{};
    const int kind = ::adjtimex(&state);
    reportClock(report, std::time(nullptr), kind, state.status);
}

void checkPorts(Report& report) {
    int taken = 0;
    int first_free = 0;
    for (int port = kFirstPort; port <= kLastPort; ++port) {
        const Descriptor fd(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
        if (!fd.open()) break;
        sockaddr_in address{};
        address.sin_family = AF_INET;
        address.sin_port = htons(static_cast<std::uint16_t>(port));
        address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        if (::bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
            ++taken;
        } else if (first_free == 0) {
            first_free = port;
        }
    }
    const int all = kLastPort - kFirstPort + 1;
    if (first_free == 0) {
        report.bad("ports",
                   fmt::format("none of {} to {} is free for robot applications", kFirstPort, kLastPort),
                   "see with ss -ltn which programs use them, or set another range in ports.cfg");
    } else {
        report.ok("ports", fmt::format("{} of {} ports for robot applications are free, the first is {}",
                                       all - taken, all, first_free));
    }
}

int doctor(Session& session) {
    const bool security = session.args.value("security", false);
    if (!security && session.args.contains("links"))
        return misused(session, "--links FILE is looked at with --security only");
    Report report(session.events);
    report.ok("axon", std::string("version ") + kRelease);
    if (security) {
        checkSecurity(report, session);
        checkAgent(report, session.settings);
        return report.anyBad() ? kRefused : kDone;
    }
    checkServer(report, session);
    checkAgent(report, session.settings);
    checkRealTime(report);
    checkClock(report);
    checkPorts(report);
    return report.anyBad() ? kRefused : kDone;
}

}  // namespace

extern const Verb kDoctor{
    "doctor",
    "Check the set-up, and say what is wrong with it",
    "  axon doctor\n"
    "  axon doctor --server lab.example.org:10410\n"
    "  axon doctor --security\n"
    "  axon doctor --security --links server.cfg             also the links between several servers\n"
    "Each line is fine (✓), a warning (!) or an error (✗). The exit status is 1 if there is an error.\n",
    Runs::Local,
    {},
    {{"security", Takes::Nothing,
      "Check instead who can log in without permission, and what others can read on the network or on this "
      "machine"},
     {"links", Takes::File,
      "With --security: the configuration of a server, of IceStorm or of glacier2router whose links to other "
      "servers are checked, too (default /etc/axon/server.cfg, if it is there)"}},
    doctor};

}  // namespace axon::cli
