// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <map>
#include <memory>
#include <set>
#include <stdexcept>
#include <thread>

#include "kinds.hpp"
#include "raw_client.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;

/// Two clients whose connections, and whose robots' processes, end in the middle of everything.
class Hardship {
  protected:
    explicit Hardship(Run& run) : run_(run) {
        join(first_, "client1@faults");
        join(second_, "client2@faults");
    }

    ~Hardship() {
        for (auto* client : {&first_, &second_}) leave(*client);
    }

    void leave(std::unique_ptr<RawClient>& client) {
        if (client) run_.report.counts[kSentDirectly] += client->sentDirectly();
        client.reset();
    }
    void join(std::unique_ptr<RawClient>& client, const std::string& name) {
        leave(client);
        for (int i = 0;; ++i) {  // a server that has just been started may need a moment
            try {
                client = std::make_unique<RawClient>(run_.lab.clientAddress(), name);
                return;
            } catch (const std::runtime_error&) {
                if (i == 50) throw;
                std::this_thread::sleep_for(50ms);
            }
        }
    }
    void rejoin(bool first) { first ? join(first_, "client1@faults") : join(second_, "client2@faults"); }

    /// The UUID once the robot can be used again; empty when it did not come back by itself.
    std::string robot(RawClient& client, std::size_t r) {
        const auto id = client.entity(robotName(r), 15s);
        if (!id.empty()) return id;
        // Nobody tells anything to a client that the server has given up, on a host that stood still.
        if (client.connected())
            ++run_.report.not_recovered;
        else
            ++run_.report.counts["robots not seen by a client that the server had given up"];
        run_.lab.keepLogs();
        return id;
    }
    void keepConnected() {
        for (const bool first : {true, false}) {
            if ((first ? first_ : second_)->connected()) continue;
            ++run_.report.counts["clients that the server had given up"];
            rejoin(first);
        }
    }
    void killManager(std::size_t r) {
        run_.lab.manager(r).kill();
        run_.lab.manager(r).reap();
        run_.lab.startAll();
    }
    void killServer() {
        run_.lab.server().kill();
        run_.lab.server().reap();
        run_.lab.startAll();
        rejoin(true);
        rejoin(false);
    }

    /// In half of the cases, what comes next goes by the direct path; otherwise by whichever way is open by
    /// then.
    void maybeDirect(const std::string& id) {
        if (run_.lab.managerOfEach() && run_.among(0, 1) == 1 && !first_->awaitDirect(id, 500ms))
            ++run_.report.counts["direct paths that did not open within 500 ms"];
    }

    /// Held and rearmed, whatever it takes; nothing when that does not come about within ten seconds.
    std::optional<Grant> takeReady(RawClient& client, std::size_t r) {
        const auto end = std::chrono::steady_clock::now() + 10s;
        std::string why;
        while (!interrupted() && std::chrono::steady_clock::now() < end) {
            const auto id = client.entity(robotName(r), 5s);
            if (id.empty()) {
                why = "it is not there";
                continue;
            }
            if (const auto mine = client.lease(id)) {
                // Held since an earlier trial, or before something happened that did not end it.
                // An orphaned lease is its name's, and nobody commands under it.
                const auto now = client.status(id);
                if (now && now->holder() == client.name() && !now->orphaned()) {
                    const auto generation = static_cast<std::int32_t>(now->stop_generation());
                    const auto armed = now->latched() ? client.rearm(id, *mine, generation) : Result<void>();
                    if (armed) return Grant{*mine, generation, false};
                    why = "rearm: " + armed.refusal().message;
                    continue;
                }
            }
            auto grant = client.checkOut(id, false, 2s);
            if (!grant) {
                why = grant.refusal().message;
                if (grant.refusal().code == RefusalCode::AlreadyHeld) grant = client.checkOut(id, true, 2s);
            }
            if (!grant) {
                std::this_thread::sleep_for(5ms);
                continue;
            }
            if (!grant->latched) return grant.value();
            if (const auto armed = client.rearm(id, grant->lease, grant->generation); armed)
                return grant.value();
            else
                why = "rearm: " + armed.refusal().message;
            client.release(id, grant->lease);
        }
        if (!interrupted()) {
            run_.report.violation(robotName(r) + " could not be had again: " + why);
            run_.lab.keepLogs();
        }
        return std::nullopt;
    }

    Run& run_;
    std::unique_ptr<RawClient> first_, second_;
};

/// After a stop, in any order, everything but an order to move.
class Latch : private Hardship {
  public:
    explicit Latch(Run& run) : Hardship(run) {}

    void carryOut() {
        std::size_t failures = 0;
        while (run_.goOn() && failures < 20) {
            if (sequence())
                ++run_.report.trials;
            else
                ++failures;
        }
    }

  private:
    bool sequence() {
        const auto r = static_cast<std::size_t>(run_.among(0, run_.lab.entities() - 1));
        auto& slot = run_.lab.board()[r];
        keepConnected();
        for (auto* client : {first_.get(), second_.get()}) client->forget();
        // It drives, or has driven; then it is stopped. A reset of the sequence before may reach this robot's
        // Entity Manager only now: it has lost us then, says so, and is taken again.
        Grant grant;
        std::string id;
        proto::TaskRequest driven;
        std::optional<proto::TaskEvent> begun;
        do {
            const auto held = takeReady(*first_, r);
            if (!held) return false;
            grant = *held;
            id = first_->entity(robotName(r), 5s);
            maybeDirect(id);
            driven = run_.among(0, 2) == 0 ? stepTask(newId()) : driveTask(newId());
            begun = first_->run(id, driven, grant.lease, grant.generation, driven.service() == "Step");
        } while (begun && begun->reason().code() == proto::CLIENT_LOST);
        if (!begun || begun->state() == proto::TASK_REFUSED) {
            run_.report.violation("a proper task was not accepted: " +
                                  (begun ? begun->reason().message() : "no answer"));
            return false;
        }
        if (driven.service() == "Drive") waitUntil([&] { return slot.moving != 0; }, 1s);
        auto& stopper = run_.among(0, 1) == 1 ? *first_ : *second_;
        if (!robot(stopper, r).empty() && !stopper.stopAndWait(id)) {
            run_.report.violation("a stop was not confirmed");
            return false;
        }
        const auto starts = slot.starts.load();

        std::string story = "stop";
        const auto steps = run_.among(3, 8);
        for (std::uint64_t i = 0; i < steps; ++i) story += ", " + step(r, grant, driven);
        // What the Entity Manager had to say to all that, it has said before it answers this.
        const auto after = robot(*first_, r);
        if (!after.empty()) first_->status(after);
        std::this_thread::sleep_for(1ms);
        check(slot, starts, story);

        // Whoever of the two holds it now.
        for (auto* client : {first_.get(), second_.get()}) {
            proto::ToEntity body;
            body.mutable_release();
            if (!after.empty()) client->send(after, kMsgRelease, body, grant.lease);
        }
        // A rearm moves nothing either.
        if (const auto again = takeReady(*first_, r)) {
            std::this_thread::sleep_for(1ms);
            check(slot, starts, story + ", rearm");
            if (const auto now = first_->entity(robotName(r), 5s); !now.empty())
                first_->release(now, again->lease);
        } else {
            return false;
        }
        return true;
    }

    void check(Slot& slot, std::uint32_t starts, const std::string& story) {
        if (slot.starts == starts && slot.moving == 0) return;
        run_.report.violation("moved after: " + story);
        run_.lab.keepLogs();
    }

    /// Anything but a proper order to move; its name.
    std::string step(std::size_t r, Grant& grant, const proto::TaskRequest& driven) {
        const bool first = run_.among(0, 1) == 1;
        auto& client = first ? *first_ : *second_;
        const std::string who = first ? " by the holder" : " by another";
        const auto id = robot(client, r);
        if (id.empty()) return "it is gone";
        proto::ToEntity body;
        // Processes are killed now and then only: a sequence with one takes as long as hundred without.
        const auto choice = run_.among(0, 999);
        if (choice < 3 && run_.lab.managerOfEach()) {
            killManager(r);
            const auto back = robot(*first_, r);
            ++run_.report.counts["Entity Managers killed"];
            if (const auto now = back.empty() ? std::nullopt : first_->status(back); now && !now->latched())
                run_.report.violation(robotName(r) +
                                      " is no longer latched after its Entity Manager was killed");
            return "Entity Manager restarted";
        }
        if (choice < 5) {
            killServer();
            robot(*first_, r);
            ++run_.report.counts["servers killed"];
            return "server restarted";
        }
        if (choice < 15) {
            run_.lab.relay().reset(Hop::Manager);
            ++run_.report.counts["resets between server and Entity Managers"];
            return "reset between server and Entity Manager";
        }
        if (choice < 30) {
            run_.lab.relay().reset(Hop::Link);
            ++run_.report.counts["resets between Entity Managers and application"];
            return "reset between Entity Manager and application";
        }
        if (choice < 80) {
            rejoin(first);
            ++run_.report.counts["clients reconnected"];
            return "reconnect" + who;
        }
        ++run_.report.counts["messages"];
        switch (run_.among(0, 8)) {
            case 0:
                client.reset(id);
                return "reset" + who;
            case 1:
                client.clear(id);
                return "clear" + who;
            case 2:
                client.stop(id);
                return "stop" + who;
            case 3:
            case 4: {
                // As it was sent, or with the newest lease and generation.
                *body.mutable_task() = driven;
                const auto now = run_.among(0, 1) == 1 ? client.status(id) : std::nullopt;
                client.send(id, kMsgTask, body, grant.lease,
                            now ? static_cast<std::int32_t>(now->stop_generation()) : grant.generation);
                return "replay of the task" + who;
            }
            case 5: {
                // A new task, and no rearm: an order, but not one that a latched robot may take.
                const auto now = client.status(id);
                if (!now || !now->latched()) return "status" + who;
                *body.mutable_task() = driveTask(newId());
                client.send(id, kMsgTask, body, grant.lease,
                            static_cast<std::int32_t>(now->stop_generation()));
                return "new task without rearm" + who;
            }
            case 6: {
                body.mutable_task_control()->set_task_id(driven.task_id());
                body.mutable_task_control()->set_action(proto::RESUME);
                client.send(id, kMsgTaskControl, body, grant.lease, grant.generation);
                return "resume of the task" + who;
            }
            case 7: {
                body.mutable_release();
                client.send(id, kMsgRelease, body, grant.lease, grant.generation);
                return "release" + who;
            }
            default: {
                const auto taken = client.checkOut(id, false, 2s);
                if (taken) grant = taken.value();
                return std::string(taken ? "check-out" : "check-out refused") + who;
            }
        }
    }
};

/// Tasks that are sent, lost, and sent again.
class Retries : private Hardship {
  public:
    explicit Retries(Run& run) : Hardship(run) {}

    void carryOut() {
        run_.lab.newMotions();
        std::size_t failures = 0;
        while (run_.goOn() && failures < 20) {
            if (trial())
                ++run_.report.trials;
            else
                ++failures;
            weigh();
        }
        std::this_thread::sleep_for(200ms);
        weigh();
        run_.report.counts["tasks sent"] = tasks_.size();
        run_.report.counts["tasks executed"] = executed_.size();
    }

  private:
    /// What may pass between the sending of a task and its reception by the Entity Manager.
    static constexpr std::int64_t kTransitNs = 50'000'000;
    struct Sent {
        std::int64_t latest = 0;  ///< no start after this; 0 = never expires
    };

    bool trial() {
        const auto r = static_cast<std::size_t>(run_.among(0, run_.lab.entities() - 1));
        keepConnected();
        for (auto* client : {first_.get(), second_.get()}) client->forget();
        auto grant = takeReady(*first_, r);
        if (!grant) return false;
        maybeDirect(first_->entity(robotName(r), 5s));
        std::vector<proto::TaskRequest> tasks;
        const auto count = run_.among(2, 6);
        for (std::uint64_t i = 0; i < count; ++i) {
            const double not_after =
                run_.among(0, 1) == 1 ? static_cast<double>(run_.among(2, 60)) / 1000 : 0;
            tasks.push_back(stepTask(newId(), static_cast<double>(run_.among(0, 15)) / 1000, not_after));
        }
        send(r, tasks, *grant);
        std::this_thread::sleep_for(std::chrono::microseconds(run_.among(0, 30'000)));
        harm(r);
        // Again, once or twice, by the same client that knows no better; some of it out of order.
        for (auto rounds = run_.among(1, 2); rounds > 0; --rounds) {
            grant = takeReady(*first_, r);
            if (!grant) return false;
            for (std::size_t i = tasks.size(); i > 1; --i)
                if (run_.among(0, 3) == 0) std::swap(tasks[i - 1], tasks[run_.among(0, i - 1)]);
            send(r, tasks, *grant);
            std::this_thread::sleep_for(std::chrono::microseconds(run_.among(0, 20'000)));
        }
        // What is left over ends before the next trial.
        if (const auto id = first_->entity(robotName(r), 5s); !id.empty()) first_->release(id, grant->lease);
        return true;
    }

    void send(std::size_t r, const std::vector<proto::TaskRequest>& tasks, const Grant& grant) {
        const auto id = first_->entity(robotName(r), 5s);
        if (id.empty()) return;
        for (const auto& task : tasks) {
            proto::ToEntity body;
            *body.mutable_task() = task;
            auto& sent = tasks_[idText(task.task_id())];
            if (task.not_after_s() > 0)
                sent.latest = nowNs() + kTransitNs + static_cast<std::int64_t>(task.not_after_s() * 1e9);
            first_->send(id, kMsgTask, body, grant.lease, grant.generation);
            if (run_.among(0, 4) == 0)
                first_->send(id, kMsgTask, body, grant.lease, grant.generation);  // duplicated on the way
        }
    }

    void harm(std::size_t r) {
        const auto choice = run_.among(0, 99);
        if (choice < 45) {
            rejoin(true);
            ++run_.report.counts["client killed in mid-task"];
        } else if (choice < 60) {
            run_.lab.relay().reset(Hop::Manager);
            ++run_.report.counts["reset between server and Entity Managers"];
        } else if (choice < 75) {
            run_.lab.relay().reset(Hop::Link);
            ++run_.report.counts["reset between Entity Managers and application"];
        } else if (choice < 85 && run_.lab.managerOfEach()) {
            killManager(r);
            ++run_.report.counts["Entity Manager killed"];
        } else if (choice < 88) {
            killServer();
            ++run_.report.counts["server killed"];
        } else {
            ++run_.report.counts["nothing happened but the repetition"];
        }
    }

    void weigh() {
        for (const auto& motion : run_.lab.newMotions()) {
            const auto found = tasks_.find(motion.task);
            if (found == tasks_.end()) {
                run_.report.violation("a task began that nobody sent: " + motion.task);
                continue;
            }
            if (!executed_.insert(motion.task).second) {
                run_.report.violation("task " + motion.task + " began twice at " + robotName(motion.robot));
                run_.lab.keepLogs();
            }
            const auto latest = found->second.latest;
            if (latest == 0 || motion.at <= latest) continue;
            const auto late = motion.at - latest;
            if (late <= run_.lab.probe().overlap(latest - 1'000'000'000, motion.at))
                ++run_.report.counts["late beside a host stall"];
            else
                run_.report.violation("task " + motion.task + " began " + std::to_string(late / 1'000'000) +
                                      " ms after its expiry");
        }
    }

    std::map<std::string, Sent> tasks_;
    std::set<std::string> executed_;
};

}  // namespace

std::vector<Kind> restartKinds() {
    const Needs needs{.relay_managers = true, .relay_links = true, .daemons = true};
    std::vector<Kind> all;
    all.push_back({"latch",
                   7,
                   "after a stop: resets, clears, replays, reconnects, restarts, check-outs, in random "
                   "order; then a rearm",
                   {0, 0, "no robot moves again without a new order"},
                   needs,
                   "",
                   200,
                   20,
                   [](Run& run) { Latch(run).carryOut(); }});
    all.push_back(
        {"tasks",
         10,
         "tasks are sent, duplicated and sent again while clients, Entity Managers and servers are killed",
         {0, 0, "no task begins twice, none after its not_after"},
         needs,
         "",
         100,
         10,
         [](Run& run) { Retries(run).carryOut(); }});
    return all;
}

}  // namespace axon::faults
