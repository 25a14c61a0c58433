// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <map>
#include <memory>
#include <string>

#include "common/routed.hpp"
#include "entity_interfacer/stop_level.hpp"
#include "simulation/network.hpp"
#include "simulation/observer.hpp"

namespace axon::proto {
class EiToEm;
class EmToEi;
}  // namespace axon::proto

namespace axon::simulation {

class EntityManagerStation;

/// A robot application behind an Entity Interfacer, by the rules of docs/reference/ei-link.md: the Entity
/// Interfacer's own StopLevel, and a model of its threads. Its handlers "move" until they are through,
/// stopped or cancelled.
///
/// Beats are not sent one by one. As long as the Entity Manager's process runs and the link stands it is
/// heard; once it is frozen the silence is counted from its last beat.
class RobotApplication {
  public:
    RobotApplication(Timeline& timeline, Network& network, Dice& dice, Observer& observer,
                     std::size_t entity);
    ~RobotApplication();

    Process& process() { return process_; }
    void belongsTo(EntityManagerStation& manager) { manager_ = &manager; }
    void start();
    void kill();
    /// The Entity Manager's process has been frozen or goes on.
    void managerFrozen();

    // From the Entity Manager, as this process.
    void hello(std::uint64_t attempt, Connection& signal, Connection& data);
    void onStop(std::uint64_t link, std::uint32_t generation, StopCause cause);
    void onBeat(std::uint64_t link, std::uint32_t generation, bool busy);
    void onData(std::uint64_t link, const std::string& bytes);

    std::size_t tasks() const;

  private:
    struct Running;
    struct Life;
    struct Link;
    void readSignals();
    void stopCallback(std::uint32_t generation, StopCause cause, bool acknowledge);
    void acknowledge(std::uint32_t generation);
    void dispatchStop(StopCause cause);
    void cut(const char* why);
    void onTask(const proto::EmToEi& message);
    void begin(const std::string& id);
    void endStopped();
    void finish(const std::string& id);
    void chat(const std::string& id, Duration period);
    void judgeSilence();
    void showMotion();
    bool stopRequested(const Running& task) const;
    void answer(const Running& task, int code, const char* message);
    void report(const Running& task, int state, double progress);
    void sendData(const proto::EiToEm& message);

    Timeline& timeline_;
    Network& network_;
    Dice& dice_;
    Observer& observer_;
    const std::size_t entity_;
    Process process_;
    EntityManagerStation* manager_ = nullptr;
    std::uint64_t links_ = 0;
    std::unique_ptr<Life> life_;
};

}  // namespace axon::simulation
