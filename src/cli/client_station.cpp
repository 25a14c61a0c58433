// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/client_station.hpp"

#include <algorithm>
#include <chrono>
#include <deque>
#include <map>
#include <mutex>

namespace axon::cli {
namespace {

using client::CheckOut;
using client::Client;
using client::Run;
using client::Task;

using Clock = std::chrono::steady_clock;

/// A task and its times.
struct Begun {
    Task task;
    Clock::time_point at;
    std::optional<Seconds> took;

    TaskReport report() const { return task.report(); }
    KeptTask kept(TaskReport report) const {
        return {std::move(report), took.value_or(Seconds(Clock::now() - at))};
    }
};

/// The oldest that is over goes; those that are not are as many as the entities let wait. Whether one has
/// gone.
template <class Handle>
bool keepNewest(std::deque<Handle>& handles, Handle handle, std::size_t most) {
    handles.push_back(std::move(handle));
    if (handles.size() <= most) return false;
    const auto over = std::find_if(handles.begin(), handles.end(),
                                   [](const Handle& one) { return client::isFinal(one.report().state); });
    if (over == handles.end()) return false;
    handles.erase(over);
    return true;
}

/// Check-outs and tasks by name, and one callback of the library spread to those who listen.
class ClientStation final : public Station {
  public:
    explicit ClientStation(std::unique_ptr<Client> client) : client_(std::move(client)) {}

    Sender self() const override { return client_->self(); }
    std::string server() const override { return client_->server(); }
    bool connected() const override { return client_->connected(); }
    std::vector<Entity> entities(Listed listed) const override { return client_->entities(listed); }
    Result<Entity> find(const std::string& name) const override { return client_->find(name); }
    Result<std::vector<Service>> services(const std::string& entity) const override {
        return client_->services(entity);
    }
    Result<Details> details(const std::string& entity) const override { return client_->details(entity); }
    Result<std::vector<Receipt>> stop(const std::vector<std::string>& names, Seconds deadline,
                                      Seconds standstill) override {
        return client_->stop(names, deadline, standstill);
    }
    Result<void> rearm(const std::string& entity) override { return client_->rearm(entity); }
    Result<std::vector<DrillReport>> drill(const std::vector<std::string>& names) override {
        return client_->drill(names);
    }

    std::vector<Entity> held() const override {
        std::vector<Entity> entities;
        for (const auto& check_out : client_->held()) entities.push_back(check_out.entity());
        return entities;
    }

    std::vector<Lost> lost() const override {
        const std::lock_guard lock(mutex_);
        std::vector<Lost> list;
        for (const auto& [id, room] : rooms_) {
            if (room.lost) list.push_back({room.entity, *room.lost});
        }
        return list;
    }

    Result<std::vector<Entity>> checkOut(const std::vector<std::string>& entities,
                                         const CheckOutOptions& options) override {
        return keep(client_->checkOut(entities, options));
    }
    Result<std::vector<Entity>> checkOutQuery(const std::string& query,
                                              const CheckOutOptions& options) override {
        return keep(client_->checkOutQuery(query, options));
    }

    std::vector<Question> questions() const override {
        std::vector<Question> open;
        for (const auto& check_out : client_->held()) {
            if (auto request = check_out.handOverRequest())
                open.push_back({check_out.entity(), std::move(*request)});
        }
        return open;
    }
    Result<void> answerHandOver(const std::string& entity, bool accept, const std::string& reason) override {
        return with(entity, [&](const CheckOut& held) { return held.answerHandOver(accept, reason); });
    }
    bool orphaned(const std::string& entity) const override {
        const auto held = heldBy(entity);
        return held && held->orphaned();
    }
    bool direct(const std::string& entity) const override {
        const auto held = heldBy(entity);
        return held && held->direct();
    }

    Result<void> release(const std::string& entity) override {
        return with(entity, [](const CheckOut& held) { return held.release(); });
    }
    Result<void> giveBack(const std::string& entity, const Refusal& why) override {
        const auto done = release(entity);
        if (done && !heldBy(entity)) {
            const std::lock_guard lock(mutex_);
            rooms_[entity].lost = why;
        }
        return done;
    }
    Result<Receipt> reset(const std::string& entity) override { return command(entity, &CheckOut::reset); }
    Result<Receipt> clear(const std::string& entity) override { return command(entity, &CheckOut::clear); }
    Result<void> set(const std::string& entity, const std::string& service,
                     const Argument& argument) override {
        return with(entity, [&](const CheckOut& held) { return held.set(service, argument); });
    }
    Result<void> upload(const std::string& entity, const std::string& service, const std::string& resource,
                        const std::filesystem::path& file,
                        std::function<void(std::uint64_t, std::uint64_t)> progress,
                        std::stop_token give_up) override {
        return with(entity, [&](const CheckOut& held) {
            return held.upload(service, resource, file, progress, give_up);
        });
    }
    Result<void> sendText(const std::string& entity, const std::string& text) override {
        return with(entity, [&](const CheckOut& held) { return held.sendText(text); });
    }
    Result<void> sendRaw(const std::string& entity, const std::string& bytes) override {
        return with(entity, [&](const CheckOut& held) { return held.sendRaw(bytes); });
    }

    Result<std::string> run(const std::string& entity, const std::string& service,
                            const std::vector<Argument>& arguments, Seconds not_after,
                            std::function<void(const TaskReport&)> update) override {
        const auto held = heldBy(entity);
        if (!held) return notHolder(entity);
        const auto at = Clock::now();
        const auto task = held->run(service, arguments, not_after);
        {
            const std::lock_guard lock(mutex_);
            if (keepNewest(tasks_, Begun{task, at, {}}, kTasksKept)) ++tasks_forgotten_;
        }
        task.onUpdate([this, update = std::move(update)](const TaskReport& report) {
            update(report);
            tellFollowers(report);
        });
        return task.id();
    }

    KeptTasks tasks() const override {
        const std::lock_guard lock(mutex_);
        KeptTasks kept;
        for (const auto& begun : tasks_) kept.list.push_back(begun.kept(begun.report()));
        kept.forgotten = tasks_forgotten_;
        return kept;
    }

    std::shared_ptr<void> followTasks(std::function<void(const KeptTask&)> update) override {
        auto follower = std::make_shared<const Follower>(std::move(update));
        const std::lock_guard lock(mutex_);
        std::erase_if(followers_, [](const auto& one) { return one.expired(); });
        followers_.push_back(follower);
        return std::const_pointer_cast<Follower>(follower);
    }

    Result<void> control(const std::string& id, TaskAction action) override {
        for (const auto& begun : copyOfTasks()) {
            const auto& task = begun.task;
            if (task.id() != id) continue;
            switch (action) {
                case TaskAction::Pause:
                    return task.pause();
                case TaskAction::Resume:
                    return task.resume();
                case TaskAction::Cancel:
                    return task.cancel();
            }
        }
        return Refusal{RefusalCode::UnknownTask, "no task " + id + " was started here", {}};
    }

    Result<GlobalServices> globalServices() const override { return client_->globalServices(); }
    Result<client::Proposal> propose(const GlobalService& service, const Bindings& chosen) const override {
        return client_->propose(service, chosen);
    }
    Result<std::string> runGlobal(const GlobalService& service, const Bindings& bindings,
                                  const std::string& master, bool check_only,
                                  std::function<void(const RunReport&)> update) override {
        const auto run = check_only ? client_->checkGlobal(service, bindings, master)
                                    : client_->runGlobal(service, bindings, master);
        if (!run) return run.refusal();
        {
            const std::lock_guard lock(mutex_);
            keepNewest(runs_, run.value(), kRunsKept);
        }
        run->onUpdate(std::move(update));
        return run->id();
    }
    std::vector<RunReport> runs() const override {
        std::vector<RunReport> reports;
        for (const auto& run : copyOfRuns()) reports.push_back(run.report());
        return reports;
    }
    Result<void> controlRun(const std::string& id, TaskAction action) override {
        for (const auto& run : copyOfRuns()) {
            if (run.id() != id) continue;
            switch (action) {
                case TaskAction::Pause:
                    return run.pause();
                case TaskAction::Resume:
                    return run.resume();
                case TaskAction::Cancel:
                    return run.cancel();
            }
        }
        return Refusal{RefusalCode::UnknownTask, "no run " + id + " was started here", {}};
    }
    Result<RunHistory> runHistory(int most) const override { return client_->runHistory({}, most); }

    Result<std::shared_ptr<void>> watch(const std::string& entity, const std::vector<std::string>& streams,
                                        std::function<void(const Sample&)> sample) override {
        return client_->watch(entity, streams, std::move(sample));
    }

    std::shared_ptr<void> listen(const std::string& entity, Listener listener) override {
        auto kept = std::make_shared<const Listener>(std::move(listener));
        const std::lock_guard lock(mutex_);
        auto& listeners = rooms_[entity].listeners;
        listeners.erase(
            std::remove_if(listeners.begin(), listeners.end(), [](const auto& one) { return one.expired(); }),
            listeners.end());
        listeners.push_back(kept);
        return std::const_pointer_cast<Listener>(kept);
    }

  private:
    static constexpr std::size_t kTasksKept = 256;
    static constexpr std::size_t kRunsKept = 64;

    using Follower = std::function<void(const KeptTask&)>;

    struct Room {
        Entity entity;
        std::optional<Refusal> lost;
        std::vector<std::weak_ptr<const Listener>> listeners;
    };

    /// Spreads what the check-outs say to those who listen.
    Result<std::vector<Entity>> keep(const Result<std::vector<CheckOut>>& granted) {
        if (!granted) return granted.refusal();
        std::vector<Entity> entities;
        for (const auto& check_out : granted.value()) {
            const auto entity = check_out.entity();
            const auto id = entity.id;
            entities.push_back(entity);
            {
                const std::lock_guard lock(mutex_);
                rooms_[id].entity = entity;
                rooms_[id].lost.reset();
            }
            check_out.onText([this, id](const std::string& text) {
                tell(id, [&](const Listener& listener) {
                    if (listener.text) listener.text(text);
                });
            });
            check_out.onRaw([this, id](const std::string& bytes) {
                tell(id, [&](const Listener& listener) {
                    if (listener.raw) listener.raw(bytes);
                });
            });
            check_out.onOrphaned([this, id](const std::string& reason) {
                tell(id, [&](const Listener& listener) {
                    if (listener.orphaned) listener.orphaned(reason);
                });
            });
            check_out.onResumed([this, id] {
                tell(id, [](const Listener& listener) {
                    if (listener.resumed) listener.resumed();
                });
            });
            check_out.onHandOverRequest([this, id](const HandOverRequest& request) {
                tell(id, [&](const Listener& listener) {
                    if (listener.hand_over) listener.hand_over(request);
                });
            });
            check_out.onLost([this, id](const Refusal& refusal) {
                {
                    const std::lock_guard lock(mutex_);
                    rooms_[id].lost = refusal;
                }
                tell(id, [&](const Listener& listener) {
                    if (listener.lost) listener.lost(refusal);
                });
            });
        }
        return entities;
    }

    std::optional<CheckOut> heldBy(const std::string& entity) const {
        for (auto& check_out : client_->held()) {
            if (check_out.entity().id == entity) return check_out;
        }
        return std::nullopt;
    }

    static Refusal notHolder(const std::string& entity) {
        return {RefusalCode::NotHolder, entity + " is not checked out here", {}};
    }

    Result<Receipt> command(const std::string& entity, Result<Receipt> (CheckOut::*give)() const) const {
        const auto held = heldBy(entity);
        if (!held) return notHolder(entity);
        return ((*held).*give)();
    }

    template <class Call>
    Result<void> with(const std::string& entity, Call call) const {
        const auto held = heldBy(entity);
        if (!held) return notHolder(entity);
        return call(*held);
    }

    template <class Call>
    void tell(const std::string& entity, Call call) const {
        std::vector<std::shared_ptr<const Listener>> present;
        {
            const std::lock_guard lock(mutex_);
            const auto found = rooms_.find(entity);
            if (found == rooms_.end()) return;
            for (const auto& weak : found->second.listeners) {
                if (auto listener = weak.lock()) present.push_back(std::move(listener));
            }
        }
        for (const auto& listener : present) call(*listener);
    }

    void tellFollowers(const TaskReport& report) {
        KeptTask kept{report, Seconds{0}};
        std::vector<std::shared_ptr<const Follower>> present;
        {
            const std::lock_guard lock(mutex_);
            const auto begun = std::find_if(tasks_.begin(), tasks_.end(),
                                            [&](const Begun& one) { return one.task.id() == report.id; });
            if (begun != tasks_.end()) {
                kept = begun->kept(report);
                if (client::isFinal(report.state)) begun->took = kept.elapsed;
            }
            for (const auto& weak : followers_) {
                if (auto follower = weak.lock()) present.push_back(std::move(follower));
            }
        }
        for (const auto& follower : present) (*follower)(kept);
    }

    std::deque<Begun> copyOfTasks() const {
        const std::lock_guard lock(mutex_);
        return tasks_;
    }

    std::deque<Run> copyOfRuns() const {
        const std::lock_guard lock(mutex_);
        return runs_;
    }

    mutable std::mutex mutex_;
    // guarded by mutex_
    std::map<std::string, Room> rooms_;  // by entity
    std::deque<Begun> tasks_;
    std::size_t tasks_forgotten_ = 0;
    std::vector<std::weak_ptr<const Follower>> followers_;
    std::deque<Run> runs_;
    const std::unique_ptr<Client> client_;  // last, so that it is destroyed first: its callbacks use the rest
};

}  // namespace

Result<std::shared_ptr<Station>> connectStation(const Settings& settings) {
    client::Options options;
    options.server = settings.server;
    options.properties = settings.properties;
    options.user = settings.user;
    options.password = settings.password;
    options.display_name = settings.name;
    options.timeout = Seconds(settings.timeout_s);
    options.direct = settings.direct;
    options.await_entities = settings.await_entities;
    auto connected = Client::connect(std::move(options));
    if (!connected) return connected.refusal();
    return std::shared_ptr<Station>(std::make_shared<ClientStation>(std::move(connected).value()));
}

}  // namespace axon::cli
