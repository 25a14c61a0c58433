// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/robot_application.hpp"

#include <axon/link.pb.h>

#include <algorithm>

#include "common/refusal.hpp"
#include "simulation/entity_manager_station.hpp"
#include "simulation/laboratory.hpp"

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;

constexpr Duration kWatchdogBusy = 100ms;
constexpr Duration kWatchdogIdle = 500ms;
constexpr Duration kSettleTime = 1s;
constexpr std::size_t kRecent = 256;
constexpr std::size_t kTasks = 64;
constexpr int kFirstApplication = 200;
constexpr const char* kNames[] = {"left", "right", "arm", "cart", "crane", "probe"};

}  // namespace

/// A task between its dispatch and the return of its handler.
struct RobotApplication::Running {
    std::string id;
    std::string service;
    std::uint32_t generation = 0;
    std::uint64_t epoch = 0;
    std::uint64_t link = 0;
    bool waits = true;  ///< for the stop before it to be through
    bool moves = false;
    bool paused = false;
    bool cancelled = false;
    bool returning = false;  ///< the handler has seen that it is to end
    TimePoint ends_at;
    Duration left{};
    std::uint64_t turn = 0;  ///< of the event that ends it
};

struct RobotApplication::Link {
    std::uint64_t number = 0;
    Connection* signal = nullptr;
    Connection* data = nullptr;
    bool baseline_known = false;
    bool busy = false;
    TimePoint heard;  ///< on the world's clock
    struct Signal {
        bool stop;
        std::uint32_t generation;
        StopCause cause;
        bool busy;
    };
    std::deque<Signal> signals;  ///< not read while the stop callback runs
};

struct RobotApplication::Life {
    explicit Life(const Clock& clock) : level(clock) {}
    StopLevel level;
    std::optional<Link> link;
    int in_callback = 0;
    std::map<std::string, Running> tasks;
    std::deque<std::string> recent;
    std::uint64_t turns = 0;
};

RobotApplication::RobotApplication(Timeline& timeline, Network& network, Dice& dice, Observer& observer,
                                   std::size_t entity)
    : timeline_(timeline),
      network_(network),
      dice_(dice),
      observer_(observer),
      entity_(entity),
      process_(timeline, kFirstApplication + static_cast<int>(entity), kNames[entity % std::size(kNames)]) {}

RobotApplication::~RobotApplication() = default;

std::size_t RobotApplication::tasks() const {
    return life_ ? life_->tasks.size() : 0;
}

void RobotApplication::start() {
    process_.start();
    life_ = std::make_unique<Life>(process_);
}

void RobotApplication::kill() {
    process_.die();
    life_.reset();
    observer_.moves(entity_, false);  // what a robot without its application does is its vendor's affair
}

void RobotApplication::hello(std::uint64_t attempt, Connection& signal, Connection& data) {
    auto& life = *life_;
    if (life.link) {
        signal.send(process_, [manager = manager_, attempt] { manager->linkAnswered(attempt, 0); });
        return;
    }
    auto& link = life.link.emplace();
    link.number = ++links_;
    link.signal = &signal;
    link.data = &data;
    link.heard = timeline_.now();
    life.level.adopt(0);
    const auto closed = [this, number = link.number] {
        if (life_->link && life_->link->number == number) cut("the Entity Manager has closed the link");
    };
    signal.onClosed(process_, closed);
    data.onClosed(process_, closed);
    signal.send(process_, [manager = manager_, attempt, number = link.number] {
        manager->linkAnswered(attempt, number);
    });
    for (const bool services : {false, true}) {
        proto::EiToEm message;
        message.mutable_profile()->set_services(services);
        message.mutable_profile()->set_file_name(services ? "services.xml" : "basic.xml");
        message.mutable_profile()->set_xml(services ? kServicesProfile : basicProfile(process_.name()));
        sendData(message);
    }
    if (manager_->process().frozen()) managerFrozen();
}

void RobotApplication::managerFrozen() {
    if (!life_ || !life_->link) return;
    auto& link = *life_->link;
    const auto watchdog = link.busy ? kWatchdogBusy : kWatchdogIdle;
    link.heard = timeline_.now() - dice_.between(Duration{}, watchdog / 5);
    judgeSilence();
}

void RobotApplication::judgeSilence() {
    if (!life_ || !life_->link || !manager_->process().frozen()) return;
    auto& link = *life_->link;
    const auto watchdog = link.busy ? kWatchdogBusy : kWatchdogIdle;
    if (timeline_.now() >= link.heard + watchdog) {
        cut("the Entity Manager has been silent");
        return;
    }
    timeline_.at(link.heard + watchdog, process_, [this, number = link.number] {
        if (life_->link && life_->link->number == number) judgeSilence();
    });
}

void RobotApplication::cut(const char* why) {
    auto link = std::move(*life_->link);
    life_->link.reset();
    link.signal->close(process_);
    link.data->close(process_);
    timeline_.tell(process_.name(), [&] { return std::string("link lost: ") + why; });
    dispatchStop(StopCause::LinkLost);
}

void RobotApplication::onStop(std::uint64_t number, std::uint32_t generation, StopCause cause) {
    if (!life_->link || life_->link->number != number) return;
    life_->link->signals.push_back({true, generation, cause, false});
    // Now and then the stop thread gets the processor late.
    if (dice_.chance(0.95)) return readSignals();
    timeline_.after(dice_.between(100us, 20ms), process_, [this] { readSignals(); });
}

void RobotApplication::onBeat(std::uint64_t number, std::uint32_t generation, bool busy) {
    if (!life_->link || life_->link->number != number) return;
    life_->link->signals.push_back({false, generation, StopCause::Unspecified, busy});
    readSignals();
}

void RobotApplication::readSignals() {
    while (life_->link && life_->in_callback == 0 && !life_->link->signals.empty()) {
        auto& link = *life_->link;
        const auto signal = link.signals.front();
        link.signals.pop_front();
        link.heard = timeline_.now();
        auto& level = life_->level;
        if (signal.stop) {
            if (signal.cause == StopCause::Drill) {
                link.signal->send(process_,
                                  [manager = manager_, number = link.number, drill = signal.generation] {
                                      manager->drillDone(number, drill);
                                  });
            } else if (link.baseline_known && signal.generation <= level.stopped()) {
                acknowledge(level.stopped());
            } else {
                link.baseline_known = true;
                level.raise(signal.generation, static_cast<int>(signal.cause));
                stopCallback(signal.generation, signal.cause, true);
            }
        } else {
            link.busy = signal.busy;
            if (manager_->process().frozen()) judgeSilence();  // its last beat may shorten the watchdog
            if (!link.baseline_known) {
                link.baseline_known = true;
                level.adopt(signal.generation);
            } else if (signal.generation > level.stopped()) {
                level.raise(signal.generation, static_cast<int>(StopCause::Requested));
                stopCallback(signal.generation, StopCause::Requested, true);
            }
        }
        for (auto at = life_->tasks.begin(); at != life_->tasks.end();) begin((at++)->first);
    }
}

void RobotApplication::dispatchStop(StopCause cause) {
    life_->level.raiseEpoch(static_cast<int>(cause));
    stopCallback(life_->level.stopped(), cause, false);
}

/// The application stands when its callback is called; a little later the callback returns.
void RobotApplication::stopCallback(std::uint32_t generation, StopCause cause, bool acknowledged) {
    timeline_.tell(process_.name(), [&] {
        return std::string("stop callback, generation ") + std::to_string(generation) + " (" +
               toString(cause) + ")";
    });
    ++life_->in_callback;
    endStopped();
    const auto takes = dice_.chance(0.1) ? dice_.between(1ms, 30ms) : dice_.between(10us, 500us);
    timeline_.after(takes, process_,
                    [this, generation, acknowledged, number = life_->link ? life_->link->number : 0] {
                        auto& life = *life_;
                        if (--life.in_callback > 0)
                            return;  // the link was lost meanwhile, and the callback is called for that, too
                        life.level.settle();
                        if (acknowledged && life.link && life.link->number == number) acknowledge(generation);
                        for (auto at = life.tasks.begin(); at != life.tasks.end();) begin((at++)->first);
                        readSignals();
                    });
}

void RobotApplication::acknowledge(std::uint32_t generation) {
    life_->link->signal->send(process_, [manager = manager_, number = life_->link->number, generation] {
        manager->stopDone(number, generation);
    });
}

bool RobotApplication::stopRequested(const Running& task) const {
    const auto& level = life_->level;
    return !life_->link || life_->link->number != task.link || level.stopped() > task.generation ||
           level.epoch() > task.epoch || task.cancelled;
}

/// Every handler that is to end stands at once and returns a little later.
void RobotApplication::endStopped() {
    for (auto& [id, task] : life_->tasks) {
        if (task.returning || task.waits || !stopRequested(task)) continue;
        task.returning = true;
        task.moves = false;
        ++task.turn;
        timeline_.after(dice_.between(50us, 4ms), process_, [this, id = id] { finish(id); });
    }
    showMotion();
}

void RobotApplication::showMotion() {
    bool moves = false;
    auto alone = Duration::max();  // of tasks side by side the strictest counts
    for (const auto& [id, task] : life_->tasks) {
        if (!task.moves) continue;
        moves = true;
        alone = std::min(alone, aloneFor(task.service));
    }
    observer_.moves(entity_, moves, alone);
}

void RobotApplication::finish(const std::string& id) {
    const auto found = life_->tasks.find(id);
    if (found == life_->tasks.end()) return;
    const auto task = std::move(found->second);
    life_->tasks.erase(found);
    showMotion();
    const auto& level = life_->level;
    const bool stopped = level.stopped() > task.generation || level.epoch() > task.epoch;
    report(task,
           stopped          ? proto::TASK_STOPPED
           : task.cancelled ? proto::TASK_CANCELLED
                            : proto::TASK_SUCCEEDED,
           stopped || task.cancelled ? -1 : 1);
}

void RobotApplication::onData(std::uint64_t number, const std::string& bytes) {
    if (!life_->link || life_->link->number != number) return;
    proto::EmToEi message;
    message.ParseFromString(bytes);
    const auto& level = life_->level;
    const auto overtaken = [&](std::uint32_t generation) {
        return !level.settled() || level.stopped() > generation;
    };
    switch (message.body_case()) {
        case proto::EmToEi::kTask:
            onTask(message);
            return;
        case proto::EmToEi::kParam:
        case proto::EmToEi::kResource: {
            proto::EiToEm reply;
            reply.mutable_answer()->set_request(message.has_param() ? message.param().request()
                                                                    : message.resource().request());
            if (message.has_param() && overtaken(message.param().stop_generation()))
                reply.mutable_answer()->mutable_refusal()->set_code(proto::OLD_GENERATION);
            else if (dice_.chance(0.1))
                reply.mutable_answer()->mutable_refusal()->set_code(proto::DENIED);
            sendData(reply);
            return;
        }
        case proto::EmToEi::kCancel: {
            const auto found = life_->tasks.find(message.cancel().task_id());
            if (found == life_->tasks.end()) return;
            found->second.cancelled = true;
            if (found->second.waits) begin(found->first);
            endStopped();
            return;
        }
        case proto::EmToEi::kPause: {
            const auto found = life_->tasks.find(message.pause().task_id());
            if (found == life_->tasks.end()) return;
            auto& task = found->second;
            const bool resume = message.pause().resume();
            if (task.waits || task.returning || task.paused != resume) return;
            if (resume && (stopRequested(task) || overtaken(message.pause().stop_generation()))) return;
            task.paused = !resume;
            task.moves = resume;
            ++task.turn;
            if (resume) {
                task.ends_at = timeline_.now() + task.left;
                timeline_.at(task.ends_at, process_, [this, id = task.id, turn = task.turn] {
                    const auto at = life_->tasks.find(id);
                    if (at != life_->tasks.end() && at->second.turn == turn) finish(id);
                });
            } else {
                task.left = std::max<Duration>(task.ends_at - timeline_.now(), 1ms);
            }
            showMotion();
            report(task, resume ? proto::TASK_RUNNING : proto::TASK_PAUSED, -1);
            return;
        }
        default:
            return;
    }
}

void RobotApplication::onTask(const proto::EmToEi& message) {
    const auto& dispatch = message.task();
    auto& life = *life_;
    Running task;
    task.id = dispatch.task_id();
    task.service = dispatch.service();
    task.generation = dispatch.stop_generation();
    task.epoch = life.level.epoch();
    task.link = life.link->number;
    observer_.dispatched(entity_, task.id);
    if (std::find(life.recent.begin(), life.recent.end(), task.id) != life.recent.end())
        return answer(task, proto::DUPLICATE, "a task of this id has been dispatched before");
    if (life.level.stopped() > task.generation)
        return answer(task, proto::OLD_GENERATION, "a stop has come since");
    if (dice_.chance(0.05)) return answer(task, proto::DENIED, "not now");
    if (life.tasks.size() >= kTasks) return answer(task, proto::QUEUE_FULL, "too many tasks");
    life.recent.push_back(task.id);
    if (life.recent.size() > kRecent) life.recent.pop_front();
    const auto id = task.id;
    life.tasks.emplace(id, std::move(task));
    timeline_.after(kSettleTime, process_, [this, id] {
        const auto found = life_->tasks.find(id);
        if (found == life_->tasks.end() || !found->second.waits) return;
        answer(found->second, proto::TIMED_OUT, "the stop before it is not through");
        life_->tasks.erase(found);
    });
    begin(id);
}

/// A task that waits may begin, is refused, or waits on.
void RobotApplication::begin(const std::string& id) {
    const auto found = life_->tasks.find(id);
    if (found == life_->tasks.end() || !found->second.waits) return;
    auto& task = found->second;
    const auto& level = life_->level;
    if (stopRequested(task)) {
        answer(task,
               level.stopped() > task.generation ? proto::OLD_GENERATION
               : task.cancelled                  ? proto::CANCELLED
                                                 : proto::STOPPED,
               "it was stopped before it began");
        life_->tasks.erase(found);
        return;
    }
    if (!level.settled() || level.stopped() < task.generation) return;
    task.waits = false;
    task.moves = true;
    answer(task, proto::OK, "");
    const auto takes = task.service == "Dock" ? dice_.between(300ms, 4s)
                       : dice_.chance(0.3)    ? dice_.between(2ms, 60ms)
                                              : dice_.between(100ms, 2500ms);
    task.ends_at = timeline_.now() + takes;
    if (dice_.chance(0.3)) chat(id, dice_.chance(0.15) ? dice_.between(20ms, 90ms) : takes / 2);
    timeline_.at(task.ends_at, process_, [this, id, turn = task.turn] {
        const auto at = life_->tasks.find(id);
        if (at != life_->tasks.end() && at->second.turn == turn) finish(id);
    });
    showMotion();
}

/// Feedback of a task, again and again while it moves.
void RobotApplication::chat(const std::string& id, Duration period) {
    timeline_.after(period, process_, [this, id, period] {
        const auto at = life_->tasks.find(id);
        if (at == life_->tasks.end() || !at->second.moves) return;
        report(at->second, proto::TASK_RUNNING, 0.5);
        proto::EiToEm seen;
        seen.mutable_raw()->add_data("what the camera sees");
        if (dice_.chance(0.6)) sendData(seen);
        chat(id, period);
    });
}

void RobotApplication::answer(const Running& task, int code, const char* text) {
    proto::EiToEm message;
    message.mutable_task_answer()->set_task_id(task.id);
    message.mutable_task_answer()->mutable_refusal()->set_code(static_cast<proto::RefusalCode>(code));
    message.mutable_task_answer()->mutable_refusal()->set_message(text);
    if (life_->link && life_->link->number == task.link) sendData(message);
}

void RobotApplication::report(const Running& task, int state, double progress) {
    if (!life_->link || life_->link->number != task.link) return;
    proto::EiToEm message;
    auto& event = *message.mutable_task()->mutable_event();
    event.set_task_id(task.id);
    event.set_service(task.service);
    event.set_state(static_cast<proto::TaskState>(state));
    event.set_progress(progress);
    sendData(message);
}

void RobotApplication::sendData(const proto::EiToEm& message) {
    life_->link->data->send(
        process_, [manager = manager_, number = life_->link->number, bytes = message.SerializeAsString()] {
            manager->linkMessage(number, bytes);
        });
}

}  // namespace axon::simulation
