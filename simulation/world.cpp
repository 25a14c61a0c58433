// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/world.hpp"

#include <algorithm>
#include <array>

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;

constexpr Duration kFaultsFrom = 3s;
constexpr Duration kFaultsUntil = 36s;
constexpr Duration kRetire = 42s;
constexpr Duration kVisit = 46s;
constexpr Duration kEnd = 60s;
constexpr double kMostDrift = 0.02;
constexpr std::uint64_t kMostEvents = 100'000;

struct Named {
    const char* name;
    const char* what;
};
constexpr std::array<Named, kFaults> kNames{{
    {"none", "no fault"},
    {"delay", "messages take up to 300 ms longer for a while"},
    {"loss", "connections break, and ways are cut silently"},
    {"duplication", "clients' messages and stops arrive twice, the second time up to 3 s later"},
    {"reorder", "one lane is slower than the other"},
    {"partition", "ways are cut silently, in one direction or both, for up to 9 s"},
    {"crash",
     "processes of clients, server, Entity Managers and applications die and start again; hosts lose power"},
    {"pause", "processes are frozen for up to 9 s"},
    {"slow", "clients read slowly, from servers whose outboxes are small"},
    {"drift", "clocks run at different rates, up to 2 percent, and processes are frozen"},
    {"direct", "direct paths break, are cut or slow; nothing else fails"},
    {"lies", "a client that holds nothing and an entity lie about whatever they can"},
    {"all", "all of these but the lies in one run"},
}};

}  // namespace

const char* toString(Faults faults) {
    return kNames[static_cast<std::size_t>(faults)].name;
}
const char* describe(Faults faults) {
    return kNames[static_cast<std::size_t>(faults)].what;
}
std::optional<Faults> faultsOf(std::string_view name) {
    for (std::size_t i = 0; i < kNames.size(); ++i)
        if (name == kNames[i].name) return static_cast<Faults>(i);
    return std::nullopt;
}

struct World::Robot {
    Robot(Timeline& timeline, Network& network, Dice& dice, Observer& observer, ServerStation& server,
          Process& outside, std::size_t number, std::uint64_t seed)
        : application(timeline, network, dice, observer, number),
          manager(timeline, network, dice, observer, server, outside, application, number, seed) {
        application.belongsTo(manager);
    }
    RobotApplication application;
    EntityManagerStation manager;
};

World::World(std::uint64_t seed, Faults faults)
    : seeds_(seed * 0x9E3779B97F4A7C15ULL + static_cast<std::uint64_t>(faults)),
      network_dice_(seeds_.next()),
      fault_dice_(seeds_.next()),
      outside_(timeline_, 0, "world"),
      observer_(timeline_, outside_),
      network_(timeline_, network_dice_),
      server_(timeline_, network_dice_, observer_, seeds_.next()) {
    outside_.start();
    const auto entities = 3 + fault_dice_.roll(2);
    const auto clients = 2 + fault_dice_.roll(2);
    const auto begin = timeline_.now();
    const bool drifts = faults == Faults::Drift || (faults == Faults::All && fault_dice_.chance(0.3));
    if (drifts) observer_.clocksDiffer(3 * kMostDrift);
    const auto setClock = [&](Process& process) {
        const double by =
            drifts ? (static_cast<double>(fault_dice_.roll(2001)) - 1000.0) / 1000.0 * kMostDrift : 0;
        process.setClock(fault_dice_.between(Duration{}, 100'000s), 1 + by);
    };
    setClock(server_.process());
    if (faults == Faults::Slow || faults == Faults::All) {
        server_.outbox_limits.window_bytes = 2048;
        server_.outbox_limits.control_messages = 24;
        server_.outbox_limits.data_messages = 1;
    }
    server_.start();
    for (std::size_t i = 0; i < entities; ++i) {
        auto& robot = *robots_.emplace_back(std::make_unique<Robot>(
            timeline_, network_, network_dice_, observer_, server_, outside_, i, seeds_.next()));
        setClock(robot.application.process());
        setClock(robot.manager.process());
        observer_.addEntity(robot.application.process().name(),
                            {&server_.process(), &robot.manager.process(), &robot.application.process(),
                             &robot.manager.serverPath()});
        robot.application.start();
        robot.manager.start();
    }
    for (std::size_t i = 0; i < clients; ++i) {
        auto& client = *clients_.emplace_back(
            std::make_unique<ClientStation>(timeline_, network_, observer_, server_, static_cast<int>(i),
                                            i == 0 ? Role::Admin : Role::Operator, seeds_.next()));
        setClock(client.process());
        // Some are where no Entity Manager can be reached, and stay relayed; who reads slowly then holds up
        // the server.
        const double relayed = faults == Faults::Slow ? 0.9 : i == 0 || faults == Faults::Direct ? 0 : 0.15;
        if (!fault_dice_.chance(relayed))
            for (const auto& robot : robots_)
                client.addRoad(robot->application.process().name(), robot->manager);
        users_.push_back(std::make_unique<User>(timeline_, client, seeds_.next(), begin + kRetire));
        users_.back()->complain = [this](const std::string& what) {
            observer_.violated(Invariant::Bounded, what);
        };
        client.start();
    }
    auto& late = *clients_.emplace_back(std::make_unique<ClientStation>(
        timeline_, network_, observer_, server_, static_cast<int>(clients), Role::Operator, seeds_.next()));
    setClock(late.process());
    for (const auto& robot : robots_) late.addRoad(robot->application.process().name(), robot->manager);
    visitor_ = std::make_unique<Visitor>(timeline_, late, entities);
    timeline_.at(begin + kVisit, outside_, [&late] { late.start(); });
    planFaults(faults);
}

World::~World() = default;

Outcome World::run(bool story) {
    timeline_.story = story;
    const auto end = timeline_.now() + kEnd;
    while (!observer_.violation() && timeline_.step(end)) {
        if (timeline_.events() > kMostEvents)
            observer_.violated(Invariant::Bounded, "more than " + std::to_string(kMostEvents) +
                                                       " events: somebody goes round in circles");
    }
    if (!observer_.violation()) judgeEnd();
    Outcome outcome;
    outcome.violation = observer_.violation();
    outcome.digest = timeline_.digest();
    outcome.events = timeline_.events();
    outcome.counts = observer_.counts();
    for (const auto& user : users_) outcome.counts.tickets += user->ticketsResumed();
    outcome.story.assign(timeline_.lines().begin(), timeline_.lines().end());
    return outcome;
}

void World::judgeEnd() {
    if (!visitor_->content()) observer_.violated(Invariant::ComesBack, visitor_->complaint());
    const auto bounded = [&](const std::string& what, std::size_t is, std::size_t should) {
        if (is != should)
            observer_.violated(Invariant::Bounded, what + ": " + std::to_string(is) +
                                                       " at the end, expected " + std::to_string(should));
    };
    bounded("clients of the server", server_.clients(), clients_.size());
    bounded("entities of the server", server_.entities(), robots_.size());
    for (std::size_t i = 0; i < users_.size(); ++i) {
        const auto& name = clients_[i]->process().name();
        bounded("requests of " + name + " that wait for an answer", clients_[i]->core()->pendingRequests(),
                0);
        bounded("stops of " + name + " that are open", clients_[i]->desk()->openOrders(), 0);
        bounded("questions of " + name + " that were never answered",
                static_cast<std::size_t>(users_[i]->open()), 0);
    }
    for (const auto& robot : robots_)
        bounded("tasks of " + robot->application.process().name(), robot->application.tasks(), 0);
    bounded("messages that the network holds back", network_.held(), 0);
    observer_.judgeMessages();
}

void World::planFaults(Faults faults) {
    observer_.nothingFails(faults == Faults::None || faults == Faults::Lies || faults == Faults::Direct);
    observer_.pathsStand(faults == Faults::None || faults == Faults::Lies);
    if (faults == Faults::None) return;
    const auto begin = timeline_.now();
    if (faults == Faults::Lies) {
        std::vector<DirectLiars::Robot> honest;
        for (const auto& robot : robots_)
            honest.push_back({robot->application.process().name(), &robot->manager});
        direct_liars_.emplace(timeline_, network_, outside_, server_, observer_, fault_dice_.roll(UINT64_MAX),
                              begin + kFaultsFrom, begin + kFaultsUntil, std::move(honest));
        for (const auto& client : clients_) client->addRoad(DirectLiars::kName, *direct_liars_, false);
        liars_.emplace(timeline_, outside_, server_, observer_, *direct_liars_, fault_dice_.roll(UINT64_MAX),
                       begin + kFaultsFrom, begin + kFaultsUntil);
        return;
    }
    direct_only_ = faults == Faults::Direct;
    const auto count = direct_only_            ? 10 + fault_dice_.roll(30)
                       : faults == Faults::All ? 2 + fault_dice_.roll(5)
                                               : 1 + fault_dice_.roll(4);
    for (std::uint64_t i = 0; i < count; ++i) {
        const auto at = begin + fault_dice_.between(kFaultsFrom, kFaultsUntil - 1s);
        auto kind = faults;
        if (faults == Faults::All) kind = static_cast<Faults>(1 + fault_dice_.roll(8));
        if (faults == Faults::Drift) kind = Faults::Pause;
        if (faults == Faults::Direct) {
            static constexpr std::array kKinds{Faults::Delay, Faults::Reorder, Faults::Loss, Faults::Loss,
                                               Faults::Partition};
            kind = kKinds[fault_dice_.roll(kKinds.size())];
        }
        timeline_.at(at, outside_, [this, kind, at] { injectOne(kind, at); });
    }
}

Duration World::anyLength(TimePoint from) {
    const auto kind = fault_dice_.roll(10);
    const auto length = kind < 5   ? fault_dice_.between(20ms, 450ms)
                        : kind < 8 ? fault_dice_.between(450ms, 3s)
                                   : fault_dice_.between(3s, 9s);
    const auto last = TimePoint{1000s} + kFaultsUntil;
    return std::max<Duration>(std::min<Duration>(length, last - from), 1ms);
}

Duration World::atMost(Duration time) const {
    return std::max<Duration>(std::min<Duration>(time, TimePoint{1000s} + kFaultsUntil - timeline_.now()),
                              1ms);
}

World::Victim World::anyVictim() {
    switch (fault_dice_.roll(8)) {
        case 0:
        case 1:
        case 2: {
            const auto number = fault_dice_.roll(users_.size());
            return {&clients_[number]->process(), 0, number};
        }
        case 3:
            return {&server_.process(), 1, 0};
        case 4:
        case 5:
        case 6: {
            const auto number = fault_dice_.roll(robots_.size());
            return {&robots_[number]->manager.process(), 2, number};
        }
        default: {
            const auto number = fault_dice_.roll(robots_.size());
            return {&robots_[number]->application.process(), 3, number};
        }
    }
}

Road& World::anyRoad() {
    std::vector<Road*> roads, open;
    for (std::size_t i = 0; i < users_.size(); ++i)
        for (auto& road : clients_[i]->roads()) {
            roads.push_back(&road);
            if (road.open > 0) open.push_back(&road);
        }
    const auto& from = open.empty() || fault_dice_.chance(0.1) ? roads : open;
    return *from[fault_dice_.roll(from.size())];
}

bool World::isRoad(const Path& path) const {
    return std::any_of(clients_.begin(), clients_.end(), [&](const auto& client) {
        return std::any_of(client->roads().begin(), client->roads().end(),
                           [&](const Road& road) { return &road.path == &path; });
    });
}

Path& World::anyPath() {
    if (direct_only_ || fault_dice_.chance(0.35)) return anyRoad().path;
    const auto which = fault_dice_.roll(users_.size() + robots_.size());
    return which < users_.size() ? clients_[which]->path()
                                 : robots_[which - users_.size()]->manager.serverPath();
}

std::string World::nameOf(const Path& path) const {
    for (const auto& client : clients_)
        if (&client->path() == &path) return client->process().name() + " <-> server";
    for (const auto& client : clients_)
        for (const auto& road : client->roads())
            if (&road.path == &path) return client->process().name() + " <-> " + road.to + ".em";
    for (const auto& robot : robots_) {
        if (&robot->manager.serverPath() == &path) return robot->manager.process().name() + " <-> server";
        if (&robot->manager.loopback() == &path) return robot->manager.process().name() + " <-> application";
    }
    return "?";
}

void World::injectOne(Faults kind, TimePoint at) {
    const auto length = anyLength(at);
    const auto ms = [](Duration time) {
        return std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(time).count()) + " ms";
    };
    switch (kind) {
        case Faults::Reorder:
            if (!direct_only_ && fault_dice_.chance(0.2)) return overtakenByItsSendersEnd(length);
            [[fallthrough]];
        case Faults::Delay: {
            auto& path = anyPath();
            const auto most = fault_dice_.between(5ms, kind == Faults::Delay ? 300ms : 150ms);
            if (!isRoad(path)) observer_.delayed(most);
            timeline_.tell("FAULT", [&] {
                return nameOf(path) + (kind == Faults::Delay ? ": up to " : ": one lane up to ") + ms(most) +
                       " slower for " + ms(length);
            });
            auto slow = path.connections;
            if (kind == Faults::Reorder)
                std::erase_if(slow, [this](Connection*) { return fault_dice_.chance(0.5); });
            for (auto* connection : slow) connection->extra = most;
            timeline_.after(length, outside_, [slow] {
                for (auto* connection : slow) connection->extra = {};
            });
            return;
        }
        case Faults::Loss: {
            if (fault_dice_.chance(0.5)) {
                auto& path = !direct_only_ && fault_dice_.chance(0.2)
                                 ? robots_[fault_dice_.roll(robots_.size())]->manager.loopback()
                                 : anyPath();
                timeline_.tell("FAULT", [&] { return nameOf(path) + ": connections break"; });
                const bool all = fault_dice_.chance(0.6);
                for (auto* connection : path.connections)
                    if (all || fault_dice_.chance(0.5)) connection->breakDown();
                return;
            }
            [[fallthrough]];
        }
        case Faults::Partition: {
            auto& path = anyPath();
            const auto direction = kind == Faults::Partition ? fault_dice_.roll(3) : 2;
            if (path.cut[0] || path.cut[1]) return;
            timeline_.tell("FAULT", [&] {
                return nameOf(path) + ": cut silently for " + ms(length) +
                       (direction == 0   ? ", up"
                        : direction == 1 ? ", down"
                                         : "");
            });
            network_.cut(path, direction != 1, direction != 0);
            observer_.faultBegins();
            timeline_.after(length, outside_, [this, &path] {
                timeline_.tell("FAULT", [&] { return nameOf(path) + ": whole again"; });
                network_.mend(path);
            });
            return;
        }
        case Faults::Duplication: {
            const auto number = fault_dice_.roll(robots_.size());
            auto& manager = robots_[number]->manager;
            auto& mischief = manager.mischief();
            mischief.repeats = 0.3;
            // What is repeated may belong to a life that is over.
            if (fault_dice_.chance(0.4))
                timeline_.after(length / 2, outside_, [this, victim = Victim{&manager.process(), 2, number}] {
                    crash(victim, true, 200ms);
                });
            mischief.repeats_within = fault_dice_.chance(0.5) ? 20ms : 3s;
            timeline_.tell("FAULT", [&] { return "messages arrive twice for " + ms(length * 3); });
            timeline_.after(std::min<Duration>(length * 3, TimePoint{1000s} + kFaultsUntil - at), outside_,
                            [&mischief] { mischief.repeats = 0; });
            return;
        }
        case Faults::Crash:
            atSomeMoment([this, victim = anyVictim(), notice = fault_dice_.chance(0.7), length] {
                crash(victim, notice, length);
            });
            return;
        case Faults::Pause:
            atSomeMoment([this, victim = anyVictim(), length] { freeze(victim, length); });
            return;
        case Faults::Slow: {
            // Preferably one that the server feeds, whose outbox is small.
            auto number = fault_dice_.roll(users_.size());
            for (int i = 0; i < 4 && !clients_[number]->roads().empty(); ++i)
                number = fault_dice_.roll(users_.size());
            auto& client = *clients_[number];
            const auto each = fault_dice_.between(50ms, 400ms);
            timeline_.tell("FAULT", [&] {
                return client.process().name() + " reads a message each " + ms(each) + " for " +
                       ms(length * 3);
            });
            client.readSlowly(each);
            timeline_.after(atMost(length * 3), outside_, [&client] { client.readSlowly({}); });
            return;
        }
        case Faults::None:
        case Faults::Drift:
        case Faults::Direct:
        case Faults::Lies:
        case Faults::All:
            return;
    }
}

void World::overtakenByItsSendersEnd(Duration length) {
    const auto number = fault_dice_.roll(users_.size());
    users_[number]->ambush = [this, number, length] {
        const Victim victim{&clients_[number]->process(), 0, number};
        timeline_.tell("FAULT", [&] {
            return victim.process->name() + " dies, and the news of it overtakes what it has asked for";
        });
        std::vector<Connection*> slow;
        for (const auto& robot : robots_)
            for (auto* connection : robot->manager.serverPath().connections)
                if (fault_dice_.chance(0.5)) slow.push_back(connection);
        for (auto* connection : slow) connection->extra = fault_dice_.between(50ms, 150ms);
        timeline_.after(length, outside_, [slow] {
            for (auto* connection : slow) connection->extra = {};
        });
        const auto until = TimePoint{1000s} + kFaultsUntil - 500ms;
        timeline_.after(fault_dice_.between(0ms, 3ms), outside_, [this, victim, length, until] {
            if (timeline_.now() < until) crash(victim, true, length);
        });
    };
}

void World::atSomeMoment(std::function<void()> strike) {
    if (fault_dice_.chance(0.5)) return strike();
    const auto until = TimePoint{1000s} + kFaultsUntil - 500ms;
    users_[fault_dice_.roll(users_.size())]->ambush = [this, strike = std::move(strike), until] {
        timeline_.after(fault_dice_.between(0ms, 3ms), outside_, [this, strike, until] {
            if (timeline_.now() < until) strike();
        });
    };
}

void World::frozenChanged(const Victim& victim) {
    if (victim.kind == 2) robots_[victim.number]->application.managerFrozen();
    if (victim.kind == 3) robots_[victim.number]->manager.applicationFrozen();
}

void World::freeze(const Victim& victim, Duration time) {
    auto& process = *victim.process;
    if (!process.running()) return;
    timeline_.tell("FAULT",
                   [&] { return process.name() + " is frozen for " + std::to_string(time / 1ms) + " ms"; });
    process.freeze();
    frozenChanged(victim);
    observer_.faultBegins();
    timeline_.after(atMost(time), outside_, [this, victim, life = process.life()] {
        if (victim.process->life() != life) return;
        timeline_.tell("FAULT", [&] { return victim.process->name() + " goes on"; });
        victim.process->thaw();
        frozenChanged(victim);
    });
}

void World::crash(const Victim& victim, bool notice, Duration time) {
    if (!victim.process->alive()) return;
    timeline_.tell("FAULT", [&] {
        return victim.process->name() + (notice ? " is killed for " : " loses power for ") +
               std::to_string(time / 1ms) + " ms";
    });
    const auto kill = [&](Process& process, auto& station, bool with_notice) {
        if (!process.alive()) return;
        network_.died(process, with_notice);
        station.kill();
        timeline_.after(atMost(time), outside_, [this, &process, &station] {
            timeline_.tell("FAULT", [&] { return process.name() + " starts again"; });
            station.start();
            network_.restarted(process);
        });
    };
    switch (victim.kind) {
        case 0:
            kill(*victim.process, *clients_[victim.number], notice);
            break;
        case 1:
            kill(*victim.process, server_, notice);
            break;
        default: {
            auto& robot = *robots_[victim.number];
            if (!notice || victim.kind == 2) kill(robot.manager.process(), robot.manager, notice);
            if (!notice || victim.kind == 3) kill(robot.application.process(), robot.application, notice);
        }
    }
    observer_.faultBegins();
}

}  // namespace axon::simulation
