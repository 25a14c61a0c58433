// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/stream.pb.h>
#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "cli/session.hpp"
#include "cli/station.hpp"
#include "cli/words.hpp"

namespace axon::cli {

/// A laboratory of two PeopleBots and an arm that does what the test tells it: for tests only.
class FakeStation : public Station {
  public:
    FakeStation() {
        entities_ = {entity("11111111-0000-4000-8000-000000000001", "PeopleBot"),
                     entity("22222222-0000-4000-8000-000000000002", "PeopleBot"),
                     entity("33333333-0000-4000-8000-000000000003", "Cyton")};
        entities_[2].type = "STATIONARY";
        Service driving;
        driving.name = "Driving";
        driving.global_id = "peoplebot_drive";
        driving.kind = client::ServiceKind::Simple;
        driving.descr = "Drives straight ahead";
        driving.pausable = true;
        Parameter distance;
        distance.name = "Distance";
        distance.kind = client::ParameterKind::Input;
        distance.data_type = client::DataType::Integer;
        distance.units = "mm";
        distance.required = true;
        distance.minimum = -5000;
        distance.maximum = 5000;
        Parameter threshold;
        threshold.name = "Range Threshold";
        threshold.kind = client::ParameterKind::Config;
        threshold.data_type = client::DataType::Double;
        threshold.units = "mm";
        threshold.values = {Value(500.0)};
        threshold.savable = true;
        Parameter colours;
        colours.name = "Colours";
        colours.kind = client::ParameterKind::Input;
        colours.data_type = client::DataType::Text;
        colours.multiple = true;
        colours.choices = {Value(std::string("red")), Value(std::string("green"))};
        driving.parameters = {distance, threshold, colours};
        client::Resource map;
        map.name = "Map";
        map.required = true;
        driving.resources = {map};
        driving.missing = {"Distance", "Map"};
        services_ = {driving};
    }

    Sender self() const override { return {"me", "ana@lab", my_role}; }
    std::string server() const override { return "127.0.0.1:10410"; }
    bool connected() const override { return is_connected; }
    std::vector<Entity> entities(Listed listed = Listed::Ready) const override {
        auto list = entities_;
        if (listed == Listed::Ready) std::erase_if(list, [](const Entity& one) { return !one.ready; });
        return list;
    }
    Result<Entity> find(const std::string& name) const override {
        std::vector<Entity> found;
        for (const auto& one : entities_) {
            if (one.id == name) return one;
            if (one.name == name || (name.size() >= 4 && one.id.starts_with(name))) found.push_back(one);
        }
        if (found.size() == 1) return found.front();
        if (found.empty())
            return Refusal{RefusalCode::UnknownEntity, "no entity is called \"" + name + "\"", {}};
        return Refusal{RefusalCode::AmbiguousEntity, "several entities are called \"" + name + "\"", {}};
    }
    Result<std::vector<Service>> services(const std::string&) const override { return services_; }
    Result<Details> details(const std::string&) const override {
        return Details{services_, watchdogs, findings};
    }
    Result<std::vector<Receipt>> stop(const std::vector<std::string>& entities, Seconds,
                                      Seconds standstill) override {
        stopped = entities;
        waited_for_standstill = standstill;
        std::vector<Receipt> list;
        for (const auto& one : entities_) {
            const auto meant = [&](const std::string& word) {
                return one.id == word || one.name == word || (word.size() >= 4 && one.id.starts_with(word));
            };
            if (!entities.empty() && std::none_of(entities.begin(), entities.end(), meant)) continue;
            Receipt receipt;
            receipt.entity = one.id;
            receipt.name = one.name;
            receipt.state = EntityState::REG;
            receipt.server = Seconds(0.0004);
            receipt.manager = Seconds(0.0009);
            if (stop_is_confirmed) receipt.callback_returned = Seconds(0.0125);
            if (!lost_application.empty()) {
                receipt.callback_returned.reset();
                receipt.application_lost = lost_application;
                receipt.application_lost_for = Seconds(12.5);
            }
            list.push_back(receipt);
        }
        return list;
    }
    Result<std::vector<DrillReport>> drill(const std::vector<std::string>& names) override {
        if (++drills == refused_drill) return Refusal{RefusalCode::NotConnected, "the server has gone", {}};
        std::vector<DrillReport> reports;
        for (const auto& one : entities_) {
            if (!names.empty() && std::find(names.begin(), names.end(), one.name) == names.end()) continue;
            DrillReport report{one.id, one.name, {Seconds(0.0005)}, {Seconds(0.001)}, false};
            if (drills == lost_drill) report.callback = {std::nullopt};
            reports.push_back(std::move(report));
        }
        return reports;
    }
    Result<void> rearm(const std::string& id) override {
        const std::lock_guard lock(mutex_);
        if (rearm_refusal && std::find(held_.begin(), held_.end(), id) == held_.end()) return *rearm_refusal;
        rearmed.push_back(id);
        return {};
    }
    std::vector<Entity> held() const override {
        const std::lock_guard lock(mutex_);
        std::vector<Entity> list;
        for (const auto& one : entities_) {
            if (std::find(held_.begin(), held_.end(), one.id) != held_.end()) list.push_back(one);
        }
        return list;
    }
    std::vector<Lost> lost() const override {
        std::vector<Lost> list;
        for (const auto& one : entities_) {
            if (one.id == lost_id) {
                list.push_back({one, {RefusalCode::RevokedLease, "an admin took it over", "cl2@lab"}});
            }
            if (const auto found = given_back.find(one.id); found != given_back.end())
                list.push_back({one, found->second});
        }
        return list;
    }
    Result<std::vector<Entity>> checkOut(const std::vector<std::string>& ids,
                                         const CheckOutOptions& options = {}) override {
        asked = options;
        if (!check_out_refusal.ok()) return check_out_refusal;
        if (on_check_out) on_check_out();
        if (waits_for_ever) {
            options.on_waiting({entities_[2].id, 2, "Place 2 in the wait list of Cyton."});
            options.on_waiting({entities_[2].id, 1, "Place 1 in the wait list of Cyton."});
            std::mutex mutex;
            std::condition_variable_any ended;
            std::unique_lock lock(mutex);
            ended.wait(lock, options.give_up, [] { return false; });
            return Refusal{RefusalCode::Cancelled, "given up", {}};
        }
        const std::lock_guard lock(mutex_);
        held_.insert(held_.end(), ids.begin(), ids.end());
        journal.push_back("checkOut");
        std::vector<Entity> granted;
        for (const auto& one : entities_) {
            if (std::find(ids.begin(), ids.end(), one.id) != ids.end()) granted.push_back(one);
        }
        return granted;
    }
    Result<std::vector<Entity>> checkOutQuery(const std::string& query,
                                              const CheckOutOptions& options) override {
        queried = query;
        if (query == "nonsense") return Refusal{RefusalCode::Malformed, "Expected ROBOT", {}};
        return checkOut({entities_[2].id}, options);
    }
    std::vector<Question> questions() const override {
        std::vector<Question> open;
        if (!asks.empty()) open.push_back({entities_[2], {asks, "a demonstration", Seconds(30)}});
        return open;
    }
    Result<void> answerHandOver(const std::string&, bool accept, const std::string& reason) override {
        if (asks.empty()) return Refusal{RefusalCode::WrongState, "nobody asks for Cyton", {}};
        asks.clear();
        sent = (accept ? "accept " : "refuse ") + reason;
        return {};
    }
    bool orphaned(const std::string&) const override { return !is_connected; }
    bool direct(const std::string& id) const override { return id == direct_id; }
    Result<void> release(const std::string& id) override {
        if (id == unreleasable_id) return Refusal{RefusalCode::NotConnected, "the server has gone", {}};
        const std::lock_guard lock(mutex_);
        held_.erase(std::remove(held_.begin(), held_.end(), id), held_.end());
        journal.push_back("release");
        return {};
    }
    Result<void> giveBack(const std::string& id, const Refusal& why) override {
        const auto done = release(id);
        if (done) given_back[id] = why;
        return done;
    }
    Result<Receipt> reset(const std::string&) override { return answer_of_command; }
    Result<Receipt> clear(const std::string&) override { return answer_of_command; }
    Result<void> set(const std::string&, const std::string&, const Argument& argument) override {
        set_arguments.push_back(argument);
        return {};
    }
    Result<void> upload(const std::string&, const std::string&, const std::string&,
                        const std::filesystem::path&,
                        std::function<void(std::uint64_t, std::uint64_t)> progress,
                        std::stop_token give_up) override {
        progress(500, 1000);
        if (upload_is_stuck) {
            std::mutex mutex;
            std::condition_variable_any ended;
            std::unique_lock lock(mutex);
            ended.wait(lock, give_up, [] { return false; });
            upload_was_given_up = true;
            return Refusal{RefusalCode::Cancelled, "given up", {}};
        }
        progress(1000, 1000);
        return {};
    }
    Result<void> sendText(const std::string&, const std::string& text) override {
        sent = text;
        return {};
    }
    Result<void> sendRaw(const std::string&, const std::string& bytes) override {
        sent = bytes;
        return {};
    }
    Result<std::string> run(const std::string& id, const std::string& service,
                            const std::vector<Argument>& arguments, Seconds,
                            std::function<void(const TaskReport&)> update) override {
        run_arguments = arguments;
        TaskReport report;
        report.id = "abcdef00-0000-4000-8000-00000000000a";
        report.entity = id;
        report.service = service;
        for (const auto& step : script) {
            report.state = step.state;
            report.progress = step.progress;
            report.feedback = step.feedback;
            report.reason = step.reason;
            report.results = step.results;
            report.accepted = report.accepted || step.accepted;
            update(report);
        }
        {
            const std::lock_guard lock(mutex_);
            last_ = report;
            update_ = std::move(update);
        }
        if (on_run) on_run();
        return report.id;
    }
    KeptTasks tasks() const override {
        const std::lock_guard lock(mutex_);
        KeptTasks kept{others, forgotten_tasks};
        if (last_) kept.list.push_back({*last_, Seconds(1.5)});
        return kept;
    }
    std::shared_ptr<void> followTasks(std::function<void(const KeptTask&)> update) override {
        auto kept = std::make_shared<const std::function<void(const KeptTask&)>>(std::move(update));
        {
            const std::lock_guard lock(mutex_);
            follower_ = kept;
        }
        if (on_follow) on_follow();
        return std::const_pointer_cast<std::function<void(const KeptTask&)>>(kept);
    }
    /// What becomes of the task of the last run(), told to who follows.
    void goOn(TaskState state, const Refusal& reason = {}) {
        std::shared_ptr<const std::function<void(const KeptTask&)>> follower;
        TaskReport report;
        {
            const std::lock_guard lock(mutex_);
            last_->state = state;
            last_->reason = reason;
            report = *last_;
            follower = follower_.lock();
        }
        if (follower) (*follower)({report, Seconds(2)});
    }
    Result<void> control(const std::string&, TaskAction action) override {
        std::function<void(const TaskReport&)> update;
        TaskReport report;
        {
            const std::lock_guard lock(mutex_);
            journal.push_back(action == TaskAction::Cancel ? "cancel" : "pause or resume");
            if (action != TaskAction::Cancel || !last_ || !cancel_is_heard) return {};
            last_->state = TaskState::Cancelled;
            last_->reason = {RefusalCode::Cancelled, "cancelled by ana@lab", {}};
            report = *last_;
            update = update_;
        }
        update(report);
        return {};
    }
    Result<std::shared_ptr<void>> watch(const std::string& id, const std::vector<std::string>& streams,
                                        std::function<void(const Sample&)> sample) override {
        watched = streams;
        if (!streams.empty() && std::find(streams.begin(), streams.end(), stream) == streams.end())
            return std::shared_ptr<void>();
        for (const auto& [sequence, text] : samples) {
            proto::StreamSample content;
            const auto read = google::protobuf::util::JsonStringToMessage(text, &content);
            sample({id, stream, sequence, read.ok() ? content.SerializeAsString() : text});
        }
        return std::shared_ptr<void>();
    }
    Result<GlobalServices> globalServices() const override {
        if (!global_refusal.ok()) return global_refusal;
        return global_services;
    }
    /// The first PeopleBot plays role 0 and the arm role 1, unless others are chosen.
    Result<client::Proposal> propose(const GlobalService&, const Bindings& chosen) const override {
        ++proposed;
        const auto at = static_cast<std::size_t>(proposed - 1);
        if (at < in_the_way.size()) {
            client::Proposal impossible;
            impossible.why = in_the_way[at];
            for (const int role : {0, 1}) {
                auto& outlook = impossible.roles.emplace_back();
                outlook.role = role;
                if (role == 1) outlook.unfit.push_back({entities_[2].id, "Cyton", in_the_way[at], 1});
            }
            return impossible;
        }
        client::Proposal proposal;
        for (const auto& [role, place] : {std::pair{0, 0}, std::pair{1, 2}}) {
            auto id = entities_[static_cast<std::size_t>(place)].id;
            if (const auto choice = chosen.find(role); choice != chosen.end()) id = choice->second;
            const auto name = callName(find(id).value(), entities_);
            proposal.roles.push_back({role, "ROBOT", "ROBOT", {name}, {}, id, name});
        }
        return proposal;
    }
    Result<std::string> runGlobal(const GlobalService& service, const Bindings& bindings,
                                  const std::string& master, bool check_only,
                                  std::function<void(const RunReport&)> update) override {
        run_bindings = bindings;
        run_master = master;
        if (!run_refusal.ok()) return run_refusal;
        RunReport report;
        report.id = "fedcba00-0000-4000-8000-00000000000b";
        report.service = service.name;
        report.master = master;
        report.check = check_only;
        for (const auto& [role, id] : bindings) {
            auto& step = report.steps.emplace_back();
            step.step = role;
            step.entity = id;
            step.name = callName(find(id).value(), entities_);
            step.service = role == 0 ? "drive" : "grab";
            if (role == 0) step.called = "approach";
            step.preced = role + 1;
        }
        update(report);
        for (const auto& change : run_script) {
            change(report);
            update(report);
        }
        const std::lock_guard lock(mutex_);
        journal.push_back(check_only ? "check" : "run");
        last_run_ = report;
        run_update_ = std::move(update);
        return report.id;
    }
    std::vector<RunReport> runs() const override {
        const std::lock_guard lock(mutex_);
        return last_run_ ? std::vector{*last_run_} : std::vector<RunReport>{};
    }
    Result<void> controlRun(const std::string&, TaskAction action) override {
        std::function<void(const RunReport&)> update;
        RunReport report;
        {
            const std::lock_guard lock(mutex_);
            journal.push_back(action == TaskAction::Cancel  ? "cancel run"
                              : action == TaskAction::Pause ? "pause run"
                                                            : "resume run");
            if (action != TaskAction::Cancel || !last_run_ || !cancel_is_heard) return {};
            last_run_->state = RunState::Cancelled;
            last_run_->reason = {RefusalCode::Cancelled, "cancelled by ana@lab", {}};
            report = *last_run_;
            update = run_update_;
        }
        update(report);
        return {};
    }
    Result<RunHistory> runHistory(int) const override {
        ++histories_asked;
        if (on_history) on_history();
        if (!history_refusal.ok()) return history_refusal;
        return history;
    }
    std::shared_ptr<void> listen(const std::string&, Listener listener) override {
        if (listener.text && !says.empty()) listener.text(says);
        if (listener.hand_over && !asks.empty()) listener.hand_over({asks, "a demonstration", Seconds(30)});
        return std::make_shared<int>(0);
    }

    static Entity entity(const std::string& id, const std::string& name) {
        Entity made;
        made.id = id;
        made.name = name;
        made.category = "ROBOT";
        made.type = "MOBILE";
        made.state = EntityState::IDLE;
        return made;
    }
    std::vector<std::string> journalNow() const {
        const std::lock_guard lock(mutex_);
        return journal;
    }

    // What the test sets …
    std::vector<Entity> entities_;
    std::vector<Service> services_;
    struct Step {
        TaskState state = TaskState::Running;
        double progress = -1;
        std::string feedback;
        Refusal reason;
        std::map<std::string, std::vector<Value>> results;
        bool accepted = false;
    };
    std::vector<Step> script;
    std::vector<KeptTask> others;  ///< before the one of run()
    std::size_t forgotten_tasks = 0;
    std::function<void()> on_follow;
    std::vector<std::pair<std::uint64_t, std::string>> samples;  // sequence, and JSON or what is no sample
    Refusal check_out_refusal;
    Role my_role = Role::Operator;
    std::string lost_id, direct_id, says;
    std::string unreleasable_id;  ///< its release is refused
    std::string asks;             ///< who wants the arm
    std::string stream = "pose";  ///< of the samples
    std::vector<client::WatchdogMargin> watchdogs;
    std::vector<client::EntityFinding> findings;
    bool waits_for_ever = false;
    int lost_drill = 0;     ///< the one that never arrives
    int refused_drill = 0;  ///< the one that is refused
    std::atomic<bool> is_connected{true};
    bool stop_is_confirmed = true;
    std::string lost_application;
    Seconds waited_for_standstill{-1};
    Result<Receipt> answer_of_command = Receipt{};
    bool cancel_is_heard = true;
    bool upload_is_stuck = false;
    std::function<void()> on_check_out, on_run;
    GlobalServices global_services;
    Refusal global_refusal, run_refusal;
    std::vector<Refusal> in_the_way;  ///< of the first proposals
    std::vector<std::function<void(RunReport&)>> run_script;
    RunHistory history;
    Refusal history_refusal;
    std::function<void()> on_history;
    // … and looks at.
    Bindings run_bindings;
    std::string run_master;
    mutable int proposed = 0;
    mutable int histories_asked = 0;
    std::optional<Refusal> rearm_refusal;  // of who does not hold it
    std::vector<std::string> stopped, rearmed, watched, journal;
    std::map<std::string, Refusal> given_back;
    std::vector<Argument> run_arguments, set_arguments;
    std::string sent, queried;
    CheckOutOptions asked;
    int drills = 0;
    std::atomic<bool> upload_was_given_up{false};

  private:
    mutable std::mutex mutex_;
    // guarded by mutex_, and journal too
    std::vector<std::string> held_;
    std::optional<RunReport> last_run_;
    std::function<void(const RunReport&)> run_update_;
    std::optional<TaskReport> last_;
    std::weak_ptr<const std::function<void(const KeptTask&)>> follower_;
    std::function<void(const TaskReport&)> update_;
};

/// Keeps what a verb emitted.
class Recorded final : public Events {
  public:
    void emit(const Json& event) override {
        events.push_back(event);
        if (on_event) on_event(event);
    }
    const Json* last(const std::string& kind) const {
        for (auto at = events.rbegin(); at != events.rend(); ++at) {
            if (at->value("event", "") == kind) return &*at;
        }
        return nullptr;
    }
    std::vector<Json> events;
    std::function<void(const Json&)> on_event;
};

}  // namespace axon::cli
