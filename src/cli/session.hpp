// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "cli/station.hpp"

namespace axon::cli {

using Json = nlohmann::json;

/// What the command exits with; docs/reference/command.md explains them and they never change.
enum Exit : int {
    kDone = 0,
    kRefused = 1,       ///< refused, or the robot application reported failure
    kUsage = 2,         ///< the command line or the configuration is wrong
    kNoServer = 3,      ///< no server, or the connection was lost
    kNotConfirmed = 4,  ///< timed out, or nobody said what became of it
    kStopped = 5,       ///< the task was stopped or cancelled
    kInterrupted = 130,
};

/// Where a verb's events go: to a renderer in the same process, or down the agent's socket as JSON lines.
class Events {
  public:
    virtual ~Events() = default;
    /// One object with the member "event". Called by the verb's own thread only; may block.
    virtual void emit(const Json& event) = 0;
};

/// Hands what the library's threads say to the verb's thread, and wakes that when the user has had enough.
///
/// Bound: kLimit. When it is full the oldest event that may be dropped (a sample, a progress) is, and
/// counted; without such a one the new event is dropped if it may be, and kept otherwise (final reports: a
/// few per task). Threads: post and interrupt any, the rest the verb's.
class Mailbox {
  public:
    static constexpr std::size_t kLimit = 1000;

    void post(Json event, bool droppable = false);
    /// Ctrl-C, or the agent's peer is gone. Counted.
    void interrupt();

    /// The oldest event; nothing when the deadline has passed, or when there was an interrupt that this
    /// thread has not yet taken.
    std::optional<Json> wait(std::optional<std::chrono::steady_clock::time_point> deadline = std::nullopt);
    /// Whether there was an interrupt that this thread has not yet taken; takes one.
    bool takeInterrupt();
    /// Events dropped since this was last asked.
    std::size_t takeDropped();

  private:
    struct Letter {
        Json event;
        bool droppable;
    };
    std::mutex mutex_;
    std::condition_variable changed_;
    // guarded by mutex_
    std::deque<Letter> letters_;
    std::size_t dropped_ = 0;
    unsigned interrupts_ = 0;
    unsigned interrupts_taken_ = 0;
};

/// What the options say that all verbs share (common_options.hpp), and the configuration that they name.
struct Settings {
    std::string server = "127.0.0.1:10410";
    std::string user, password, name;
    std::string password_file;
    std::string config;  ///< absolute; what it says is in the other members already
    std::map<std::string, std::string> properties;  ///< client::Options has them
    double timeout_s = 5;
    bool json = false;
    bool direct = true;  ///< this and the next: client::Options has them
    bool await_entities = true;
};

using Connect = std::function<Result<std::shared_ptr<Station>>(const Settings&)>;

/// What a verb is given to do its work.
struct Session {
    Json args;  ///< by the names of the verb's operands and options
    Events& events;
    std::shared_ptr<Mailbox> mailbox;
    std::shared_ptr<Station> station;  ///< null for verbs that are not about one connection (Runs::Local)
    const Settings& settings;
    bool kept = false;  ///< in an agent: check-outs stay when the verb ends

    /// Runs::Local only: another verb, on the agent when there is one.
    std::function<int(const std::string& verb, const Json& args, Events&)> perform = {};
    Connect connect = {};
    /// In an agent only, and not under `checkout -- command`: ends it when this verb is done.
    std::function<void()> end_agent = {};
    /// Likewise: requests for what it holds are told there at once (caretaker.hpp, reachableAt).
    std::function<void(const Json& where)> notify = {};
    /// Likewise: after this many seconds without use it releases what it holds; 0 = never.
    std::function<void(double)> set_idle = {};
};

/// What an operand or option takes; drives the parser, the help and the shell completion.
enum class Takes {
    Entity,
    Service,
    KeyValue,
    Resource,
    File,
    Text,
    Task,
    GlobalService,
    Binding,  ///< ROLE=ENTITY
    Run,      ///< of a global service
    Stream,
    Verb,
    Duration,
    MaybeDuration,  ///< "--wait" or "--wait=5": options only
    Count,
    Choice,
    Nothing
};

/// A word by position. A repeated one is an array in Session::args, the others strings.
struct Operand {
    const char* name;
    Takes takes;
    bool required = true;
    bool repeated = false;
    const char* help = "";
    std::vector<const char*> choices = {};
};

/// `--name`: a bool for Takes::Nothing, a number for Takes::Duration and Takes::Count, a number or true for
/// Takes::MaybeDuration, else a string (a repeated one: an array of them); absent when not given.
struct Option {
    const char* name;
    Takes takes;
    const char* help;
    std::vector<const char*> choices = {};
    bool repeated = false;
};

/// Where a verb is run.
enum class Runs {
    Local,     ///< in this process, without a connection
    Anywhere,  ///< in the agent when there is one, else on a connection of its own
    Holder,    ///< in the agent when it holds the entity, else on a connection of its own
    Kept,      ///< only in an agent: it is about what is kept there
    Keeper,    ///< in the agent, which is started when there is none
};

/// One verb: one object in one file below verbs/, and one line in verbs.cpp.
struct Verb {
    const char* name;  ///< "run"; "global run" is the verb run of the group global
    const char* summary;
    const char* examples;
    Runs runs;
    std::vector<Operand> operands;
    std::vector<Option> options;
    int (*perform)(Session&);
    /// In the user's process, before the arguments may leave it: reads standard input, makes paths absolute.
    /// Returns what is wrong with them, or an empty text.
    std::string (*prepare)(Json& args) = nullptr;
    bool hidden = false;
    /// So many Ctrl-C the verb answers itself; the next one ends the process at once.
    unsigned interrupts = 1;
};

/// Verbs about one thing, with help of their own: `axon global --help`.
struct VerbGroup {
    const char* name;
    const char* summary;
    const char* footer;
};
const std::vector<VerbGroup>& verbGroups();
const VerbGroup* findGroup(const std::string& name);

const std::vector<const Verb*>& verbs();
const Verb* findVerb(const std::string& name);

}  // namespace axon::cli
