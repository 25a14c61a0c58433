// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "common/refusal.hpp"
#include "entity_interfacer/axon/entity_interfacer.hpp"
#include "entity_interfacer/link.hpp"
#include "entity_interfacer/stop_level.hpp"

namespace axon::proto {
class Param;
class Refusal;
class TaskDispatch;
class TaskEvent;
}  // namespace axon::proto

namespace axon {

/// What the copies of a Task share. States: waiting for the stop level to settle, running, paused, ended.
/// Threads: any; identity, parameters and resources are constant after construction, the rest is atomic or
/// under a mutex.
class Task::Running {
  public:
    Running(const proto::TaskDispatch& dispatch, std::shared_ptr<Link> link, StopLevel& level);

    const std::string id_bytes;
    const std::string id;
    const std::string service;
    const std::uint32_t generation;
    const std::uint64_t epoch;
    const TimePoint start_by;  ///< a handler does not begin later
    std::vector<Parameter> parameters;
    std::vector<std::pair<std::string, std::string>> resources;  // name, path

    /// As it is now; nothing where it has no value.
    std::optional<Parameter> find(std::string_view name) const;
    /// Of a CONFIG parameter, from now on.
    void configure(const Parameter& parameter);

    bool stopRequested() const;
    StopSignal::Cause stopCause() const;
    void cancel();
    bool paused() const { return paused_.load(std::memory_order_acquire); }
    void setPaused(bool paused);
    bool waitWhilePaused();
    bool waitFor(std::chrono::nanoseconds time);
    /// Until the stop before this task is through and the signal lane has caught up with its generation. The
    /// refusal that the task earns otherwise; nothing when it may start.
    std::optional<Refusal> waitForStart();

    void progress(double part);
    void feedback(std::string_view text);
    void result(std::string_view name, std::vector<Value> values, std::string_view units);
    void answer(const Refusal& refusal);
    /// The application's verdict, the first of which counts; `code` is Ok for a success. handlerReturned() or
    /// handlerThrew() sends it: until then the handler has the device.
    void end(RefusalCode code, std::string_view reason);
    /// The handler has returned: sends the verdict, or what its return means without one.
    void handlerReturned();
    /// An exception has left the handler: sends the failure that it had reported, or else this one.
    void handlerThrew(std::string_view what);

  private:
    struct Verdict {
        RefusalCode code;
        std::string reason;
    };
    /// Sends the verdict that was given, or else this one.
    void conclude(Verdict otherwise);
    void reportLocked(proto::TaskEvent& event);

    const std::shared_ptr<Link> link_;
    StopLevel& level_;
    std::atomic<bool> cancelled_{false};
    std::atomic<bool> paused_{false};
    mutable std::mutex configured_mutex_;  // held to copy a parameter
    std::vector<Parameter> configured_;    // since the task began; guarded by configured_mutex_
    std::mutex mutex_;
    bool ended_ = false;  // a verdict was given, or the task was refused; these six guarded by mutex_
    std::optional<Verdict> verdict_;  // waits for the handler's return
    bool answered_ = false;
    double progress_ = -1;
    std::string feedback_;
    struct Output {
        std::string name;
        std::vector<Value> values;
        std::string units;
    };
    std::vector<Output> results_;
};

Parameter fromProto(const proto::Param& param);
void toProto(const Value& value, proto::Param& param);

}  // namespace axon
