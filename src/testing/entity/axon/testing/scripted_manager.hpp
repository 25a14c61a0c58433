// SPDX-License-Identifier: MIT
#pragma once
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "axon/entity_interfacer.hpp"
#include "axon/testing/failure.hpp"
#include "axon/testing/manual_clock.hpp"

/// Tests of robot applications without servers. A test constructs the application, which uses
/// axon::EntityInterfacer as always, and a ScriptedManager, which does what the test says: it starts
/// services, stops them, falls silent. Nothing here needs Ice, and the library is MIT.
namespace axon::testing {

/// What an application is, as its profiles say.
struct Registration {
    std::string name, category, type, descr;
    std::vector<std::string> services;
};

/// An application's answer to a request.
struct Answer {
    bool granted = false;
    std::string code;    ///< of a denial: "DENIED", "ROBOT_LOST", … (docs/reference/refusals.md)
    std::string reason;  ///< of a denial: what the application has said to the client
};

/// How a task has ended.
struct Ending {
    std::string state;                                  ///< "SUCCEEDED", "FAILED", "STOPPED" or "CANCELLED"
    std::string reason;                                 ///< as the application gave it; may be empty
    std::map<std::string, std::vector<Value>> results;  ///< all that were reported, the newest values
};

/// A stop callback that has returned.
struct StopDone {
    std::uint32_t generation = 0;
    bool standstill_follows = false;  ///< the application will report that its robot stands still
};

/// How the application has ended the link.
struct LinkEnding {
    std::string reason;
    bool stopped = false;  ///< it said that its stop callback has returned
};

/// A sample of a stream. Those that are no numbers are in `bytes` only.
struct StreamSample {
    std::uint64_t sequence = 0;
    std::vector<double> numbers;  ///< of a value, of several, or x, y, z, roll, pitch, yaw of a pose
    std::string units, bytes;
};

/// One execution of a service that a ScriptedManager has asked for.
///
/// Each expect…() waits for the next thing of its kind and returns it; things of other kinds may come
/// before it. It throws Failure if the task ends without it. Copies refer to the same task.
class AXON_TESTING_API ScriptedTask {
  public:
    const std::string& id() const;  ///< UUID text, as Task::id() of the application
    const std::string& service() const;

    /// The application has let it begin.
    void expectGranted();
    /// The application has refused it.
    Answer expectDenied();
    /// A text that contains this one.
    std::string expectFeedback(std::string_view containing = "");
    /// Progress of at least this much, 0 to 1.
    double expectProgress(double at_least = 0);
    /// The next report of this OUTPUT or FEEDBACK parameter.
    std::vector<Value> expectResult(std::string_view name);
    // The end. Any other end than the expected one is a Failure that says which, and why.
    Ending expectSucceeded();
    Ending expectFailed();
    Ending expectStopped();
    Ending expectCancelled();

    // These only ask, and wait for nothing.
    void pause();
    void resume();
    void cancel();

  private:
    friend class ScriptedManager;
    struct Shared;
    explicit ScriptedTask(std::shared_ptr<Shared> shared) : shared_(std::move(shared)) {}
    Ending expectEnd(const char* state);
    std::shared_ptr<Shared> shared_;
};

/// The Entity Manager of a robot application, as a test wants it.
///
/// Where in the flow: in the place of axon-entity-manager. It connects to the application over the same TCP
/// link, in the test's process or in another one, and says what an Entity Manager says
/// (docs/reference/ei-link.md). It checks requests against the profiles as an Entity Manager does, and throws
/// Failure (Refused) for what would not get as far as the application. It keeps no leases, queues no tasks,
/// and forwards nothing.
///
/// States: made → linked (connect()) ⇄ not linked (disconnect(), or the application ended the link).
///
/// Time: an expectation waits for at most Options::patience. With a clock it is patience of that clock, which
/// runs while the expectation waits; without one, of this machine.
///
/// Threads: one of its own for the link; everything else belongs to one thread of the test. Ownership: tasks
/// may outlive it, and then throw Failure (LinkLost). The destructor closes the link, for which the
/// application stops its robot.
class AXON_TESTING_API ScriptedManager {
  public:
    struct Options {
        std::string application{};  ///< EntityInterfacer::Options::application; required
        std::string instance{};     ///< empty = any
        /// Where the application listens: EntityInterfacer::port(). 0 = look for it in the range, as an
        /// Entity Manager does, for an application in a process of its own.
        std::uint16_t port = 0;
        std::uint16_t first_port = 5500, last_port = 8000;
        std::string address = "127.0.0.1";
        std::chrono::milliseconds patience{10000};
        /// After this much silence the application takes its Entity Manager for lost, 20 ms to 10 s. Make it
        /// short for a test of silence() without a clock.
        std::chrono::milliseconds watchdog{10000};
        /// The clock that the application was given, if it was given one.
        std::optional<ManualClock> clock{};
    };

    /// Throws Failure (Misuse) for options that cannot work.
    explicit ScriptedManager(Options options);
    ~ScriptedManager();
    ScriptedManager(const ScriptedManager&) = delete;
    ScriptedManager& operator=(const ScriptedManager&) = delete;

    /// Links with the application, waits for both profiles, and tells the CONFIG values in them. Throws
    /// Failure if there is no such application, it refuses the link, or a profile has errors, which are named
    /// with their lines.
    Registration connect();
    /// Closes the link without a word, as an Entity Manager that has died.
    void disconnect();
    /// Keeps the connections open and says nothing more, as an Entity Manager that hangs.
    void silence();
    bool linked() const;

    /// Asks for a service: parameters by name, and a parameter that is missing has the value of the profile,
    /// or the one that setParameter() has set. An integer is accepted for a DBL parameter.
    ScriptedTask run(std::string_view service, const std::vector<Parameter>& parameters = {});
    /// Sets a parameter outside a task. A granted CONFIG value is then told as configuration.
    Answer setParameter(std::string_view service, const Parameter& parameter);
    /// Offers a file as an uploaded resource. If it is granted, later tasks have it.
    Answer upload(std::string_view service, std::string_view resource, const std::filesystem::path& file);
    void sendText(std::string_view text, std::string_view from = "test");
    void sendRaw(const std::vector<std::string>& blocks, std::string_view from = "test");
    /// Somebody subscribes to the stream, or nobody does any longer. All streams are wanted until the first
    /// call; from then on those for which it was called.
    void wantStream(std::string_view stream, bool wanted);

    /// Orders a stop and waits until the stop callback has returned. A callback that throws is a Failure.
    StopDone stop(StopSignal::Cause cause = StopSignal::Cause::Requested);
    /// The application reports that its robot stands still, after the newest stop.
    void expectStandstill();

    // What the application reports by itself: the next one of its kind.
    std::string expectText(std::string_view containing = "");
    std::vector<std::string> expectRaw();
    StreamSample expectSample(std::string_view stream);
    std::vector<double> expectPosition();  ///< x, y, z in millimetres
    /// The service is switched off; returns why.
    std::string expectInactive(std::string_view service);
    void expectActive(std::string_view service);
    /// The application ends the link.
    LinkEnding expectLinkEnded();

    class Desk;

  private:
    std::shared_ptr<Desk> desk_;
};

}  // namespace axon::testing
