// SPDX-License-Identifier: MIT
#include "entity_interfacer/running_task.hpp"

#include <axon/link.pb.h>

#include <algorithm>
#include <utility>

#include "common/ids.hpp"
#include "common/utf8.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;

// The signal lane repeats the generation at least every 100 ms; a second without is a broken peer.
constexpr auto kSettleTime = 1s;
constexpr std::size_t kTextMax = 64 * 1024;

std::string shortText(std::string_view text) {
    const auto valid = validUtf8(text.substr(0, kTextMax));
    return std::string(cutUtf8(valid, kTextMax));
}

std::string idText(const std::string& bytes) {
    const auto id = Id128::fromBytes(bytes);
    return id ? id->toString() : std::string{};
}

template <class Wanted>
const Wanted& valueAs(const Parameter& parameter, const char* type) {
    if (!parameter.values.empty())
        if (const auto* value = std::get_if<Wanted>(&parameter.values.front())) return *value;
    throw std::invalid_argument("parameter '" + parameter.name + "': expected a value of type " + type +
                                "; fix: correct its data type in the services profile, or the call");
}

double asNumber(const Value& value, const std::string& name) {
    if (const auto* d = std::get_if<double>(&value)) return *d;
    if (const auto* i = std::get_if<std::int64_t>(&value)) return static_cast<double>(*i);
    throw std::invalid_argument("parameter '" + name + "': expected numbers (DBL or INT)");
}

template <class Wanted>
std::vector<Wanted> valuesAs(const std::optional<Parameter>& parameter) {
    std::vector<Wanted> values;
    if (!parameter) return values;
    for (const auto& value : parameter->values) {
        const auto* wanted = std::get_if<Wanted>(&value);
        if (wanted == nullptr)
            throw std::invalid_argument("parameter '" + parameter->name +
                                        "': its values have another type; fix: call the function for the "
                                        "data type in the services profile");
        values.push_back(*wanted);
    }
    return values;
}

Parameter required(const Task::Running& task, std::string_view name) {
    auto parameter = task.find(name);
    if (parameter) return *std::move(parameter);
    throw std::invalid_argument(
        "parameter '" + std::string(name) +
        "' was not given; fix: mark it required in the services profile, or pass a fallback");
}

proto::TaskState finalState(RefusalCode code) {
    switch (code) {
        case RefusalCode::Ok:
            return proto::TASK_SUCCEEDED;
        case RefusalCode::Cancelled:
            return proto::TASK_CANCELLED;
        case RefusalCode::Stopped:
            return proto::TASK_STOPPED;
        default:
            return proto::TASK_FAILED;
    }
}

}  // namespace

Parameter fromProto(const proto::Param& param) {
    Parameter parameter{param.name(), {}, param.units()};
    for (const auto& value : param.values()) switch (value.kind_case()) {
            case proto::Value::kInt:
                parameter.values.emplace_back(static_cast<std::int64_t>(value.int_()));
                break;
            case proto::Value::kDbl:
                parameter.values.emplace_back(value.dbl());
                break;
            case proto::Value::kStr:
                parameter.values.emplace_back(value.str());
                break;
            case proto::Value::kBool:
                parameter.values.emplace_back(value.bool_());
                break;
            case proto::Value::KIND_NOT_SET:
                break;
        }
    return parameter;
}

void toProto(const Value& value, proto::Param& param) {
    auto& out = *param.add_values();
    if (const auto* i = std::get_if<std::int64_t>(&value)) out.set_int_(*i);
    if (const auto* d = std::get_if<double>(&value)) out.set_dbl(*d);
    if (const auto* s = std::get_if<std::string>(&value)) out.set_str(validUtf8(*s));
    if (const auto* b = std::get_if<bool>(&value)) out.set_bool_(*b);
}

double Parameter::number() const {
    if (values.empty()) valueAs<double>(*this, "DBL");
    return asNumber(values.front(), name);
}
std::int64_t Parameter::integer() const {
    return valueAs<std::int64_t>(*this, "INT");
}
const std::string& Parameter::text() const {
    return valueAs<std::string>(*this, "STR");
}
bool Parameter::flag() const {
    return valueAs<bool>(*this, "BOOL");
}

Task::Running::Running(const proto::TaskDispatch& dispatch, std::shared_ptr<Link> link, StopLevel& level)
    : id_bytes(dispatch.task_id()),
      id(idText(dispatch.task_id())),
      service(dispatch.service()),
      generation(dispatch.stop_generation()),
      epoch(link->epoch),
      start_by(dispatch.start_within_ms() == 0
                   ? TimePoint::max()
                   : level.clock().now() + std::chrono::milliseconds{dispatch.start_within_ms()}),
      link_(std::move(link)),
      level_(level) {
    for (const auto& param : dispatch.params()) parameters.push_back(fromProto(param));
    for (const auto& resource : dispatch.resources()) resources.emplace_back(resource.name(), resource.url());
}

std::optional<Parameter> Task::Running::find(std::string_view name) const {
    const auto in = [name](const std::vector<Parameter>& some) -> std::optional<Parameter> {
        const auto found = std::find_if(some.begin(), some.end(), [name](const Parameter& p) {
            return p.name == name && !p.values.empty();
        });
        return found == some.end() ? std::nullopt : std::optional(*found);
    };
    {
        const std::lock_guard lock(configured_mutex_);
        if (auto newest = in(configured_)) return newest;
    }
    return in(parameters);
}

void Task::Running::configure(const Parameter& parameter) {
    const std::lock_guard lock(configured_mutex_);
    const auto known = std::find_if(configured_.begin(), configured_.end(),
                                    [&](const Parameter& p) { return p.name == parameter.name; });
    (known == configured_.end() ? configured_.emplace_back() : *known) = parameter;
}

bool Task::Running::stopRequested() const {
    return link_->lost() || level_.stopped() > generation || level_.epoch() > epoch ||
           cancelled_.load(std::memory_order_acquire);
}

StopSignal::Cause Task::Running::stopCause() const {
    if (level_.stopped() > generation || level_.epoch() > epoch)
        return static_cast<StopSignal::Cause>(level_.cause());
    if (link_->lost()) return StopSignal::Cause::LinkLost;
    return cancelled_ ? StopSignal::Cause::Cancel : StopSignal::Cause::Unspecified;
}

void Task::Running::cancel() {
    cancelled_.store(true, std::memory_order_release);
    level_.notify();
}

void Task::Running::setPaused(bool paused) {
    paused_.store(paused, std::memory_order_release);
    level_.notify();
    const std::lock_guard lock(mutex_);
    if (ended_ || !answered_) return;
    proto::TaskEvent event;
    event.set_state(paused ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    reportLocked(event);
}

bool Task::Running::waitWhilePaused() {
    level_.wait([this] { return !paused() || stopRequested(); });
    return !stopRequested();
}

bool Task::Running::waitFor(std::chrono::nanoseconds time) {
    return !level_.waitUntil(level_.clock().now() + time, [this] { return stopRequested(); });
}

std::optional<Refusal> Task::Running::waitForStart() {
    level_.waitUntil(std::min(start_by, level_.clock().now() + kSettleTime), [this] {
        return stopRequested() || (level_.settled() && level_.stopped() >= generation);
    });
    if (level_.stopped() > generation)
        return Refusal{RefusalCode::OldGeneration,
                       "a stop has come since this task was requested; fix: request it again",
                       {}};
    if (cancelled_) return Refusal{RefusalCode::Cancelled, "cancelled before it began", {}};
    if (stopRequested()) return Refusal{RefusalCode::Stopped, "the robot application has stopped itself", {}};
    if (level_.clock().now() >= start_by)
        return Refusal{RefusalCode::Expired,
                       "its not_after passed before the robot application could begin; it was not started",
                       {}};
    if (!level_.settled())
        return Refusal{RefusalCode::TimedOut,
                       "the robot application's stop callback has not returned; fix: make it return at once",
                       {}};
    if (level_.stopped() < generation)
        return Refusal{
            RefusalCode::WrongState, "the signal lane has not announced this task's stop generation", {}};
    return std::nullopt;
}

void Task::Running::progress(double part) {
    const std::lock_guard lock(mutex_);
    if (ended_) return;
    progress_ = std::clamp(part, 0.0, 1.0);
    proto::TaskEvent event;
    event.set_state(paused() ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    reportLocked(event);
}

void Task::Running::feedback(std::string_view text) {
    const std::lock_guard lock(mutex_);
    if (ended_) return;
    feedback_ = shortText(text);
    proto::TaskEvent event;
    event.set_state(paused() ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    reportLocked(event);
}

void Task::Running::result(std::string_view name, std::vector<Value> values, std::string_view units) {
    const std::lock_guard lock(mutex_);
    if (ended_) return;
    const auto valid = validUtf8(name);
    const auto known =
        std::find_if(results_.begin(), results_.end(), [&](const Output& o) { return o.name == valid; });
    auto& output = known != results_.end() ? *known : results_.emplace_back();
    output = {valid, std::move(values), validUtf8(units)};
}

void Task::Running::answer(const Refusal& refusal) {
    const std::lock_guard lock(mutex_);
    answered_ = true;
    if (!refusal.ok()) ended_ = true;
    proto::EiToEm message;
    auto& answer = *message.mutable_task_answer();
    answer.set_task_id(id_bytes);
    answer.mutable_refusal()->set_code(static_cast<proto::RefusalCode>(refusal.code));
    answer.mutable_refusal()->set_message(validUtf8(refusal.message));
    link_->sendData(message, Link::Kind::Control);
}

void Task::Running::end(RefusalCode code, std::string_view reason) {
    const std::lock_guard lock(mutex_);
    if (std::exchange(ended_, true)) return;
    verdict_ = Verdict{code, std::string(reason)};
}

void Task::Running::handlerReturned() {
    if (!stopRequested()) return conclude({RefusalCode::Ok, {}});
    const auto cause = stopCause();
    if (cause == StopSignal::Cause::Cancel)
        return conclude({RefusalCode::Cancelled, "the handler ended because the task was cancelled"});
    conclude({RefusalCode::Stopped, std::string("the handler ended after a stop: ") + toString(cause)});
}

void Task::Running::handlerThrew(std::string_view what) {
    {
        const std::lock_guard lock(mutex_);
        if (verdict_ && verdict_->code == RefusalCode::Ok) verdict_.reset();
    }
    conclude({RefusalCode::Failed, std::string(what)});
}

void Task::Running::conclude(Verdict otherwise) {
    const std::lock_guard lock(mutex_);
    ended_ = true;
    const auto verdict = verdict_.value_or(std::move(otherwise));
    proto::TaskEvent event;
    event.set_state(finalState(verdict.code));
    if (verdict.code == RefusalCode::Ok) {
        progress_ = 1;
    } else {
        event.mutable_reason()->set_code(static_cast<proto::RefusalCode>(verdict.code));
        event.mutable_reason()->set_message(shortText(verdict.reason));
    }
    reportLocked(event);
}

void Task::Running::reportLocked(proto::TaskEvent& event) {
    event.set_task_id(id_bytes);
    event.set_service(service);
    event.set_progress(progress_);
    event.set_feedback(feedback_);
    for (const auto& output : results_) {
        auto& param = *event.add_results();
        param.set_name(output.name);
        param.set_units(output.units);
        for (const auto& value : output.values) toProto(value, param);
    }
    proto::EiToEm message;
    message.mutable_task()->mutable_event()->Swap(&event);
    if (link_->sendData(message, Link::Kind::Control)) return;
    // Larger than a frame: the verdict must arrive, so it goes without the results.
    auto& small = *message.mutable_task()->mutable_event();
    small.clear_results();
    small.set_feedback("results dropped: together they exceed 1 MiB");
    link_->sendData(message, Link::Kind::Control);
}

// Task, the face of it.
const std::string& Task::id() const {
    return running_->id;
}
const std::string& Task::service() const {
    return running_->service;
}
bool Task::has(std::string_view name) const {
    return running_->find(name).has_value();
}
double Task::number(std::string_view name) const {
    return required(*running_, name).number();
}
std::int64_t Task::integer(std::string_view name) const {
    return required(*running_, name).integer();
}
std::string Task::text(std::string_view name) const {
    return required(*running_, name).text();
}
bool Task::flag(std::string_view name) const {
    return required(*running_, name).flag();
}
double Task::number(std::string_view name, double fallback) const {
    const auto parameter = running_->find(name);
    return parameter ? parameter->number() : fallback;
}
std::int64_t Task::integer(std::string_view name, std::int64_t fallback) const {
    const auto parameter = running_->find(name);
    return parameter ? parameter->integer() : fallback;
}
std::string Task::text(std::string_view name, std::string_view fallback) const {
    const auto parameter = running_->find(name);
    return parameter ? parameter->text() : std::string(fallback);
}
bool Task::flag(std::string_view name, bool fallback) const {
    const auto parameter = running_->find(name);
    return parameter ? parameter->flag() : fallback;
}

std::vector<double> Task::numbers(std::string_view name) const {
    std::vector<double> values;
    if (const auto parameter = running_->find(name))
        for (const auto& value : parameter->values) values.push_back(asNumber(value, parameter->name));
    return values;
}
std::vector<std::int64_t> Task::integers(std::string_view name) const {
    return valuesAs<std::int64_t>(running_->find(name));
}
std::vector<std::string> Task::texts(std::string_view name) const {
    return valuesAs<std::string>(running_->find(name));
}
std::vector<bool> Task::flags(std::string_view name) const {
    return valuesAs<bool>(running_->find(name));
}

std::string Task::units(std::string_view name) const {
    const auto parameter = running_->find(name);
    return parameter ? parameter->units : std::string{};
}
const std::vector<Parameter>& Task::parameters() const {
    return running_->parameters;
}
std::filesystem::path Task::resource(std::string_view name) const {
    for (const auto& [known, path] : running_->resources)
        if (known == name) return path;
    return {};
}

void Task::progress(double part) {
    running_->progress(part);
}
void Task::feedback(std::string_view text) {
    running_->feedback(text);
}
void Task::result(std::string_view name, Value value, std::string_view units) {
    running_->result(name, {std::move(value)}, units);
}
void Task::result(std::string_view name, std::vector<Value> values, std::string_view units) {
    running_->result(name, std::move(values), units);
}
bool Task::stopRequested() const {
    return running_->stopRequested();
}
StopSignal::Cause Task::stopCause() const {
    return running_->stopCause();
}
bool Task::paused() const {
    return running_->paused();
}
bool Task::waitWhilePaused() const {
    return running_->waitWhilePaused();
}
bool Task::waitFor(std::chrono::duration<double> time) const {
    constexpr std::chrono::duration<double> kYear{3e7};  // longer than any task, short enough for nanoseconds
    if (!(time < kYear)) time = kYear;
    return running_->waitFor(std::chrono::duration_cast<std::chrono::nanoseconds>(time));
}
void Task::succeed() {
    running_->end(RefusalCode::Ok, {});
}
void Task::fail(std::string_view reason) {
    running_->end(RefusalCode::Failed, reason);
}
void Task::robotLost(std::string_view reason) {
    running_->end(RefusalCode::RobotLost, reason);
}

}  // namespace axon
