// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "simulation/client_station.hpp"
#include "simulation/direct_liars.hpp"
#include "simulation/entity_manager_station.hpp"
#include "simulation/liars.hpp"
#include "simulation/robot_application.hpp"
#include "simulation/server_station.hpp"
#include "simulation/user.hpp"

namespace axon::simulation {

/// Which faults a run has.
enum class Faults : std::uint8_t {
    None,
    Delay,
    Loss,
    Duplication,
    Reorder,
    Partition,
    Crash,
    Pause,
    Slow,
    Drift,
    Direct,
    Lies,
    All
};
inline constexpr std::size_t kFaults = 13;
const char* toString(Faults faults);
const char* describe(Faults faults);
std::optional<Faults> faultsOf(std::string_view name);

/// What a run has come to.
struct Outcome {
    std::optional<Violation> violation;
    std::uint64_t digest = 0;
    std::uint64_t events = 0;
    Counts counts;
    std::vector<std::string> story;  ///< where it was asked for
};

/// One seed: a laboratory of two or three clients, three or four entities and a server, for sixty seconds of
/// virtual time, with faults during the first thirty-six. From the same seed and faults it is the same to the
/// last event.
class World {
  public:
    World(std::uint64_t seed, Faults faults);
    ~World();
    Outcome run(bool story = false);

  private:
    struct Robot;
    struct Victim {
        Process* process;
        std::size_t kind;  ///< 0 client, 1 server, 2 Entity Manager, 3 application
        std::size_t number;
    };
    void planFaults(Faults faults);
    void injectOne(Faults kind, TimePoint at);
    /// When a client asks for something next, it dies, and the server's word of that arrives at the Entity
    /// Managers before what it has asked for.
    void overtakenByItsSendersEnd(Duration length);
    /// Now, or some moments after a user has asked for something.
    void atSomeMoment(std::function<void()> strike);
    void freeze(const Victim& victim, Duration time);
    void crash(const Victim& victim, bool notice, Duration time);
    void frozenChanged(const Victim& victim);
    Victim anyVictim();
    Path& anyPath();
    /// Of a client and an Entity Manager; preferably one with a direct path.
    Road& anyRoad();
    bool isRoad(const Path& path) const;
    Duration anyLength(TimePoint from);
    Duration atMost(Duration time) const;
    void judgeEnd();
    std::string nameOf(const Path& path) const;

    SeededRandom seeds_;
    Timeline timeline_;
    Dice network_dice_, fault_dice_;
    Process outside_;
    Observer observer_;
    Network network_;
    ServerStation server_;
    std::vector<std::unique_ptr<Robot>> robots_;
    std::vector<std::unique_ptr<ClientStation>> clients_;
    std::vector<std::unique_ptr<User>> users_;
    std::unique_ptr<Visitor> visitor_;
    std::optional<DirectLiars> direct_liars_;
    std::optional<Liars> liars_;
    bool direct_only_ = false;  ///< faults of direct paths
};

}  // namespace axon::simulation
