// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "axon/client.hpp"
#include "axon/testing/failure.hpp"
#include "axon/testing/script.hpp"

/// Tests of programs that use robots, without robots. A test makes a Laboratory with scripted entities in its
/// own process; the program under test uses axon::client::Client as always and connects to
/// Laboratory::server().
namespace axon::testing {

class Actor;
class Stage;

/// A robot that does what its scripts say. Copies refer to the same entity.
///
/// Every service that has no script succeeds at once. Threads: any may call; a script that is a function is
/// called on a thread of the laboratory, and must not call the laboratory or its entities.
class ScriptedEntity {
  public:
    const std::string& name() const;

    // What it does from now on. UNKNOWN_SERVICE and the like are the Entity Manager's business: the name of a
    // service that the profile does not have is Failure (Misuse).
    void on(std::string_view service, Script script);
    void on(std::string_view service, std::function<Script(const Request&)> script);
    /// The robot application denies values of this parameter, on their own or with a task.
    void denyParameter(std::string_view service, std::string_view parameter, std::string reason);
    /// After each stop it reports that it stands still, this much later. Without this call it does not report
    /// that.
    void reportStandstill(client::Seconds after);
    /// Its stop callback does not return until it is told to: receipts of a stop stay open.
    void confirmStops(bool confirm);

    // What it does now.
    void setServiceActive(std::string_view service, bool active, std::string reason = {});
    void setPosition(double x_mm, double y_mm, double z_mm);
    void sendText(std::string text);
    void sendRaw(std::string bytes);
    void sendSample(std::string stream, std::vector<double> numbers, std::string units = {});
    /// The link to its robot application is lost: the robot is stopped and latched, and the entity is UNAV
    /// until the application is back.
    void loseApplication(std::string reason = "the application has crashed");
    void restoreApplication();
    /// It leaves the laboratory in order, or is lost without a word, as when its machine is switched off.
    void leave();
    void lose();
    /// It is there again, after leave() or lose(). Waits as Laboratory::add() does.
    void join();

    // What it was asked for. Each call returns the next one of its kind, waits for it at most for
    // Laboratory::Options::patience of real time, and throws Failure if it does not come.
    Request expectTask(std::string_view service = "");  ///< empty = of any service
    std::string expectStop();  ///< its cause: "REQUESTED", "CLIENT_LOST", … (docs/reference/messages.md)
    std::string expectText();
    std::string expectRaw();
    /// What was uploaded last as this resource. Throws Failure if nothing was.
    std::string uploaded(std::string_view service, std::string_view resource) const;

  private:
    friend class Laboratory;
    explicit ScriptedEntity(std::shared_ptr<Actor> actor) : actor_(std::move(actor)) {}
    std::shared_ptr<Actor> actor_;
};

/// How the time of a laboratory passes.
enum class Passing : std::uint8_t {
    InAdvance,  ///< only in Laboratory::advance()
    AtOnce      ///< as soon as a script waits for it: no script takes any real time
};

/// A laboratory in the process of a test: the servers and Entity Managers of Axon themselves, with scripted
/// robots in place of robot applications. Leases, queues, refusals, stops, latches and grace are therefore
/// what they are in a real laboratory.
///
/// Where in the flow: everything behind the client. It listens on ports of the loopback address that are
/// free, so tests can run side by side.
///
/// Time: what scripts wait for is time of the laboratory, which the test lets pass. The times of Axon itself
/// are real ones: time-outs of the client, watchdogs, grace, and `not_after` of a task. Watchdogs are longer
/// than in a real laboratory, because a test may run on a busy machine.
///
/// Threads: any may call, one at a time; several threads of its own. Ownership: clients must be destroyed
/// before it; entities may outlive it and then do nothing. Failure: the constructor throws Failure (Misuse)
/// if no server can be started.
class Laboratory {
  public:
    struct Options {
        Passing passing = Passing::InAdvance;
        std::chrono::milliseconds patience{10000};  ///< real time for which an expectation waits
        /// If false, what servers and Entity Managers log is dropped; otherwise it goes to the default logger
        /// of spdlog.
        bool log = false;
    };

    Laboratory();
    explicit Laboratory(Options options);
    ~Laboratory();
    Laboratory(const Laboratory&) = delete;
    Laboratory& operator=(const Laboratory&) = delete;

    /// HOST:PORT for axon::client::Options::server.
    const std::string& server() const;
    /// Default options of a client, for this server.
    client::Options clientOptions() const;

    /// Adds an entity with the profiles of a real one, and waits until the server has it. A client that
    /// connects later knows it at once; one that is connected already hears of it soon (Client::waitFor).
    /// Throws Failure (Misuse) for a profile with errors, which are named with their lines.
    ScriptedEntity add(const std::filesystem::path& basic_profile,
                       const std::filesystem::path& services_profile);
    /// Adds an entity that is described here. Of a service the profile's part counts: name, global id,
    /// description, blocking, pausable, parameters and resources. A parameter with values has them from the
    /// beginning.
    ScriptedEntity add(std::string_view name, const std::vector<client::Service>& services,
                       std::string_view category = "ROBOT", std::string_view type = "MOBILE");

    /// Lets time pass: what scripts have to do until then happens, in the order of its times. When it
    /// returns, it has left for the clients.
    void advance(client::Seconds time);
    client::Seconds elapsed() const;

  private:
    std::shared_ptr<Stage> stage_;
};

}  // namespace axon::testing
