// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <array>
#include <atomic>
#include <condition_variable>
#include <map>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>
#include <utility>

#include "kinds.hpp"
#include "raw_client.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;

constexpr std::size_t kContenders = 8;

std::string codeName(int code) {
    return std::string(refusalName(static_cast<RefusalCode>(code)));
}

/// The UUID of a robot, once it can be used.
std::string robot(RawClient& client, std::size_t i) {
    const auto id = client.entity(robotName(i), 20s);
    if (id.empty()) throw std::runtime_error(robotName(i) + " did not become available to " + client.name());
    return id;
}

/// A kind begins with robots that nobody holds, whatever the one before it left: its clients may have been
/// lost while they held one, which keeps a robot theirs for the grace.
void freeAll(Run& run) {
    RawClient client(run.lab.clientAddress(), "client0@faults");
    for (std::size_t i = 0; i < run.lab.entities(); ++i) {
        const auto id = robot(client, i);
        const auto grant = client.checkOut(id, true);
        if (!grant) throw std::runtime_error("check-out of " + robotName(i) + ": " + grant.refusal().message);
        if (!client.release(id, grant->lease)) throw std::runtime_error(robotName(i) + " was not released");
    }
}

/// Commands that must not be obeyed, and what the Entity Manager may answer.
enum class Wrong { None, Older, Foreign, Epoch, Invented, OldGeneration, Expired, Revoked };
constexpr std::array kWrong = {Wrong::None,     Wrong::Older,         Wrong::Foreign, Wrong::Epoch,
                               Wrong::Invented, Wrong::OldGeneration, Wrong::Expired, Wrong::Revoked};

const char* nameOf(Wrong wrong) {
    switch (wrong) {
        case Wrong::None:
            return "no lease";
        case Wrong::Older:
            return "an older lease";
        case Wrong::Foreign:
            return "the lease of another";
        case Wrong::Epoch:
            return "another epoch";
        case Wrong::Invented:
            return "a lease never given";
        case Wrong::OldGeneration:
            return "an old generation";
        case Wrong::Expired:
            return "after not_after";
        case Wrong::Revoked:
            return "a revoked lease";
    }
    return "";
}
std::set<RefusalCode> answersTo(Wrong wrong) {
    switch (wrong) {
        case Wrong::Older:
            return {RefusalCode::OlderLease};
        case Wrong::Epoch:
            return {RefusalCode::WrongEpoch};
        case Wrong::OldGeneration:
            return {RefusalCode::OldGeneration};
        case Wrong::Expired:
            return {RefusalCode::Expired};
        // A newer lease has been given by then, which says more than that the old one was taken away.
        case Wrong::Revoked:
            return {RefusalCode::RevokedLease, RefusalCode::OlderLease};
        default:
            return {RefusalCode::NotHolder};
    }
}

/// Sends commands that nobody may obey, in blocks: in each the lease, the generation and what the robot does
/// are others.
class StaleCommands {
  public:
    explicit StaleCommands(Run& run)
        : run_(run),
          first_(run.lab.clientAddress(), "client1@faults",
                 [this](const Header&, const proto::ToClient& m) { answered(m); }),
          second_(run.lab.clientAddress(), "client2@faults",
                  [this](const Header&, const proto::ToClient& m) { answered(m); }) {}

    void carryOut() {
        run_.lab.newMotions();
        while (run_.goOn()) block();
        for (const auto& motion : run_.lab.newMotions())
            if (forbidden_.contains(motion.task))
                run_.report.violation("the forbidden task " + motion.task + " was executed");
    }

  private:
    static constexpr std::size_t kBlock = 250;

    void block() {
        const auto index = static_cast<std::size_t>(run_.among(0, run_.lab.entities() - 1));
        const auto entity = robot(first_, index);
        robot(second_, index);
        auto& slot = run_.lab.board()[index];
        // The other holds it, and gives it back: that is the older lease. Then the holder, who stops and
        // rearms: that is the old generation.
        const bool swap = run_.among(0, 1) == 1;
        auto& holder = swap ? second_ : first_;
        auto& other = swap ? first_ : second_;
        const auto older = other.checkOut(entity);
        if (!older) throw std::runtime_error("check-out: " + older.refusal().message);
        LeaseNumber revoked{};
        Result<Grant> grant = older;
        if (run_.among(0, 1) == 1) {
            grant = holder.checkOut(entity, true);  // by force
            if (grant) revoked = older->lease;
        }
        if (revoked == LeaseNumber{}) {
            if (!other.release(entity, older->lease)) throw std::runtime_error("no answer to a release");
            grant = holder.checkOut(entity);
        }
        if (!grant) throw std::runtime_error("check-out: " + grant.refusal().message);
        const auto generation = holder.stopAndWait(entity);
        if (!generation) throw std::runtime_error("a stop was not confirmed");
        if (const auto armed = holder.rearm(entity, grant->lease, *generation); !armed)
            throw std::runtime_error("rearm: " + armed.refusal().message);
        const bool drives = run_.among(0, 1) == 1;
        if (drives) {
            const auto driving = holder.run(entity, driveTask(newId()), grant->lease, *generation);
            if (!driving || driving->state() != proto::TASK_RUNNING)
                throw std::runtime_error("the robot did not begin to move");
            waitUntil([&] { return slot.moving != 0; }, 1s);
        }
        // In half of the blocks what is wrong goes straight to the Entity Manager.
        const bool direct = run_.lab.managerOfEach() && run_.among(0, 1) == 1;
        if (direct && !holder.awaitDirect(entity, 1s))
            ++run_.report.counts["direct paths that did not open within 1 s"];
        const auto sent_directly = holder.sentDirectly() + other.sentDirectly();
        const auto starts = slot.starts.load();
        const auto stops = slot.stops.load();

        const auto count = std::min(kBlock, run_.trials - run_.report.trials);
        for (std::size_t i = 0; i < count; ++i) {
            auto wrong = kWrong[run_.among(0, kWrong.size() - 1)];
            if (wrong == Wrong::Revoked && revoked == LeaseNumber{}) wrong = Wrong::Older;
            if (wrong == Wrong::Older && revoked != LeaseNumber{}) wrong = Wrong::Revoked;
            auto* sender = &other;
            LeaseNumber lease = grant->lease;
            auto seen = *generation;
            double not_after = 0;
            switch (wrong) {
                case Wrong::None:
                    lease = {};
                    break;
                case Wrong::Older:
                case Wrong::Revoked:
                    lease = older->lease;
                    break;
                case Wrong::Foreign:
                    break;
                case Wrong::Epoch:
                    sender = &holder;
                    lease.epoch += run_.among(0, 1) == 1 || lease.epoch < 2 ? 1 : -1;
                    break;
                case Wrong::Invented:
                    sender = &holder;
                    lease.number += static_cast<std::int32_t>(run_.among(1, 1000));
                    break;
                case Wrong::OldGeneration:
                    sender = &holder;
                    seen = std::max(0, seen - static_cast<std::int32_t>(run_.among(1, 3)));
                    break;
                case Wrong::Expired:
                    sender = &holder;
                    not_after = 1e-12;
                    break;
            }
            const auto id = newId();
            proto::ToEntity body;
            const bool parameter = wrong != Wrong::Expired && run_.among(0, 3) == 0;
            if (parameter) {
                auto& set = *body.mutable_set_param();
                set.set_service("Step");
                set.set_request_id(id);
                set.mutable_param()->set_name("Seconds");
                set.mutable_param()->add_values()->set_dbl(1);
            } else {
                *body.mutable_task() = stepTask(id, 0.001, not_after);
                forbidden_.insert(idText(id));
            }
            {
                const std::lock_guard lock(mutex_);
                open_[id] = wrong;
            }
            sender->send(entity, parameter ? kMsgParam : kMsgTask, body, lease, seen);
            if (i % 32 == 31) drain(64);  // an Entity Manager takes as many as anybody sends, up to a bound
        }
        if (!drain(0))
            run_.report.violation(std::to_string(giveUp()) + " commands of a block were never answered");
        run_.report.trials += count;
        run_.report.counts[kSentDirectly] += holder.sentDirectly() + other.sentDirectly() - sent_directly;
        // What belongs to the holder goes on undisturbed.
        if (slot.starts != starts)
            run_.report.violation(robotName(index) + " began " + std::to_string(slot.starts - starts) +
                                  " motions that nobody was allowed");
        if (slot.stops != stops) run_.report.counts["robots stopped meanwhile"] += slot.stops - stops;
        for (auto* client : {&first_, &second_}) client->forget();
        if (!holder.release(entity, grant->lease))
            run_.report.violation("the holder could not release what it held");
    }

    /// Waits until at most so many are open.
    bool drain(std::size_t most) {
        std::unique_lock lock(mutex_);
        return changed_.wait_for(lock, 10s, [&] { return open_.size() <= most; });
    }
    std::size_t giveUp() {
        const std::lock_guard lock(mutex_);
        const auto count = open_.size();
        open_.clear();
        return count;
    }

    void answered(const proto::ToClient& message) {
        const bool task = message.has_task();
        if (!task && !message.has_reply()) return;
        const auto& id = task ? message.task().task_id() : message.reply().request_id();
        const auto code = static_cast<RefusalCode>(task ? message.task().reason().code()
                                                        : message.reply().refusal().code());
        const std::lock_guard lock(mutex_);
        const auto found = open_.find(id);
        if (found == open_.end()) return;
        if (task && message.task().state() == proto::TASK_QUEUED) return;  // it expires in the queue
        const auto wrong = found->second;
        if (answersTo(wrong).contains(code) && !(task && message.task().state() < proto::TASK_SUCCEEDED))
            ++run_.report
                  .counts[std::string("refused, ") + nameOf(wrong) + ": " + codeName(static_cast<int>(code))];
        else
            run_.report.violation(
                std::string("a command under ") + nameOf(wrong) + " was answered " +
                codeName(static_cast<int>(code)) +
                (task ? ", task state " + proto::TaskState_Name(message.task().state()) : ""));
        open_.erase(found);
        changed_.notify_all();
    }

    Run& run_;
    std::set<std::string> forbidden_;
    std::mutex mutex_;
    std::condition_variable changed_;
    std::map<std::string, Wrong> open_;  // guarded by mutex_; so is what answered() writes into the report
    RawClient first_, second_;           // last: their threads call answered()
};

/// Clients that all want the same robots, at once, again and again.
class Contention {
  public:
    explicit Contention(Run& run) : run_(run), holders_(run.lab.entities()) {
        for (auto& holder : holders_) holder = kNobody;
        for (std::size_t i = 0; i < kContenders; ++i)
            clients_.push_back(std::make_unique<RawClient>(
                run.lab.clientAddress(), "client" + std::to_string(i + 1) + "@faults",
                [this, i](const Header& head, const proto::ToClient& m) { heard(i, head, m); }));
        for (std::size_t i = 0; i < run.lab.entities(); ++i) {
            entities_.push_back(robot(*clients_[0], i));
            for (auto& client : clients_) robot(*client, i);
            robot_of_[entities_.back()] = i;
        }
    }

    void carryOut() {
        while (run_.goOn()) {
            if (entities_.size() > 1 && run_.among(0, 3) == 0)
                several();
            else
                one();
            ++run_.report.trials;
        }
        for (const auto& client : clients_) run_.report.counts[kSentDirectly] += client->sentDirectly();
    }

  private:
    static constexpr int kNobody = -1;
    struct Answer {
        RefusalCode code = RefusalCode::Ok;
        std::string holder;
        Grant grant;
    };

    std::vector<std::size_t> shuffled() {
        std::vector<std::size_t> order(clients_.size());
        for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
        for (std::size_t i = order.size(); i > 1; --i) std::swap(order[i - 1], order[run_.among(0, i - 1)]);
        return order;
    }

    /// One robot: everybody takes it; one gets it, the others are told who.
    void one() {
        const auto r = static_cast<std::size_t>(run_.among(0, entities_.size() - 1));
        const auto round = ask({r}, proto::TAKE, shuffled());
        if (!round) return;
        std::vector<std::size_t> winners;
        for (std::size_t i = 0; i < clients_.size(); ++i)
            if (answer(i, r).code == RefusalCode::Ok) winners.push_back(i);
        if (winners.size() != 1) {
            run_.report.violation(robotName(r) + " was given to " + std::to_string(winners.size()) + " of " +
                                  std::to_string(clients_.size()) + " clients");
            for (const auto i : winners) giveBack(i, r);
            return;
        }
        const auto winner = winners[0];
        // Who had it in the round before may hold it still when the first ask.
        const auto before = std::exchange(last_[r], clients_[winner]->name());
        for (std::size_t i = 0; i < clients_.size(); ++i) {
            if (i == winner) continue;
            const auto told = answer(i, r);
            ++run_.report.counts["refused: " + codeName(static_cast<int>(told.code))];
            if (told.code == RefusalCode::AlreadyHeld && told.holder != clients_[winner]->name() &&
                told.holder != before)
                run_.report.violation("a refused client was told that '" + told.holder +
                                      "' holds it; it was " + clients_[winner]->name());
        }
        ++run_.report.counts["single check-outs won"];
        const auto grant = answer(winner, r).grant;
        auto& client = *clients_[winner];
        if (run_.among(0, 1) == 1 &&
            (!grant.latched || client.rearm(entities_[r], grant.lease, grant.generation).ok())) {
            const auto driving = client.run(entities_[r], driveTask(newId()), grant.lease, grant.generation);
            if (driving && driving->state() == proto::TASK_RUNNING) {
                waitUntil([&] { return run_.lab.board()[r].moving != 0; }, 1s);
                ++run_.report.counts["handed over out of motion"];
            }
        }
        giveBack(winner, r);  // and nobody waits for the answer: the next round meets it
    }

    /// Several robots, all or none: reserve, then commit or abort.
    void several() {
        std::vector<std::size_t> wanted;
        for (std::size_t r = 0; r < entities_.size(); ++r)
            if (run_.among(0, 1) == 1) wanted.push_back(r);
        if (wanted.size() < 2) wanted = {0, 1};
        if (!ask(wanted, proto::RESERVE, shuffled())) return;
        std::vector<std::size_t> able;
        for (std::size_t i = 0; i < clients_.size(); ++i) {
            const bool all = std::all_of(wanted.begin(), wanted.end(),
                                         [&](std::size_t r) { return answer(i, r).code == RefusalCode::Ok; });
            if (all) able.push_back(i);
        }
        if (able.size() > 1)
            run_.report.violation("the same robots were reserved for " + std::to_string(able.size()) +
                                  " clients");
        // The one that may, commits while all others abort.
        const auto ids = ids_;
        for (std::size_t i = 0; i < clients_.size(); ++i)
            if (!able.empty() && able[0] == i)
                ask(wanted, proto::COMMIT, {i}, ids);
            else
                for (const auto r : wanted)
                    if (idOf(ids, i, r) != "") sendCheckOut(i, r, proto::ABORT, idOf(ids, i, r));
        if (able.empty()) {
            ++run_.report.counts["rounds for several that nobody won"];
            return;
        }
        ++run_.report.counts["check-outs of several won"];
        for (const auto r : wanted) {
            if (answer(able[0], r).code != RefusalCode::Ok)
                run_.report.violation("a commit was refused: " +
                                      codeName(static_cast<int>(answer(able[0], r).code)));
            last_[r] = clients_[able[0]]->name();
            giveBack(able[0], r);
        }
    }

    using Ids = std::map<std::pair<std::size_t, std::size_t>, std::string>;
    static std::string idOf(const Ids& ids, std::size_t client, std::size_t r) {
        const auto found = ids.find({client, r});
        return found == ids.end() ? "" : found->second;
    }

    void sendCheckOut(std::size_t client, std::size_t r, proto::CheckOutPhase phase, const std::string& id) {
        proto::ToEntity body;
        body.mutable_check_out()->set_request_id(id);
        body.mutable_check_out()->set_phase(phase);
        clients_[client]->send(entities_[r], kMsgCheckOut, body);
    }

    /// Everybody asks for all of these, as fast as one thread can; false when not everybody was answered.
    bool ask(const std::vector<std::size_t>& wanted, proto::CheckOutPhase phase,
             const std::vector<std::size_t>& order, const Ids& again = {}) {
        {
            const std::lock_guard lock(mutex_);
            answers_.clear();
            open_ = order.size() * wanted.size();
            phase_ = phase;
            if (again.empty()) ids_.clear();
            for (const auto i : order) {
                const auto id = again.empty() ? newId() : std::string();
                for (const auto r : wanted) {
                    if (again.empty()) ids_[{i, r}] = id;
                }
            }
        }
        for (const auto i : order)
            for (const auto r : wanted) sendCheckOut(i, r, phase, ids_[{i, r}]);
        std::unique_lock lock(mutex_);
        if (changed_.wait_for(lock, 10s, [this] { return open_ == 0; })) return true;
        run_.report.violation(std::to_string(open_) + " check-outs were never answered");
        return false;
    }
    Answer answer(std::size_t client, std::size_t r) {
        const std::lock_guard lock(mutex_);
        return answers_[{client, r}];
    }

    void giveBack(std::size_t client, std::size_t r) {
        const auto grant = answer(client, r).grant;
        {
            const std::lock_guard lock(mutex_);
            if (holders_[r] == static_cast<int>(client))
                holders_[r] = kNobody;  // from now on another may be given it
        }
        proto::ToEntity body;
        body.mutable_release();
        clients_[client]->send(entities_[r], kMsgRelease, body, grant.lease);
    }

    void heard(std::size_t client, const Header& head, const proto::ToClient& message) {
        if (!message.has_check_out()) return;
        const auto& reply = message.check_out();
        const std::lock_guard lock(mutex_);
        const auto found = robot_of_.find(head.entity);
        if (found == robot_of_.end()) return;
        const auto r = found->second;
        if (reply.phase() != phase_ || reply.request_id() != idOf(ids_, client, r)) return;
        Answer answer;
        answer.code = static_cast<RefusalCode>(reply.refusal().code());
        answer.holder = reply.refusal().holder();
        if (reply.has_lease()) {
            answer.grant = {{static_cast<std::int32_t>(reply.lease().epoch()),
                             static_cast<std::int32_t>(reply.lease().number())},
                            static_cast<std::int32_t>(reply.stop_generation()),
                            reply.latched()};
            if (holders_[r] != kNobody && holders_[r] != static_cast<int>(client))
                run_.report.violation(robotName(r) + " was given to " + clients_[client]->name() + " while " +
                                      clients_[static_cast<std::size_t>(holders_[r])]->name() + " held it");
            holders_[r] = static_cast<int>(client);
            if (run_.lab.board()[r].moving != 0)
                run_.report.violation(robotName(r) + " was handed over while it moved");
        }
        answers_[{client, r}] = answer;
        if (open_ > 0) --open_;
        changed_.notify_all();
    }

    Run& run_;
    std::vector<std::string> entities_;
    std::map<std::size_t, std::string> last_;  // who won it last
    std::mutex mutex_;
    std::condition_variable changed_;
    // Guarded by mutex_, and so is what heard() writes into the report:
    std::map<std::string, std::size_t> robot_of_;
    std::vector<int> holders_;
    std::map<std::pair<std::size_t, std::size_t>, Answer> answers_;
    Ids ids_;
    std::size_t open_ = 0;
    proto::CheckOutPhase phase_ = proto::TAKE;
    std::vector<std::unique_ptr<RawClient>> clients_;  // last: their threads call heard()
};

}  // namespace

std::vector<Kind> commandKinds() {
    const auto among = [](auto carry_out) {
        return [carry_out](Run& run) {
            run.lab.endClient();
            run.lab.startAll();
            freeAll(run);
            carry_out(run);
        };
    };
    std::vector<Kind> all;
    all.push_back(
        {"stale",
         8,
         "commands that are stale, foreign, revoked, expired, of another epoch or of an old generation",
         {0, 0, "none is executed, each is refused with its reason"},
         {},
         "",
         5000,
         500,
         among([](Run& run) { StaleCommands(run).carryOut(); })});
    all.push_back({"contend",
                   9,
                   "eight clients check out the same robots at once, one robot or several",
                   {0, 0, "one holder each, none is handed over while it moves"},
                   {},
                   "",
                   500,
                   50,
                   among([](Run& run) { Contention(run).carryOut(); })});
    for (auto& kind : restartKinds()) {
        kind.run = among(kind.run);
        all.push_back(std::move(kind));
    }
    return all;
}

}  // namespace axon::faults
