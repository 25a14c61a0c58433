// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "client/axon/client.hpp"

namespace axon::cli {

using client::Argument;
using client::Bindings;
using client::CheckOutOptions;
using client::Details;
using client::DrillReport;
using client::Entity;
using client::GlobalService;
using client::GlobalServices;
using client::HandOverRequest;
using client::Listed;
using client::Parameter;
using client::Receipt;
using client::RunHistory;
using client::RunRecord;
using client::RunReport;
using client::RunState;
using client::Sample;
using client::Seconds;
using client::Service;
using client::StepReport;
using client::TaskReport;
using client::TaskState;
using client::Value;

/// What an entity that is held may say of its own accord. Empty functions are not called.
struct Listener {
    std::function<void(const std::string&)> text;
    std::function<void(const std::string&)> raw;
    std::function<void(const Refusal&)> lost;
    /// The connection is lost; the check-out is not, yet. And it is back.
    std::function<void(const std::string& reason)> orphaned;
    std::function<void()> resumed;
    std::function<void(const HandOverRequest&)> hand_over;
};

struct Lost {
    Entity entity;
    Refusal why;
};

/// Somebody asks for what is held here, and has no answer yet.
struct Question {
    Entity entity;
    HandOverRequest request;
};

enum class TaskAction { Pause, Resume, Cancel };

/// A task that was asked for here.
struct KeptTask {
    TaskReport report;
    Seconds elapsed{0};  ///< from the request to its end, or until now
};

/// Oldest first: every task that is not over, and the newest of those that are.
struct KeptTasks {
    std::vector<KeptTask> list;
    std::size_t forgotten = 0;  ///< how many are over and no longer in the list
};

/// What a verb needs of a connection to Axon: the client library with its check-outs and tasks found by name,
/// so that a verb that comes later (`axon pause`) reaches what an earlier one began (`axon run --detach`).
///
/// Where in the flow: verb → Station → client library. ClientStation is the one that works; tests have their
/// own. Threads: any. Callbacks come on a thread of the library and must not wait. Entities and tasks are
/// named by their UUID here, except where `name` says that it is what the user wrote. Failure: refusals.
class Station {
  public:
    virtual ~Station() = default;

    virtual Sender self() const = 0;
    virtual std::string server() const = 0;
    virtual bool connected() const = 0;

    virtual std::vector<Entity> entities(Listed listed = Listed::Ready) const = 0;
    virtual Result<Entity> find(const std::string& name) const = 0;
    virtual Result<std::vector<Service>> services(const std::string& entity) const = 0;
    virtual Result<Details> details(const std::string& entity) const = 0;

    /// By what the user wrote; in doubt all that it may mean. None = everything. `standstill`: how long,
    /// after all are confirmed, for robots that come to rest.
    virtual Result<std::vector<Receipt>> stop(const std::vector<std::string>& names, Seconds deadline,
                                              Seconds standstill) = 0;
    virtual Result<void> rearm(const std::string& entity) = 0;
    /// One try for each; none named = everything that is known.
    virtual Result<std::vector<DrillReport>> drill(const std::vector<std::string>& names) = 0;

    virtual std::vector<Entity> held() const = 0;
    /// What was held here and is not any more, and was not released by its user; until it is checked out
    /// again.
    virtual std::vector<Lost> lost() const = 0;
    /// What was granted: as it was named, or what the query found.
    virtual Result<std::vector<Entity>> checkOut(const std::vector<std::string>& entities,
                                                 const CheckOutOptions& options = {}) = 0;
    virtual Result<std::vector<Entity>> checkOutQuery(const std::string& query,
                                                      const CheckOutOptions& options) = 0;
    virtual Result<void> release(const std::string& entity) = 0;
    /// Releases it without being told to by the user; lost() says `why` afterwards.
    virtual Result<void> giveBack(const std::string& entity, const Refusal& why) = 0;
    virtual std::vector<Question> questions() const = 0;
    virtual Result<void> answerHandOver(const std::string& entity, bool accept,
                                        const std::string& reason) = 0;
    /// Held, and waiting for the connection to come back.
    virtual bool orphaned(const std::string& entity) const = 0;
    /// Held, and messages go straight to its Entity Manager.
    virtual bool direct(const std::string& entity) const = 0;

    // Of a held entity; NOT_HOLDER otherwise.
    virtual Result<Receipt> reset(const std::string& entity) = 0;
    virtual Result<Receipt> clear(const std::string& entity) = 0;
    virtual Result<void> set(const std::string& entity, const std::string& service,
                             const Argument& argument) = 0;
    virtual Result<void> upload(const std::string& entity, const std::string& service,
                                const std::string& resource, const std::filesystem::path& file,
                                std::function<void(std::uint64_t, std::uint64_t)> progress,
                                std::stop_token give_up) = 0;
    virtual Result<void> sendText(const std::string& entity, const std::string& text) = 0;
    virtual Result<void> sendRaw(const std::string& entity, const std::string& bytes) = 0;
    /// The task's id. `update` is called with each change, the final one included.
    virtual Result<std::string> run(const std::string& entity, const std::string& service,
                                    const std::vector<Argument>& arguments, Seconds not_after,
                                    std::function<void(const TaskReport&)> update) = 0;
    virtual KeptTasks tasks() const = 0;
    /// `update` is called with each change of each task, of those too that are asked for later, until the
    /// handle is dropped. What tasks() gives afterwards may be newer than what is still to be told.
    virtual std::shared_ptr<void> followTasks(std::function<void(const KeptTask&)> update) = 0;
    virtual Result<void> control(const std::string& task, TaskAction action) = 0;

    virtual Result<GlobalServices> globalServices() const = 0;
    virtual Result<client::Proposal> propose(const GlobalService& service, const Bindings& chosen) const = 0;
    /// The run's id. `update` is called with each change, the final one included.
    virtual Result<std::string> runGlobal(const GlobalService& service, const Bindings& bindings,
                                          const std::string& master, bool check_only,
                                          std::function<void(const RunReport&)> update) = 0;
    /// The runs (and checks) that were asked for here, as tasks().
    virtual std::vector<RunReport> runs() const = 0;
    virtual Result<void> controlRun(const std::string& run, TaskAction action) = 0;
    virtual Result<RunHistory> runHistory(int most) const = 0;

    /// The handle ends the watch, or the listening, when it is dropped.
    virtual Result<std::shared_ptr<void>> watch(const std::string& entity,
                                                const std::vector<std::string>& streams,
                                                std::function<void(const Sample&)> sample) = 0;
    virtual std::shared_ptr<void> listen(const std::string& entity, Listener listener) = 0;
};

}  // namespace axon::cli
