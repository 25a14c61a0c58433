// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/collaboration.pb.h>

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "tests/support/core_rig.hpp"

namespace axon::test {

/// "role service preced", e.g. "0 Turning 1"; the roles are the robots' numbers.
proto::GlobalService globalService(const std::vector<std::string>& steps,
                                   proto::OnFailure on_failure = proto::STOP_ALL);

/// Several Entity Managers that one client holds under one root lease, each with a robot application that
/// does what `behave` says, and a network between them that can be cut. Everything on one virtual time.
class Fleet {
  public:
    /// Those with a watchdog of their own: `watchdogs`, in the robots' order.
    explicit Fleet(std::size_t robots, std::uint64_t seed = 1, const std::vector<Duration>& watchdogs = {});

    /// How a task goes, once it is given to a robot.
    struct Outcome {
        Duration lasts = std::chrono::milliseconds{100};  ///< 0: it has ended when it answers
        proto::TaskState verdict = proto::TASK_SUCCEEDED;
        std::vector<proto::Param> results = {};
        bool denied = false;
        bool deaf = false;  ///< heeds neither pause nor cancel
    };
    std::function<Outcome(std::size_t robot, const proto::TaskDispatch&)> behave;

    std::size_t size() const { return robots_.size(); }
    CoreRig& rig(std::size_t robot) { return *robots_[robot].rig; }
    std::string uuid(std::size_t robot) { return rig(robot).core().uuid(); }
    EntityState state(std::size_t robot) { return rig(robot).core().state(); }
    /// Whether its application is doing anything.
    bool moves(std::size_t robot) const { return !robots_[robot].running.empty(); }
    TimePoint now() { return rig(0).clock.now(); }

    /// Every role that has a step is played by the robot of its number.
    proto::CollaborationRequest request(const proto::GlobalService& service, std::size_t master,
                                        const std::string& run);
    void launch(const proto::GlobalService& service, std::size_t master, const std::string& run = "run");
    void launch(const proto::CollaborationRequest& request, std::size_t master);
    void control(std::size_t master, const std::string& run, proto::TaskAction action);
    /// Of the client, as on its signal lane.
    void stop(std::size_t robot) {
        rig(robot).stop("client2");
        deliver();
    }
    void advance(Duration by);

    /// Nothing that its Entity Manager sends to others arrives, nor what they send to it; it does not know.
    void cut(std::size_t robot) { cut_.insert(robot); }
    /// Its Entity Manager stands still: nothing goes in or out, no timer. Its application lives.
    void freeze(std::size_t robot) { frozen_.insert(robot); }

    /// Of what one Entity Manager sends to another this is lost.
    std::function<bool(std::size_t from, std::size_t to, const proto::ToEntity&)> lose;

    /// What the client has been told of the run, all events together.
    struct Told {
        proto::RunState state = proto::RUN_UNSPECIFIED;
        std::map<std::int32_t, proto::StepStatus> steps;
        proto::Refusal reason;
        std::vector<proto::Problem> problems;
        std::uint64_t sequence = 0;
        bool in_order = true;  ///< each event's number is one more than that of the last
        std::vector<std::pair<proto::RunState, TimePoint>> events;
        Refusal refused;  ///< the request itself, by a reply
    };
    Told told;
    /// The master's record of the newest run, as any client may ask for it.
    proto::RunRecord record(std::size_t master);

    struct Happened {
        enum class What : std::uint8_t { Began, Ended, Stopped };
        What what;
        std::size_t robot;
        std::string service;
        TimePoint at;
    };
    std::vector<Happened> log;
    std::vector<std::pair<std::size_t, std::string>> order() const;  ///< (robot, service) as they began

  private:
    struct Running {
        std::string id, service;
        TimePoint ends;
        Duration left{};  ///< while paused
        bool paused = false;
        Outcome outcome;
    };
    struct Robot {
        std::unique_ptr<CoreRig> rig;
        std::vector<Running> running;
        std::deque<proto::EiToEm> answers;
    };
    void finish(std::size_t robot, const Running& task);
    struct Letter {
        std::size_t from, to;
        Header head;
        std::string bytes;
    };
    void serve(std::size_t robot, const proto::EmToEi& message);
    void halt(std::size_t robot);
    void deliver();
    bool reaches(std::size_t from, std::size_t to) const {
        return !cut_.contains(from) && !cut_.contains(to) && !frozen_.contains(to);
    }

    std::vector<Robot> robots_;
    std::deque<Letter> letters_;
    std::set<std::size_t> cut_, frozen_;
};

}  // namespace axon::test
