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

/// The Entity Interfacer: a robot application links it to appear in an Axon environment.
///
/// This header is the whole interface. It includes only the C++ standard library. axon/device_guard.hpp adds
/// a process that stops the robot when the application freezes or dies. docs/reference/ei-link.md describes
/// the protocol, for an interfacer in another language.
namespace axon {

/// A mistake that must be fixed before the application can run: a profile that cannot be read, a port outside
/// 5500 to 8000, an empty name. what() says where it is, what was expected and how to fix it. Only the
/// constructor, upload…Profile(), start() and run() throw it, never a callback or a running link.
class AXON_EI_API Misconfiguration : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

/// One value of a parameter.
using Value = std::variant<std::int64_t, double, std::string, bool>;

/// A parameter as the client gave it. It has more than one value only if the profile says "multiple".
/// The typed readers throw std::invalid_argument if there is no value of that type. number() also reads an
/// integer.
struct AXON_EI_API Parameter {
    std::string name;
    std::vector<Value> values;
    std::string units;  ///< those of the profile, if the client gave none

    double number() const;
    std::int64_t integer() const;
    const std::string& text() const;
    bool flag() const;
};

/// The application's answer to a request. The client is shown the reason of a denial, so write it for a
/// person.
class AXON_EI_API Decision {
  public:
    static Decision grant() { return Decision(Verdict::Granted, {}); }
    static Decision deny(std::string reason) { return Decision(Verdict::Denied, std::move(reason)); }
    /// Denies because the robot itself does not answer. The client is told ROBOT_LOST instead of DENIED.
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

/// The order to stop all motion now. This is a stop by the control system: the application decides how it
/// brings the machine to rest.
struct AXON_EI_API StopSignal {
    /// The same numbers as axon.proto.StopCause.
    enum class Cause : int {
        Unspecified = 0,
        Requested = 1,   ///< a person or a program asked for a stop
        ClientLost = 2,  ///< the client that holds the entity is gone or silent
        Released = 3,    ///< the client has released the entity
        Improper = 4,    ///< the client was disconnected for improper behaviour
        ServerLost = 5,  ///< the Entity Manager has lost its server
        LinkLost = 6,    ///< the Entity Manager is gone or silent; this library itself calls the stop
        Reset = 7,       ///< ends this task only; the next one of the queue follows
        Clear = 8,       ///< ends this task and empties the queue
        Cancel = 9,      ///< ends this task only; the task sees it, onStop() does not
        Shutdown = 10,   ///< this interfacer is being shut down or destroyed
        Fault = 11,      ///< an exception left a callback of the application
    };
    Cause cause = Cause::Unspecified;
    std::uint32_t generation = 0;  ///< rises with every stop that comes through the Entity Manager
};
AXON_EI_API const char* toString(StopSignal::Cause cause);

// The samples of streams. The library takes the time of a sample when send() is called.
struct Pose {  ///< metres and radians, in the entity's own map frame unless `frame` names another one
    double x = 0, y = 0, z = 0, roll = 0, pitch = 0, yaw = 0;
    std::string frame;
};
struct Scan {  ///< metres and radians; beam i points to angles[i] if given, else to start_angle + i * step
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

/// A named stream of samples for the clients that subscribe to it.
///
/// Cheap to copy. Valid as long as its EntityInterfacer lives. Threads: any. Never blocks. Samples are
/// dropped, oldest first, while no Entity Manager is linked, while nobody subscribes, and when the link is
/// slower than the sender. Subscribers see a gap in the sequence numbers.
class AXON_EI_API Stream {
  public:
    void send(double value, std::string_view units = {});
    void send(const std::vector<double>& values, std::string_view units = {});
    void send(const Pose& pose);
    void send(const Scan& scan);
    void send(const Image& image);
    void sendBytes(std::string_view bytes);
    /// False while the Entity Manager knows that nobody subscribes. The application need not make a sample
    /// then.
    bool wanted() const;

    struct Channel;

  private:
    friend class EntityInterfacer;
    explicit Stream(std::shared_ptr<Channel> channel) : channel_(std::move(channel)) {}
    std::shared_ptr<Channel> channel_;
};

/// One requested execution of a service. The library passes it to the handler of the service. Copies refer to
/// the same task.
///
/// States: running, paused (by the client), stop requested, decided (the handler has given a verdict), ended
/// (the handler has returned).
///
/// The client is told the verdict when the handler has returned. Everything that the handler gives back on
/// its return, such as the drive, is therefore free for the client's next task. After a stop or the loss of
/// the link, the client is told the end at once. A handler of another service can then begin before this one
/// has returned, so a device that several services use needs a lock.
///
/// A handler may block. It should return soon after stopRequested() becomes true, and use waitFor() instead
/// of sleeping. A handler that passes the task to another thread must wait for that thread, because the task
/// ends when the handler returns. A stop is acknowledged whether or not the handler returns.
///
/// Threads: any thread may call every member. Calls after the verdict or the end have no effect.
class AXON_EI_API Task {
  public:
    const std::string& id() const;  ///< UUID text
    const std::string& service() const;

    // Parameters. A CONFIG parameter that is set while the task runs has its new value at once: a handler
    // that reads it in every round of its loop follows it. All other parameters keep the value that they had
    // when the task began.
    bool has(std::string_view parameter) const;
    // Values. Without a fallback, a missing parameter or one of another type throws std::invalid_argument. An
    // exception that leaves the handler fails the task.
    double number(std::string_view parameter) const;
    double number(std::string_view parameter, double fallback) const;
    std::int64_t integer(std::string_view parameter) const;
    std::int64_t integer(std::string_view parameter, std::int64_t fallback) const;
    std::string text(std::string_view parameter) const;
    std::string text(std::string_view parameter, std::string_view fallback) const;
    bool flag(std::string_view parameter) const;
    bool flag(std::string_view parameter, bool fallback) const;
    // All values of a "multiple" parameter; empty if it was not given.
    std::vector<double> numbers(std::string_view parameter) const;
    std::vector<std::int64_t> integers(std::string_view parameter) const;
    std::vector<std::string> texts(std::string_view parameter) const;
    std::vector<bool> flags(std::string_view parameter) const;
    std::string units(std::string_view parameter) const;
    const std::vector<Parameter>& parameters() const;  ///< as they were when the task began
    /// Path of the resource (a file) on this machine; empty if it was not given.
    std::filesystem::path resource(std::string_view name) const;

    void progress(double part);  ///< 0 to 1
    void feedback(std::string_view text);
    /// Sets an OUTPUT or FEEDBACK parameter. It is sent with the next report, at the latest with the verdict.
    void result(std::string_view name, Value value, std::string_view units = {});
    void result(std::string_view name, std::vector<Value> values, std::string_view units = {});

    bool stopRequested() const;  ///< by a stop, a cancel or the loss of the link
    StopSignal::Cause stopCause() const;
    bool paused() const;
    /// Blocks while the task is paused. Returns false if a stop is requested.
    bool waitWhilePaused() const;
    /// Use it instead of sleeping. Returns true when the time has passed, and false at once if a stop is
    /// requested.
    bool waitFor(std::chrono::duration<double> time) const;

    // The verdict. The first one counts. It is sent when the handler returns. A handler that returns without
    // a verdict has succeeded, or was stopped (or cancelled) if a stop was requested. An exception that
    // leaves the handler fails the task even after succeed().
    void succeed();
    void fail(std::string_view reason);
    /// Fails because the robot itself does not answer, or no longer answers. The client is told ROBOT_LOST.
    void robotLost(std::string_view reason);

    class Running;
    explicit Task(std::shared_ptr<Running> running) : running_(std::move(running)) {}

  private:
    std::shared_ptr<Running> running_;
};

enum class LogLevel { Info, Warning, Error };

/// The robot application's end of the link to its Entity Manager (thesis 3.3.2).
///
/// Where in the flow: the last station. It listens on the first free port of its range, and the Entity
/// Manager that is configured with the same application name connects to it. Set the callbacks, upload both
/// profiles, then call run() or start().
///
/// States: made → started (listening) ⇄ linked → shut down (final).
///
/// Threads: the library has threads of its own. The *stop thread* runs onStop and nothing else; no other
/// callback can delay it. Every task handler has a thread to itself. All other callbacks run one after the
/// other on the *data thread*. Any thread may call every member function, and so may a callback, with one
/// exception: shutdown() and the destructor must not be called from a callback, where they only end run().
/// Set callbacks and handlers before start().
///
/// Ownership: the destructor calls onStop (Shutdown), then waits until every handler has returned. Everything
/// that the callbacks refer to must live until then.
///
/// Failure: the loss of the link, a dead or silent Entity Manager, an exception that leaves a callback, and
/// the destructor all call onStop. An exception that leaves a task handler also fails that task. An exception
/// that leaves any callback other than onStop also ends the link, which is established again at once. No
/// exception from a callback ends the process.
class AXON_EI_API EntityInterfacer {
  public:
    struct Options {
        std::string application{};  ///< the name with which the Entity Manager is configured; required
        std::string instance{};     ///< distinguishes equal applications on one host; empty = none
        std::filesystem::path
            ports_file;  ///< a ports.cfg; if given, it replaces first_port, last_port, address and users
        std::uint16_t first_port = 5500;  ///< the range must be within 5500 to 8000, both included
        std::uint16_t last_port = 8000;
        std::string address = "127.0.0.1";  ///< IPv4 address to listen on
        std::string users{};  ///< users of this machine whose Entity Manager may connect, by name or number:
                              ///< "axon 1001"; root and this process's own user always may
        bool beyond_loopback = false;  ///< allow other addresses; the link has no authentication, so only on
                                       ///< networks you trust
        bool watch_profiles = true;    ///< upload the profiles again when their files change
        /// Folders below which the url of a resource may be an absolute path. A relative url starts at the
        /// folder of the services profile. The Entity Manager reads and replaces files in these folders and
        /// in its own, and nowhere else.
        std::vector<std::filesystem::path> resource_folders{};
        /// Whether the application calls standstill() after every stop of a moving robot, so that a client
        /// can wait for that. Becomes true by itself at the first call of standstill().
        bool reports_standstill = false;
        std::function<void(LogLevel, const std::string&)>
            logger{};  ///< called on any thread; none = standard error
        /// The clock of heartbeats, watchdogs and waiting tasks (common/clock.hpp in Axon's source). Without
        /// one, the library uses the clock of this machine, or in trials the clock of the virtual laboratory
        /// whose file the variable AXON_CLOCK names.
        std::shared_ptr<const Clock> clock{};
    };
    using TaskHandler = std::function<void(Task&)>;

    explicit EntityInterfacer(Options options);
    ~EntityInterfacer();
    EntityInterfacer(const EntityInterfacer&) = delete;
    EntityInterfacer& operator=(const EntityInterfacer&) = delete;

    // Profiles: XML files of at most 1 MiB. The library keeps them and sends them to every Entity Manager
    // that links.
    void uploadBasicProfile(const std::filesystem::path& file);
    void uploadServiceProfile(const std::filesystem::path& file);

    // Requests of the client. Without a callback, parameters and resources are granted, and a task is granted
    // if its service has a handler.

    /// Called for every value that a client gives, on its own or with a task. With a task, it is called
    /// before onTaskRequest, and a denial refuses the task. For a composite service, it is called for all
    /// given values before the first part begins. `service` is the service whose profile declares the
    /// parameter.
    void onParameter(std::function<Decision(const std::string& service, const Parameter&)> callback);
    /// Called with the value of a CONFIG parameter. Called for every CONFIG parameter that has a value when
    /// an Entity Manager has linked and read the profiles, before the first task. That value is the
    /// profile's, or the one that was set before, perhaps in an earlier run of this program. After that,
    /// called whenever a parameter has been set (and granted, see onParameter), whether or not a task runs. A
    /// stop does not delay the call, so the callback must not move the machine. It can be called again with
    /// an unchanged value.
    ///
    /// Throw if the value cannot be used; what() should tell a person why. If that happens before the first
    /// task or raw data of a link, the service that declares the parameter becomes inactive, with that reason
    /// and in spite of setServiceActive(), until this callback accepts a value of the parameter. If it
    /// happens later, it is a fault as in every callback: a stop, and the end of the link. The next link
    /// calls this callback with the value again, and the service becomes inactive.
    ///
    /// Where possible, deny a value in onParameter, because then the client is told at once. onParameter is
    /// not called for values that were granted in an earlier run of this program.
    void onConfig(std::function<void(const std::string& service, const Parameter&)> callback);
    /// Called with a file that a client has uploaded, for inspection. Only a grant replaces the previous
    /// file. The file is then moved; Task::resource() returns its new path.
    void onResource(std::function<Decision(const std::string& service, const std::string& resource,
                                           const std::filesystem::path&)>
                        callback);
    /// May deny a task. Called on the data thread before the handler's thread starts. It should return at
    /// once.
    void onTaskRequest(std::function<Decision(const Task&)> callback);
    void onTask(std::string service, TaskHandler handler);
    /// The handler of every service that has no handler of its own.
    void onAnyTask(TaskHandler handler);
    void onPause(std::function<void(const Task&)> callback);
    void onResume(std::function<void(const Task&)> callback);
    void onText(std::function<void(const std::string& text, const std::string& from)> callback);
    void onRaw(std::function<void(const std::vector<std::string>& blocks, const std::string& from)> callback);
    /// Called when data given to sendRawTo() has not been sent, with the reason. Called at most five times
    /// per second. Without this callback, the reason is logged.
    void onNotSent(std::function<void(const std::string& participant, const std::string& why)> callback);

    /// Called on the stop thread, after stopRequested() has become true in every running task. Return when
    /// the machine has been told to stop; the return is acknowledged to the client that ordered the stop.
    void onStop(std::function<void(const StopSignal&)> callback);
    /// Reports that the machine stands still, as its own sensors show. This is the last stage of a stop's
    /// receipt, for which `axon stop` waits. Call it from any thread. A call from within onStop is sent when
    /// onStop has returned. See Options::reports_standstill.
    void standstill();

    void onLinkUp(std::function<void()> callback);
    void onLinkDown(std::function<void(const std::string& reason)> callback);

    // Reports of the application. While no Entity Manager is linked they are dropped, except for position and
    // service activity, whose last values are sent when one links.
    void setStatus(bool busy, std::string_view text = {});
    void sendInfoMsg(std::string_view text);
    void sendTaskFeedback(const Task& task, std::string_view text);
    void sendTaskFeedback(std::string_view service,
                          std::string_view text);  ///< to all running tasks of a service
    void sendRaw(std::string_view bytes);
    void sendRaw(const std::vector<std::string>& blocks);  ///< together at most 1 MiB
    /// Sends raw data to another participant of the run in which this entity takes part. `participant` is its
    /// name, UUID or role. Its onRaw() is called with this entity's name. Like sendRaw(), the data is dropped
    /// if a component on the way is slower than the sender. If there is no such run or participant, nothing
    /// is sent, and onNotSent() is told why. Data that must arrive belongs in a result of the task, from
    /// which a later step takes it.
    void sendRawTo(std::string_view participant, const std::vector<std::string>& blocks);
    void setPosition(double x_mm, double y_mm, double z_mm);
    void setServiceActive(std::string_view service, bool active, std::string_view reason = {});
    Stream stream(std::string_view name);

    /// Starts to listen. Returns at once.
    void start();
    /// Calls start(), blocks until SIGINT, SIGTERM or quit(), then calls shutdown(). Afterwards it restores
    /// the previous actions of SIGINT and SIGTERM. Only one run() at a time is possible in a process.
    void run();
    void quit();
    /// Calls onStop (Shutdown), closes the link, and waits until every handler has returned. May be called
    /// more than once.
    void shutdown();

    bool linked() const;
    std::uint16_t port() const;  ///< the port on which it listens; 0 before start()

  private:
    std::unique_ptr<Communicator> communicator_;
};

}  // namespace axon
