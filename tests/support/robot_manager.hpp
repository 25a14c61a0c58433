// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>

#include <algorithm>
#include <asio/executor_work_guard.hpp>
#include <asio/io_context.hpp>
#include <asio/post.hpp>
#include <asio/strand.hpp>
#include <chrono>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_manager/links/back_end/back_end_interface.hpp"
#include "support/loopback.hpp"

namespace axon::test {

/// The Entity Manager's end of the link to a robot application, for tests of whole applications: sends what
/// the test tells it, and remembers what the application says. Threads: any may call; the link has one of its
/// own. Owns the link; the destructor closes it.
class RobotManager : public entity_manager::BackEndEvents {
  public:
    /// `Patient`: watchdogs of two seconds, where they are not what is tested and the machine may be slow.
    /// `Strict`: those of the product, and busy all the time.
    enum class Watchdogs { Patient, Strict };
    using Value = std::variant<std::int64_t, double, std::string, bool>;  // as axon::Value
    template <class T>
    using Parameters = std::vector<std::pair<std::string, T>>;

    explicit RobotManager(const std::string& application, Watchdogs watchdogs = Watchdogs::Patient)
        : strand_(asio::make_strand(context_)) {
        entity_manager::BackEndSettings settings;
        settings.application = application;
        settings.where.address = loopbackAddress();
        settings.manager = "test";
        const bool strict = watchdogs == Watchdogs::Strict;
        if (!strict) settings.watchdog_busy = settings.watchdog_idle = std::chrono::seconds{2};
        link_ = std::make_unique<entity_manager::BackEndInterface>(strand_, settings, stop_generations_,
                                                                   clock_, random_, *this);
        thread_ = std::thread([this] { context_.run(); });
        asio::post(strand_, [this, strict] {
            link_->start();
            if (strict) link_->setBusy(true);
        });
    }
    ~RobotManager() override { die(); }
    void die() {
        if (!thread_.joinable()) return;
        thaw();
        asio::post(strand_, [this] { link_->close(); });
        work_.reset();
        thread_.join();
    }
    /// Its sockets stay open, and it says nothing until die(). Once.
    void freeze() {
        asio::post(strand_, [frozen = frozen_.get_future().share()] { frozen.wait(); });
        is_frozen_ = true;
    }

    std::uint32_t stop() {
        const auto generation = stop_generations_.raise();
        link_->stop(generation, StopCause::Requested);
        return generation;
    }
    /// The id of the task.
    std::string dispatch(const std::string& service, const Parameters<double>& parameters) {
        return dispatchAny(service, parameters, {});
    }
    std::string dispatchValues(const std::string& service, const Parameters<Value>& parameters) {
        return dispatchAny(service, parameters, {});
    }
    /// With texts as parameters, and resources by their names.
    std::string dispatchTexts(const std::string& service, const Parameters<std::string>& parameters,
                              const Parameters<std::string>& resources = {}) {
        return dispatchAny(service, parameters, resources);
    }
    /// A CONFIG parameter of this service is set while a task of it runs, or none does.
    void configure(const std::string& service, const std::string& name, double value,
                   const std::string& task = {}) {
        proto::EmToEi message;
        auto& one = *message.mutable_configuration()->add_params();
        one.set_service(service);
        one.mutable_param()->set_name(name);
        one.mutable_param()->add_values()->set_dbl(value);
        message.mutable_configuration()->set_task_id(task);
        send(message);
    }
    void pause(const std::string& id, bool resume) {
        proto::EmToEi message;
        message.mutable_pause()->set_task_id(id);
        message.mutable_pause()->set_resume(resume);
        message.mutable_pause()->set_stop_generation(stop_generations_.generation());
        send(message);
    }
    void cancel(const std::string& id) {
        proto::EmToEi message;
        message.mutable_cancel()->set_task_id(id);
        send(message);
    }
    void watch(const std::string& stream) {
        proto::EmToEi message;
        message.mutable_stream()->set_stream(stream);
        message.mutable_stream()->set_on(true);
        send(message);
    }

    /// Of every task; on the strand, as the Entity Manager dispatches what waits in its queue. Set it before
    /// there are tasks.
    std::function<void(const proto::TaskEvent&)> on_end;

    std::optional<proto::TaskEvent> end(const std::string& id) {
        const std::lock_guard lock(mutex_);
        const auto found = std::find_if(events_.begin(), events_.end(), [&](const auto& event) {
            return event.task_id() == id && event.state() >= proto::TASK_SUCCEEDED;
        });
        return found == events_.end() ? std::nullopt : std::optional(*found);
    }
    double progress(const std::string& id) {
        const std::lock_guard lock(mutex_);
        double progress = 0;
        for (const auto& event : events_)
            progress = event.task_id() == id ? std::max(progress, event.progress()) : progress;
        return progress;
    }
    /// FEEDBACK or OUTPUT of that name as it was told last while the task ran.
    std::optional<proto::Param> told(const std::string& id, const std::string& name) {
        const std::lock_guard lock(mutex_);
        std::optional<proto::Param> last;
        for (const auto& event : events_) {
            if (event.task_id() != id || event.state() >= proto::TASK_SUCCEEDED) continue;
            for (const auto& result : event.results())
                if (result.name() == name) last = result;
        }
        return last;
    }
    /// The last of that name.
    std::string textResult(const std::string& id, const std::string& name) {
        const std::lock_guard lock(mutex_);
        std::string text;
        for (const auto& event : events_) {
            if (event.task_id() != id) continue;
            for (const auto& result : event.results()) {
                if (result.name() == name) text = result.values(0).str();
            }
        }
        return text;
    }
    /// The refusal of a task request, once it was answered.
    std::optional<proto::Refusal> answer(const std::string& id) {
        const std::lock_guard lock(mutex_);
        for (const auto& answer : answers_) {
            if (answer.task_id() == id) return answer.refusal();
        }
        return std::nullopt;
    }
    /// Why the newest task was refused or ended, for messages of a test.
    std::string lastWords() {
        const std::lock_guard lock(mutex_);
        return last_words_;
    }
    bool active(const std::string& service) {
        const std::lock_guard lock(mutex_);
        return active_[service].active();
    }
    std::string inactiveReason(const std::string& service) {
        const std::lock_guard lock(mutex_);
        return active_[service].reason();
    }
    bool reached(std::uint32_t generation, proto::StopReceipt::Stage stage) {
        const std::lock_guard lock(mutex_);
        return std::any_of(stops_.begin(), stops_.end(), [&](const auto& done) {
            return done.stop_generation() == generation && done.stage() == stage;
        });
    }
    int samples(const std::string& stream) {
        const std::lock_guard lock(mutex_);
        return samples_[stream];
    }

    // BackEndEvents, on the strand.
    void onLinkUp() override {}
    void onLinkDown(const std::string& /*reason*/, entity_manager::LinkEnd /*end*/) override {}
    void onLinkMessage(const proto::EiToEm& message) override {
        if (on_end && message.has_task() && message.task().event().state() >= proto::TASK_SUCCEEDED)
            on_end(message.task().event());
        const std::lock_guard lock(mutex_);
        if (message.has_task()) {
            events_.push_back(message.task().event());
            last_words_ = message.task().event().reason().message();
        }
        if (message.has_task_answer()) {
            answers_.push_back(message.task_answer());
            last_words_ = message.task_answer().refusal().message();
        }
        if (message.has_active()) active_[message.active().service()] = message.active();
        if (message.has_stop_done()) stops_.push_back(message.stop_done());
        if (message.has_sample()) ++samples_[message.sample().stream()];
    }

  private:
    template <class T>
    std::string dispatchAny(const std::string& service, const Parameters<T>& parameters,
                            const Parameters<std::string>& resources) {
        proto::EmToEi message;
        auto& task = *message.mutable_task();
        task.set_task_id(Id128::random(random_).bytes());
        task.set_service(service);
        task.set_stop_generation(stop_generations_.generation());
        for (const auto& [name, value] : parameters) {
            auto& parameter = *task.add_params();
            parameter.set_name(name);
            write(*parameter.add_values(), Value(value));
        }
        for (const auto& [name, url] : resources) {
            auto& resource = *task.add_resources();
            resource.set_name(name);
            resource.set_url(url);
        }
        send(message);
        return task.task_id();
    }
    static void write(proto::Value& out, const Value& value) {
        if (const auto* text = std::get_if<std::string>(&value)) out.set_str(*text);
        if (const auto* number = std::get_if<double>(&value)) out.set_dbl(*number);
        if (const auto* flag = std::get_if<bool>(&value)) out.set_bool_(*flag);
        if (const auto* whole = std::get_if<std::int64_t>(&value)) out.set_int_(*whole);
    }
    void send(const proto::EmToEi& message) {
        asio::post(strand_, [this, message] { link_->send(message); });
    }
    void thaw() {
        if (is_frozen_) frozen_.set_value();
        is_frozen_ = false;
    }

    entity_manager::StopGenerations stop_generations_;
    SteadyClock clock_;
    SystemRandom random_;
    asio::io_context context_;
    asio::executor_work_guard<asio::io_context::executor_type> work_{context_.get_executor()};
    asio::strand<asio::io_context::executor_type> strand_;
    std::unique_ptr<entity_manager::BackEndInterface> link_;
    std::promise<void> frozen_;
    bool is_frozen_ = false;

    std::mutex mutex_;  // guards what follows, except the thread
    std::vector<proto::TaskEvent> events_;
    std::vector<proto::TaskAnswer> answers_;
    std::vector<proto::StopDone> stops_;
    std::map<std::string, proto::ServiceActive> active_;
    std::map<std::string, int> samples_;
    std::string last_words_;

    std::thread thread_;
};

}  // namespace axon::test
