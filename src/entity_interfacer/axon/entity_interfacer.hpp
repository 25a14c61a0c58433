// SPDX-License-Identifier: MIT
#pragma once
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#ifndef AXON_EI_API
#define AXON_EI_API __attribute__((visibility("default")))
#endif

/// The Entity Interfacer: what a robot application links in order to appear in an Axon environment. This
/// header is all of it; it needs the C++ standard library and nothing else. axon/device_guard.hpp adds a
/// process that stops the robot when the application freezes or dies. docs/reference/ei-link.md describes
/// what goes over the wire, for those who write an interfacer in another language.
namespace axon {

/// Something that must be mended before the application can run: a profile that cannot be read, a port
/// outside 5500 to 8000, an empty name. what() says where, what was expected and how to mend it. Thrown by
/// the constructor, upload…Profile() and start() only, never while running.
class AXON_EI_API Misconfiguration : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

/// One value of a parameter.
using Value = std::variant<std::int64_t, double, std::string, bool>;

/// A parameter as the client gave it. More than one value only where the profile says "multiple".
/// The typed readers throw std::invalid_argument when there is no value of that type; number() also reads
/// integers.
struct AXON_EI_API Parameter {
    std::string name;
    std::vector<Value> values;
    std::string units;  ///< of the profile, where the client named none

    double number() const;
    std::int64_t integer() const;
    const std::string& text() const;
    bool flag() const;
};

/// The application's answer to a request. The reason of a denial reaches the client, so write it for a
/// person.
class AXON_EI_API Decision {
  public:
    static Decision grant() { return Decision(Verdict::Granted, {}); }
    static Decision deny(std::string reason) { return Decision(Verdict::Denied, std::move(reason)); }
    /// Not now: the robot itself does not answer. The client is told ROBOT_LOST instead of DENIED.
    static Decision robotLost(std::string reason) { return Decision(Verdict::RobotLost, std::move(reason)); }
    bool granted() const { return verdict_ == Verdict::Granted; }
    bool isRobotLost() const { return verdict_ == Verdict::RobotLost; }
    const std::string& reason() const { return reason_; }

  private:
    enum class Verdict : int { Granted, Denied, RobotLost };
    Decision(Verdict verdict, std::string reason) : verdict_(verdict), reason_(std::move(reason)) {}
    Verdict verdict_;
    std::string reason_;
};

/// "Stop all motion now." Make effective use of it: this is a control-system stop, and what it does to the
/// machine is up to the application.
struct AXON_EI_API StopSignal {
    /// The same numbers as axon.proto.StopCause.
    enum class Cause : int {
        Unspecified = 0,
        Requested = 1,   ///< somebody said stop
        ClientLost = 2,  ///< the controlling client is gone or silent
        Released = 3,
        Improper = 4,  ///< the client was dropped for its behaviour
        ServerLost = 5,
        LinkLost = 6,  ///< the Entity Manager is gone or silent; dispatched by this library itself
        Reset = 7,     ///< this task only, the next of the queue follows
        Clear = 8,
        Cancel = 9,     ///< this task only; seen by the task, not by onStop()
        Shutdown = 10,  ///< this interfacer is being shut down or destroyed
        Fault = 11,     ///< an exception left a callback of the application
    };
    Cause cause = Cause::Unspecified;
    std::uint32_t generation = 0;  ///< rises with every stop that comes through the Entity Manager
};
AXON_EI_API const char* toString(StopSignal::Cause cause);

// What streams carry. Times are taken by the library when send() is called.
struct Pose {  ///< metres and radians, in the entity's own map frame unless `frame` says otherwise
    double x = 0, y = 0, z = 0, roll = 0, pitch = 0, yaw = 0;
    std::string frame;
};
struct Scan {  ///< metres; beam i looks towards start_angle + i * step, or towards angles[i] when given
    double start_angle = 0, step = 0, max_range = 0;
    std::vector<float> ranges, angles;
};
struct Image {
    std::uint32_t width = 0, height = 0;
    std::string encoding;  ///< "rgb8", "mono8", "jpeg", …
    std::string pixels;    ///< bytes; a whole sample is at most 1 MiB
};

class Clock;
class Communicator;

/// A named stream of samples to whoever watches. Cheap to copy; valid as long as its EntityInterfacer lives.
/// Threads: any. Never blocks: while nobody is linked or wants it, or the link is slower than the sender,
/// samples are dropped, oldest first; watchers see the gap in the sequence number.
class AXON_EI_API Stream {
  public:
    void send(double value, std::string_view units = {});
    void send(const std::vector<double>& values, std::string_view units = {});
    void send(const Pose& pose);
    void send(const Scan& scan);
    void send(const Image& image);
    void sendBytes(std::string_view bytes);
    /// False while the Entity Manager knows that nobody watches: the sample need not even be made.
    bool wanted() const;

    struct Channel;

  private:
    friend class EntityInterfacer;
    explicit Stream(std::shared_ptr<Channel> channel) : channel_(std::move(channel)) {}
    std::shared_ptr<Channel> channel_;
};

/// One requested execution of a service, in the hands of its handler. Copies refer to the same task.
///
/// States: running, paused (the client paused it), stop requested, decided (a verdict was given), ended (the
/// handler has returned). The client is told of a verdict when the handler has returned: whatever the handler
/// gives back on its return, such as the drive, is free for the task that the client begins then. After a
/// stop, or the loss of the link, the client is told of the end at once, and a handler of another service may
/// begin before this one has returned: a device that several services use needs a lock. A handler may block;
/// it should return soon after stopRequested() becomes true, and use waitFor() instead of sleeping. One that
/// passes the task on to another thread waits for that thread, for its return is the end. A stop is
/// acknowledged whether or not the handler returns. Threads: every member may be called from any thread; what
/// is said after the verdict or the end is ignored.
class AXON_EI_API Task {
  public:
    const std::string& id() const;  ///< UUID text
    const std::string& service() const;

    // Parameters. A CONFIG parameter that is set while the task runs has its new value from then on: a
    // handler that reads it in each round of its loop follows it. All others stay as they were when the task
    // began.
    bool has(std::string_view parameter) const;
    // Values. Without fallback, a missing parameter or one of another type throws std::invalid_argument,
    // which fails the task when it is not caught.
    double number(std::string_view parameter) const;
    double number(std::string_view parameter, double fallback) const;
    std::int64_t integer(std::string_view parameter) const;
    std::int64_t integer(std::string_view parameter, std::int64_t fallback) const;
    std::string text(std::string_view parameter) const;
    std::string text(std::string_view parameter, std::string_view fallback) const;
    bool flag(std::string_view parameter) const;
    bool flag(std::string_view parameter, bool fallback) const;
    // All values of a "multiple" parameter; empty when it is not there.
    std::vector<double> numbers(std::string_view parameter) const;
    std::vector<std::int64_t> integers(std::string_view parameter) const;
    std::vector<std::string> texts(std::string_view parameter) const;
    std::vector<bool> flags(std::string_view parameter) const;
    std::string units(std::string_view parameter) const;
    const std::vector<Parameter>& parameters() const;  ///< as they were when the task began
    /// Where the resource (a file) lies on this machine; empty when it was not given.
    std::filesystem::path resource(std::string_view name) const;

    void progress(double part);  ///< 0 to 1
    void feedback(std::string_view text);
    /// An OUTPUT or FEEDBACK parameter; sent with the next report, at the latest with the verdict.
    void result(std::string_view name, Value value, std::string_view units = {});
    void result(std::string_view name, std::vector<Value> values, std::string_view units = {});

    bool stopRequested() const;  ///< a stop, a cancel, or the link is gone
    StopSignal::Cause stopCause() const;
    bool paused() const;
    /// Waits while the client has paused the task. False when a stop is requested.
    bool waitWhilePaused() const;
    /// Instead of sleeping: true when the time is up, false at once when a stop is requested.
    bool waitFor(std::chrono::duration<double> time) const;

    // The verdict; the first one counts, and travels when the handler returns. A handler that returns without
    // one has succeeded, unless a stop was requested: then the task was stopped (or cancelled). An exception
    // that leaves the handler fails the task even after succeed().
    void succeed();
    void fail(std::string_view reason);
    /// Failed because the robot itself does not answer (any more): the client is told ROBOT_LOST.
    void robotLost(std::string_view reason);

    class Running;
    explicit Task(std::shared_ptr<Running> running) : running_(std::move(running)) {}

  private:
    std::shared_ptr<Running> running_;
};

enum class LogLevel { Info, Warning, Error };

/// The robot application's end of the link to its Entity Manager (thesis 3.3.2).
///
/// Where in the flow: the last station. It listens on the first free port of its range and the Entity Manager
/// that is configured with the same application name connects. Set the callbacks, upload both profiles, then
/// run() or start().
///
/// States: made → started (listening) ⇄ linked → shut down (final).
///
/// Threads, all of the library's own: the *stop thread* runs onStop and nothing else, whatever any other
/// callback is doing; each task handler has a thread to itself; all other callbacks run one after the other
/// on the data thread. Every member function may be called from any thread, callbacks included (shutdown()
/// and the destructor not from a callback: there they only end run()). Callbacks and handlers are set before
/// start().
///
/// Ownership: the destructor dispatches a stop (Shutdown), then waits until every handler has returned; what
/// the callbacks refer to must live until then.
///
/// Failure: link loss, a dead or silent Entity Manager, an exception that leaves a callback, and destruction
/// all dispatch onStop. An exception that leaves a task handler fails that task as well. One that leaves any
/// callback but onStop also ends the link, which comes up again at once; none ends the process.
class AXON_EI_API EntityInterfacer {
  public:
    struct Options {
        std::string application{};  ///< the name the Entity Manager is configured with; required
        std::string instance{};     ///< tells equal applications on one host apart; empty = none
        std::filesystem::path
            ports_file;  ///< a ports.cfg; when given, it replaces first_port, last_port, address, users
        std::uint16_t first_port = 5500;  ///< the range is within 5500 to 8000, both included
        std::uint16_t last_port = 8000;
        std::string address = "127.0.0.1";  ///< IPv4 address to listen on
        std::string users{};  ///< of this machine, besides this one and root, whose Entity Manager is let in:
                              ///< "axon 1001"
        bool beyond_loopback = false;  ///< the link has no authentication: only for networks you trust
        bool watch_profiles = true;    ///< upload the profiles again when their files change
        /// Below these folders a resource's url may be an absolute path; a relative one begins in the folder
        /// of the services profile. The Entity Manager reads and replaces files there, and nowhere else but
        /// in its own.
        std::vector<std::filesystem::path> resource_folders{};
        /// It calls standstill() after every stop of a moving robot, so whoever stops it may wait for that.
        /// Known by itself from the first call of standstill() on.
        bool reports_standstill = false;
        std::function<void(LogLevel, const std::string&)> logger{};  ///< any thread; none = standard error
        /// What beats, watchdogs and waiting tasks count by (axon's common/clock.hpp); none = the time of
        /// this machine, or in trials that of the virtual laboratory whose file the variable AXON_CLOCK
        /// names.
        std::shared_ptr<const Clock> clock{};
    };
    using TaskHandler = std::function<void(Task&)>;

    explicit EntityInterfacer(Options options);
    ~EntityInterfacer();
    EntityInterfacer(const EntityInterfacer&) = delete;
    EntityInterfacer& operator=(const EntityInterfacer&) = delete;

    // Profiles (XML files, at most 1 MiB). Kept, and sent whenever an Entity Manager links.
    void uploadBasicProfile(const std::filesystem::path& file);
    void uploadServiceProfile(const std::filesystem::path& file);

    // Requests of the client. Without a callback the first two are granted; a task is granted when its
    // service has a handler.
    /// Asked for every value that a client gives, whether it sets it by itself or gives it with a task: then
    /// before onTaskRequest, and a denial refuses the task. Of a composite service, all that was given is
    /// asked for before the first part begins; `service` is the one whose profile declares the parameter.
    void onParameter(std::function<Decision(const std::string& service, const Parameter&)> callback);
    /// A CONFIG parameter has this value. All that have one are told when an Entity Manager has linked and
    /// read the profiles, before the first task: the profile's value, or what was set before, in an earlier
    /// life of this program perhaps. From then on each one is told when it has been set (and granted, see
    /// onParameter), whether or not a task runs. A stop does not keep it back: it must not move the machine.
    /// A value that has not changed may be told again.
    ///
    /// Throw when the value cannot be used; the exception's what() should say why, for a person who reads it.
    /// Before the first task or raw data of a link, the service that declares the parameter is then off, with
    /// that reason and whatever setServiceActive() says, until this callback takes a value of the parameter.
    /// Later a throw is a fault as in every callback (a stop, and the end of the link); the next link tells
    /// the value again, and the service is off. Deny in onParameter what can be denied there: its client is
    /// told at once. It is not asked about values that were granted in an earlier life of this program.
    void onConfig(std::function<void(const std::string& service, const Parameter&)> callback);
    /// The file that a client has uploaded, to be looked at: it replaces what was there before only when it
    /// is granted, and then lies somewhere else, where each task's resource() says.
    void onResource(std::function<Decision(const std::string& service, const std::string& resource,
                                           const std::filesystem::path&)>
                        callback);
    /// A veto, asked on the data thread before the handler's thread starts. Answer at once.
    void onTaskRequest(std::function<Decision(const Task&)> callback);
    void onTask(std::string service, TaskHandler handler);
    /// For every service that has no handler of its own.
    void onAnyTask(TaskHandler handler);
    void onPause(std::function<void(const Task&)> callback);
    void onResume(std::function<void(const Task&)> callback);
    void onText(std::function<void(const std::string& text, const std::string& from)> callback);
    void onRaw(std::function<void(const std::vector<std::string>& blocks, const std::string& from)> callback);
    /// What sendRawTo() was given has not been sent, and why. Of a stream of refusals at most five a second
    /// are told. Without this callback the log has it.
    void onNotSent(std::function<void(const std::string& participant, const std::string& why)> callback);

    /// On the stop thread, after every running task has been told. Return when the machine has been told to
    /// stop; that is acknowledged to whoever gave the stop.
    void onStop(std::function<void(const StopSignal&)> callback);
    /// The machine stands still (as its own sensors tell): the last stage of a stop's receipt, for which
    /// `axon stop` waits. From any thread; from within onStop it is told once that has returned. See
    /// Options::reports_standstill.
    void standstill();

    void onLinkUp(std::function<void()> callback);
    void onLinkDown(std::function<void(const std::string& reason)> callback);

    // Statements of the application. Dropped while no Entity Manager is linked, but for position and service
    // activity: their last values are repeated when one links.
    void setStatus(bool busy, std::string_view text = {});
    void sendInfoMsg(std::string_view text);
    void sendTaskFeedback(const Task& task, std::string_view text);
    void sendTaskFeedback(std::string_view service,
                          std::string_view text);  ///< all running tasks of a service
    void sendRaw(std::string_view bytes);
    void sendRaw(const std::vector<std::string>& blocks);  ///< together at most 1 MiB
    /// To another participant of the run of a global service in which this entity takes part: its name, UUID
    /// or role. Its onRaw() is called with this entity's name. Dropped, as sendRaw(), when somebody on the
    /// way is slower. Where there is no such run or participant nothing is sent: onNotSent() says why. What
    /// must arrive is a result of the task that a later step takes.
    void sendRawTo(std::string_view participant, const std::vector<std::string>& blocks);
    void setPosition(double x_mm, double y_mm, double z_mm);
    void setServiceActive(std::string_view service, bool active, std::string_view reason = {});
    Stream stream(std::string_view name);

    /// Listens; returns at once.
    void start();
    /// start(), then blocks until SIGINT, SIGTERM or quit(); then shutdown(). SIGINT and SIGTERM have their
    /// former actions again afterwards. One run() per process at a time.
    void run();
    void quit();
    /// Stop (Shutdown), close the link, wait until every handler has returned. Idempotent.
    void shutdown();

    bool linked() const;
    std::uint16_t port() const;  ///< that it listens on; 0 before start()

  private:
    std::unique_ptr<Communicator> communicator_;
};

}  // namespace axon
