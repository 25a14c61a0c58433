// SPDX-License-Identifier: GPL-2.0-or-later
#include "testing/client/actor.hpp"

#include <algorithm>
#include <asio/post.hpp>
#include <future>

#include "client/core/content.hpp"
#include "messages/values.hpp"

namespace axon::testing {

namespace {

using entity_manager::BackEndEvents;
using entity_manager::EntityManager;
using entity_manager::LinkEnd;
using Kind = Failure::Kind;

Duration lasting(client::Seconds time) {
    return std::chrono::duration_cast<Duration>(std::max(time, client::Seconds{0}));
}

std::string named(std::string_view text) {
    return "'" + std::string(text) + "'";
}

/// The end of an Entity Manager's back end: passes on to the actor, and nothing while no link is open.
class Port final : public entity_manager::BackEndPort {
  public:
    Port(std::shared_ptr<Actor> actor, std::shared_ptr<Wire> wire)
        : actor_(std::move(actor)), wire_(std::move(wire)) {}
    bool send(const proto::EmToEi& message) override {
        if (wire_->open) actor_->heard(message);
        return true;
    }
    void stop(std::uint32_t generation, StopCause cause) override {
        if (wire_->open) actor_->stopped(generation, cause);
    }
    void setBusy(bool) override {}

  private:
    const std::shared_ptr<Actor> actor_;
    const std::shared_ptr<Wire> wire_;
};

proto::EiToEm sampleOf(const std::string& stream, std::uint64_t sequence, const std::vector<double>& numbers,
                       const std::string& units) {
    proto::EiToEm message;
    auto& sample = *message.mutable_sample();
    sample.set_stream(stream);
    sample.set_sequence(sequence);
    sample.set_taken_at_us(toMicroseconds(SteadyClock().now()));
    if (numbers.size() == 1) {
        sample.mutable_scalar()->set_value(numbers.front());
        sample.mutable_scalar()->set_units(units);
    } else {
        for (const auto number : numbers) sample.mutable_vector()->add_values(number);
        sample.mutable_vector()->set_units(units);
    }
    return message;
}

}  // namespace

Actor::Actor(ActorProfiles profiles, std::shared_ptr<Agenda> agenda, std::chrono::milliseconds patience)
    : profiles_(std::move(profiles)),
      name_(profiles_.basic_read.name()),
      agenda_(std::move(agenda)),
      patience_(patience) {}

EntityManager::BackEndFactory Actor::backEnd() {
    return [self = shared_from_this()](const EntityManager::Strand& strand,
                                       const entity_manager::StopGenerations&, const Clock&,
                                       BackEndEvents& events) {
        auto wire = std::make_shared<Wire>(strand, events);
        {
            const std::lock_guard lock(self->wire_mutex_);
            self->wire_ = wire;
        }
        return EntityManager::BackEnd{std::make_unique<Port>(self, wire), [self] { self->link(); },
                                      [wire] { wire->open = false; }};
    };
}

void Actor::unwire() {
    const std::lock_guard lock(wire_mutex_);
    wire_.reset();
}

bool Actor::onStrand(std::function<void(Wire&)> use) {
    const std::lock_guard lock(wire_mutex_);
    if (!wire_) return false;
    asio::post(wire_->strand, [at = wire_, use = std::move(use)] { use(*at); });
    return true;
}

void Actor::settle() {
    auto done = std::make_shared<std::promise<void>>();
    auto settled = done->get_future();
    if (onStrand([done](Wire&) { done->set_value(); })) settled.wait();
}

void Actor::link() {
    onStrand([self = shared_from_this()](Wire& at) {
        if (at.open.exchange(true)) return;
        at.events.onLinkUp();
        for (const bool services : {false, true}) {
            proto::EiToEm message;
            auto& upload = *message.mutable_profile();
            upload.set_services(services);
            upload.set_file_name(services ? self->profiles_.services_name : self->profiles_.basic_name);
            upload.set_xml(services ? self->profiles_.services : self->profiles_.basic);
            upload.set_folder("/memory");
            at.events.onLinkMessage(message);
        }
    });
}

void Actor::loseLink(const std::string& reason) {
    {
        const std::lock_guard lock(mutex_);
        for (const auto& [id, task] : running_) agenda_->cancel(task.planned);
        running_.clear();
        owed_.reset();
    }
    onStrand([reason](Wire& at) {
        if (at.open.exchange(false)) at.events.onLinkDown(reason, LinkEnd::Closed);
    });
}

void Actor::say(proto::EiToEm message) {
    onStrand([message = std::move(message)](Wire& at) {
        if (at.open) at.events.onLinkMessage(message);
    });
}

void Actor::sayAll(const Outbox& out) {
    for (const auto& message : out) say(message);
}

const proto::Service& Actor::service(std::string_view name) const {
    const auto at = findServiceIndex(profiles_.services_read, name);
    if (!at) throw Failure(Kind::Misuse, "a service of " + named(name_), at.refusal().message);
    return profiles_.services_read.services(at.value());
}

void Actor::on(std::string_view service, std::function<Script(const Request&)> script) {
    const auto& its = this->service(service);
    const std::lock_guard lock(mutex_);
    scripts_[its.name()] = std::move(script);
}

void Actor::denyParameter(std::string_view service, std::string_view parameter, std::string reason) {
    const auto& its = this->service(service);
    const auto at = findParamIndex(its, parameter);
    if (!at) throw Failure(Kind::Misuse, "a parameter of " + named(service), at.refusal().message);
    const std::lock_guard lock(mutex_);
    denied_[{its.name(), its.params(at.value()).name()}] = std::move(reason);
}

void Actor::reportStandstill(client::Seconds after) {
    const std::lock_guard lock(mutex_);
    standstill_after_ = lasting(after);
}

void Actor::confirmStops(bool confirm) {
    const Agenda::Hold hold(*agenda_);
    Outbox out;
    {
        const std::lock_guard lock(mutex_);
        confirms_ = confirm;
        if (confirm && owed_) acknowledge(*std::exchange(owed_, {}), out);
    }
    sayAll(out);
}

void Actor::sample(std::string stream, std::vector<double> numbers, std::string units) {
    std::uint64_t sequence = 0;
    {
        const std::lock_guard lock(mutex_);
        sequence = ++samples_[stream];
    }
    say(sampleOf(stream, sequence, numbers, units));
}

void Actor::heard(const proto::EmToEi& message) {
    if (message.has_task()) return dispatched(message.task());
    const Agenda::Hold hold(*agenda_);
    Outbox out;
    switch (message.body_case()) {
        case proto::EmToEi::kParam: {
            const auto& asked = message.param();
            proto::EiToEm reply;
            auto& answer = *reply.mutable_answer();
            answer.set_request(asked.request());
            const std::lock_guard lock(mutex_);
            if (const auto why = denial(asked.service(), asked.param())) {
                answer.mutable_refusal()->set_code(proto::DENIED);
                answer.mutable_refusal()->set_message(*why);
            }
            out.push_back(std::move(reply));
            break;
        }
        case proto::EmToEi::kResource: {
            proto::EiToEm reply;
            reply.mutable_answer()->set_request(message.resource().request());
            out.push_back(std::move(reply));
            break;
        }
        case proto::EmToEi::kCancel: {
            const std::lock_guard lock(mutex_);
            end(message.cancel().task_id(), proto::TASK_CANCELLED, {}, out);
            break;
        }
        case proto::EmToEi::kPause: {
            const std::lock_guard lock(mutex_);
            pause(message.pause(), out);
            break;
        }
        case proto::EmToEi::kText: {
            const std::lock_guard lock(mutex_);
            texts_.push_back(message.text().text());
            break;
        }
        case proto::EmToEi::kRaw: {
            const std::lock_guard lock(mutex_);
            for (const auto& block : message.raw().data()) raws_.push_back(block);
            break;
        }
        default:
            return;  // nothing that a script looks at
    }
    changed_.notify_all();
    sayAll(out);
}

std::optional<std::string> Actor::denial(const std::string& service, const proto::Param& param) const {
    const auto found = denied_.find({service, param.name()});
    return found == denied_.end() ? std::nullopt : std::optional(found->second);
}

void Actor::dispatched(const proto::TaskDispatch& task) {
    Request request{task.service(), {}};
    for (const auto& param : task.params()) {
        auto& values = request.parameters[param.name()];
        for (const auto& value : param.values()) values.push_back(client::fromProto(value));
    }
    std::function<Script(const Request&)> write;
    std::optional<std::string> why;
    {
        const std::lock_guard lock(mutex_);
        if (const auto found = scripts_.find(task.service()); found != scripts_.end()) write = found->second;
        for (const auto& given : task.given())
            if (!why) why = denial(given.service(), given.param());
    }
    // A script that throws is one that fails, as a handler that throws.
    Script script;
    try {
        if (write && !why) script = write(request);
    } catch (const std::exception& error) {
        script = Script().fail(error.what());
    }
    if (script.denied_) why = script.reason_;
    const Agenda::Hold hold(*agenda_);
    Outbox out;
    {
        const std::lock_guard lock(mutex_);
        requests_.push_back(request);
        auto& answer = *out.emplace_back().mutable_task_answer();
        answer.set_task_id(task.task_id());
        if (task.stop_generation() < generation_) {
            answer.mutable_refusal()->set_code(proto::OLD_GENERATION);
            answer.mutable_refusal()->set_message("a stop has come since this task was requested");
        } else if (why) {
            answer.mutable_refusal()->set_code(proto::DENIED);
            answer.mutable_refusal()->set_message(*why);
        } else {
            script.succeed();  // counts if nothing before it is an end
            auto& running = running_[task.task_id()];
            running = Running{std::move(request), std::move(script.steps_), 0, 0, {}, {}};
            if (running.steps.front().after > client::Seconds{0})
                plan(task.task_id(), running, lasting(running.steps.front().after));
            else
                play(task.task_id(), running, out);
        }
    }
    changed_.notify_all();
    sayAll(out);
}

void Actor::plan(const std::string& id, Running& task, Duration in) {
    task.due = agenda_->now() + in;
    task.planned = agenda_->in(in, [weak = weak_from_this(), id] {
        if (const auto self = weak.lock()) self->happen(id);
    });
}

void Actor::happen(const std::string& id) {
    const Agenda::Hold hold(*agenda_);
    Outbox out;
    {
        const std::lock_guard lock(mutex_);
        const auto found = running_.find(id);
        if (found == running_.end() || found->second.paused) return;
        found->second.planned = 0;
        play(id, found->second, out);
    }
    sayAll(out);
}

/// The next step, whose time has come, and those that follow at the same time. `task` may be gone afterwards.
void Actor::play(const std::string& id, Running& task, Outbox& out) {
    do {
        const auto step = task.steps[task.next++];
        proto::EiToEm message;
        auto& event = *message.mutable_task()->mutable_event();
        event.set_task_id(id);
        event.set_service(task.request.service);
        event.set_state(proto::TASK_RUNNING);
        event.set_progress(-1);
        switch (step.kind) {
            case Script::Step::Kind::Progress:
                event.set_progress(step.numbers.front());
                break;
            case Script::Step::Kind::Feedback:
                event.set_feedback(step.text);
                break;
            case Script::Step::Kind::Result: {
                auto& result = *event.add_results();
                result.set_name(step.text);
                for (const auto& value : step.values) *result.add_values() = client::toProto(value);
                const auto& its = service(task.request.service);
                if (const auto at = findParamIndex(its, step.text))
                    result.set_units(its.params(at.value()).units());
                break;
            }
            case Script::Step::Kind::Sample:
                message = sampleOf(step.text, ++samples_[step.text], step.numbers, step.units);
                break;
            case Script::Step::Kind::Succeed:
                return end(id, proto::TASK_SUCCEEDED, {}, out);
            case Script::Step::Kind::Fail:
                return end(id, proto::TASK_FAILED, {RefusalCode::Failed, step.text, {}}, out);
            case Script::Step::Kind::RobotLost:
                return end(id, proto::TASK_FAILED, {RefusalCode::RobotLost, step.text, {}}, out);
            case Script::Step::Kind::Never:
                return;
        }
        out.push_back(std::move(message));
    } while (task.steps[task.next].after <= client::Seconds{0});
    plan(id, task, lasting(task.steps[task.next].after));
}

void Actor::end(const std::string& id, proto::TaskState state, const Refusal& reason, Outbox& out) {
    const auto found = running_.find(id);
    if (found == running_.end()) return;
    agenda_->cancel(found->second.planned);
    auto& event = *out.emplace_back().mutable_task()->mutable_event();
    event.set_task_id(id);
    event.set_service(found->second.request.service);
    event.set_state(state);
    event.set_progress(-1);
    if (!reason.ok()) *event.mutable_reason() = toProto(reason);
    running_.erase(found);
}

void Actor::pause(const proto::PauseTask& pause, Outbox& out) {
    const auto found = running_.find(pause.task_id());
    if (found == running_.end() || found->second.paused.has_value() != pause.resume()) return;
    auto& task = found->second;
    auto& event = *out.emplace_back().mutable_task()->mutable_event();
    event.set_task_id(found->first);
    event.set_service(task.request.service);
    event.set_state(pause.resume() ? proto::TASK_RUNNING : proto::TASK_PAUSED);
    event.set_progress(-1);
    if (pause.resume()) {
        const auto left = *std::exchange(task.paused, {});
        if (left >= Duration::zero()) plan(found->first, task, left);
    } else {
        task.paused = task.planned != 0 ? task.due - agenda_->now() : Duration{-1};
        agenda_->cancel(std::exchange(task.planned, 0));
    }
}

void Actor::stopped(std::uint32_t generation, StopCause cause) {
    const Agenda::Hold hold(*agenda_);
    Outbox out;
    if (cause == StopCause::Drill) {
        out.emplace_back().mutable_stop_done()->set_drill(generation);
        return sayAll(out);
    }
    {
        const std::lock_guard lock(mutex_);
        if (generation > generation_) {
            generation_ = generation;
            const auto& name = proto::StopCause_Name(static_cast<proto::StopCause>(cause));
            stops_.push_back(name.substr(name.find('_') + 1));
        }
        if (confirms_)
            acknowledge(generation, out);
        else
            owed_ = std::max(generation, owed_.value_or(0));
        while (!running_.empty()) end(std::string(running_.begin()->first), proto::TASK_STOPPED, {}, out);
    }
    changed_.notify_all();
    sayAll(out);
}

void Actor::acknowledge(std::uint32_t generation, Outbox& out) {
    auto& done = *out.emplace_back().mutable_stop_done();
    done.set_stop_generation(generation);
    done.set_stage(proto::StopReceipt::CALLBACK_RETURNED);
    done.set_standstill_follows(standstill_after_.has_value());
    if (!standstill_after_) return;
    agenda_->in(*standstill_after_, [weak = weak_from_this(), generation] {
        proto::EiToEm message;
        message.mutable_stop_done()->set_stop_generation(generation);
        message.mutable_stop_done()->set_stage(proto::StopReceipt::STANDSTILL);
        if (const auto self = weak.lock()) self->say(std::move(message));
    });
}

/// The next one from `at` on that is wanted; `at` is behind it then.
template <class T>
T Actor::next(std::vector<T>& all, std::size_t& at, const std::string& expected,
              const std::function<bool(const T&)>& wanted) {
    std::unique_lock lock(mutex_);
    const auto find = [&] {
        while (at < all.size() && wanted && !wanted(all[at])) ++at;
        return at < all.size();
    };
    if (!changed_.wait_for(lock, patience_, find))
        throw Failure(Kind::NotInTime,
                      expected + " within " + std::to_string(patience_.count()) + " ms of real time",
                      "it did not come; there were " + std::to_string(all.size()) + " of its kind so far");
    return all[at++];
}

Request Actor::expectTask(std::string_view service) {
    const auto wanted = service.empty() ? std::string() : this->service(service).name();
    std::size_t* at = nullptr;
    {
        const std::lock_guard lock(mutex_);
        at = &requests_seen_[wanted];
    }
    return next<Request>(
        requests_, *at,
        "a task of " + named(name_) + (wanted.empty() ? std::string() : " for service " + named(wanted)),
        [&](const Request& request) { return wanted.empty() || request.service == wanted; });
}
std::string Actor::expectStop() {
    return next(stops_, stops_seen_, "a stop of " + named(name_));
}
std::string Actor::expectText() {
    return next(texts_, texts_seen_, "a text for " + named(name_));
}
std::string Actor::expectRaw() {
    return next(raws_, raws_seen_, "raw data for " + named(name_));
}

}  // namespace axon::testing
