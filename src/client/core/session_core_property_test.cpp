// SPDX-License-Identifier: GPL-2.0-or-later
#include <gtest/gtest.h>

#include <map>

#include "client/testing/test_environment.hpp"

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;

/// A client that asks at random, of servers and entities that answer, refuse, repeat, delay, forget and
/// vanish at random; and leases that are lost, resumed, waited for and given up. What must hold: every
/// request is answered exactly once within its time, a task's report never goes back from a final state,
/// every text of an entity arrives, and after the connection is lost nothing is open.
class Chaos : public CoreWorld {
  public:
    explicit Chaos(std::uint64_t seed) : dice_(seed) {}

    void run(int steps) {
        connect();
        for (int i = 0; i < steps; ++i) step();
        // Longer than any wait, any grace and their answers' time-outs, one after the other.
        for (int i = 0; i < 60; ++i) advance(1s);
        for (const auto& [id, count] : answers_) {
            ASSERT_EQ(count, 1) << "request " << id << " of step " << step_of_[id];
        }
        EXPECT_EQ(core.pendingRequests(), 0U);
        EXPECT_EQ(core.nextDeadline(), TimePoint::max());
        EXPECT_EQ(observer.texts.size(), texts_expected_);
        core.onDisconnected("end", true);
        for (const auto& task : tasks_) {
            const auto report = core.tasks().report(task);
            EXPECT_TRUE(!report || isFinal(report->state));
        }
        std::map<std::string, TaskState> last;
        for (const auto& report : observer.tasks) {
            const auto before = last.find(report.id);
            ASSERT_FALSE(before != last.end() && isFinal(before->second)) << "a report after the final one";
            last[report.id] = report.state;
        }
        for (const auto& task : tasks_) {
            const auto end = last.find(task.toString());
            ASSERT_TRUE(end != last.end() && isFinal(end->second)) << "a task whose end nobody was told";
        }
    }

  private:
    std::uint64_t roll(std::uint64_t sides) { return dice_.next() % sides; }

    template <class T>
    std::function<void(Result<T>)> once() {
        const int id = next_++;
        answers_[id] = 0;
        step_of_[id] = chosen_;
        return [this, id](const Result<T>&) { ++answers_[id]; };
    }

    void step() {
        for (auto& message : link.take()) letters_.push_back(std::move(message));
        const auto held = core.leases().held();
        chosen_ = static_cast<int>(roll(17));
        switch (chosen_) {
            case 0:
                core.checkOuts().checkOut({"Cyton"}, options(), once<std::vector<Held>>());
                break;
            case 1:
                orders_.push_back(core.checkOuts().checkOut({"PeopleBot#1", "PeopleBot#2", "Cyton"},
                                                            options(), once<std::vector<Held>>()));
                break;
            case 16: {
                static const char* const kQueries[] = {"1 ROBOT", "2 MOBILE", "1 ROBOT with Driving",
                                                       "1 ROBOT + 2 ROBOT/MOBILE", "1 MACHINE"};
                orders_.push_back(core.checkOuts().checkOut(parseQuery(kQueries[roll(5)]).value(), options(),
                                                            once<std::vector<Held>>()));
                if (roll(4) == 0) core.checkOuts().giveUp(orders_[roll(orders_.size())]);
                break;
            }
            case 2:
                if (!held.empty())
                    core.commands().set(held[roll(held.size())], "Driving", {"Distance", {std::int64_t{5}}},
                                        once<void>());
                break;
            case 3:
            case 4:
                if (!held.empty())
                    tasks_.push_back(core.tasks().run(held[roll(held.size())], "Driving", {}, {}));
                break;
            case 5:
                if (!tasks_.empty()) {
                    core.tasks().control(tasks_[roll(tasks_.size())],
                                         static_cast<proto::TaskAction>(1 + roll(3)), once<void>());
                }
                break;
            case 6:
                core.commands().rearm(uuid(static_cast<int>(1 + roll(4))), once<void>());
                break;
            case 7:
                core.entities().fetchServices(uuid(static_cast<int>(1 + roll(4))),
                                              once<std::vector<Service>>());
                break;
            case 8:
                if (!held.empty() && roll(4) == 0)
                    core.leases().release(held[roll(held.size())], once<void>());
                break;
            case 9:
                if (!held.empty()) {
                    core.commands().offer(held[roll(held.size())], "Driving", "Map", "m", 1,
                                          std::string(32, 'x'), once<void>());
                }
                break;
            case 10:
                advance(std::chrono::milliseconds(roll(1500)));
                break;
            case 11:
                if (!held.empty()) {
                    proto::ToClient text;
                    text.mutable_text()->set_text("hello");
                    fromEntity(held[0].entity[7] - '0', text);
                    ++texts_expected_;
                }
                break;
            case 12:
                disturb();
                break;
            default:
                deliver();
        }
    }

    CheckOutOptions options() {
        CheckOutOptions options;
        if (roll(3) == 0) options.wait = Seconds(static_cast<double>(roll(15)));
        options.ask = options.wait && roll(6) == 0;  // without a time to wait a question is open for minutes
        options.force = roll(6) == 0;
        return options;
    }

    void disturb() {
        const int number = static_cast<int>(1 + roll(3));
        switch (roll(5)) {
            case 0:
                core.onProfile(Presence::Left, {uuid(number), "gone"}, {});
                join(number, number == 3 ? "Cyton" : "PeopleBot");
                break;
            case 1:
                if (roll(3) == 0) {
                    core.onDisconnected("chaos", roll(4) == 0);
                    letters_.clear();
                    if (roll(2) == 0) advance(std::chrono::milliseconds(roll(4000)));
                    connect();
                }
                break;
            case 2: {
                EntityStatus its{uuid(number),
                                 static_cast<EntityState>(roll(9)),
                                 false,
                                 0,
                                 roll(2) == 0 ? kMe : Sender{},
                                 {1, static_cast<std::int32_t>(roll(40))},
                                 {}};
                if (const auto* lease = core.leases().of(its.entity); lease != nullptr && roll(2) == 0)
                    its.held = lease->number;
                its.orphaned = roll(3) == 0;
                core.onStatus(its);
                break;
            }
            case 3: {
                proto::ToClient ended;
                ended.mutable_lease_ended()->mutable_lease()->set_epoch(1);
                ended.mutable_lease_ended()->mutable_lease()->set_number(
                    static_cast<std::uint32_t>(roll(40)));
                fromEntity(number, ended);
                break;
            }
            default: {
                Header head;
                head.entity = uuid(number);
                std::string noise(roll(40), '\0');
                dice_.fill(noise.data(), noise.size());
                core.onEntityMsg(head, noise);
            }
        }
    }

    /// An entity or the server does something about a message that was sent, perhaps twice, perhaps never.
    void deliver() {
        if (letters_.empty()) return;
        const auto at = roll(letters_.size());
        const auto letter = letters_[at];
        if (roll(4) != 0) letters_.erase(letters_.begin() + static_cast<std::ptrdiff_t>(at));
        if (roll(8) == 0) return;
        const int number = letter.head.entity[7] - '0';
        const auto code = roll(3) == 0 ? static_cast<RefusalCode>(1 + roll(9)) : RefusalCode::Ok;
        if (roll(10) == 0) {
            core.onRefusal(letter.head, {RefusalCode::UnknownEntity, "chaos", {}});
            return;
        }
        switch (letter.body.body_case()) {
            case proto::ToEntity::kCheckOut:
                if (letter.body.check_out().phase() == proto::ABORT) break;
                if (letter.body.check_out().phase() == proto::RESUME_LEASE && roll(2) == 0) {
                    answerCheckOut(letter, code, static_cast<int>(letter.body.check_out().resume().number()),
                                   grace());
                } else if (letter.body.check_out().phase() == proto::TAKE && roll(3) == 0) {
                    answerPlace(letter, static_cast<int>(roll(3)));
                } else {
                    answerCheckOut(letter, code, ++lease_, grace());
                }
                break;
            case proto::ToEntity::kSetParam:
                reply(number, letter.body.set_param().request_id(), code);
                break;
            case proto::ToEntity::kRearm:
                reply(number, letter.body.rearm().request_id(), code);
                break;
            case proto::ToEntity::kTaskControl:
                if (code != RefusalCode::Ok) {
                    reply(number, letter.body.task_control().task_id(), code);
                    break;
                }
                [[fallthrough]];
            case proto::ToEntity::kTask: {
                const auto& bytes = letter.body.has_task() ? letter.body.task().task_id()
                                                           : letter.body.task_control().task_id();
                taskEvent(number, *Id128::fromBytes(bytes), static_cast<proto::TaskState>(1 + roll(10)));
                break;
            }
            case proto::ToEntity::kStatusRequest: {
                proto::ToClient message;
                message.mutable_status()->set_request_id(letter.body.status_request().request_id());
                message.mutable_status()->set_state(proto::REG);
                for (std::size_t i = tasks_.size() - std::min<std::size_t>(tasks_.size(), roll(4));
                     i < tasks_.size(); ++i) {
                    auto& event = *message.mutable_status()->add_tasks();
                    event.set_task_id(tasks_[i].bytes());
                    event.set_state(static_cast<proto::TaskState>(1 + roll(10)));
                }
                message.mutable_status()->add_services()->set_name("Driving");
                fromEntity(number, message);
                break;
            }
            case proto::ToEntity::kResourceOffer: {
                proto::ToClient message;
                if (roll(2) == 0) {
                    message.mutable_resource_credit()->set_transfer_id(
                        letter.body.resource_offer().transfer_id());
                } else {
                    message.mutable_resource_done()->set_transfer_id(
                        letter.body.resource_offer().transfer_id());
                }
                fromEntity(number, message);
                break;
            }
            case proto::ToEntity::kRelease:
                status(number, EntityState::IDLE, {}, letter.head.held);
                break;
            default:
                break;
        }
    }

    std::chrono::milliseconds grace() { return std::chrono::milliseconds(roll(2) * 5000); }

    SeededRandom dice_;
    std::map<int, int> answers_, step_of_;
    int chosen_ = 0;  // what the present step does
    int next_ = 0;
    int lease_ = 0;
    std::size_t texts_expected_ = 0;
    std::vector<Id128> tasks_, orders_;
    std::vector<SentMessage> letters_;
};

TEST(SessionCoreProperty, EveryRequestIsAnsweredExactlyOnceWhateverTheServersDo) {
    for (std::uint64_t seed = 1; seed <= 400; ++seed) {
        SCOPED_TRACE("seed " + std::to_string(seed));
        Chaos chaos(seed);
        chaos.run(400);
        if (::testing::Test::HasFailure()) break;
    }
}

}  // namespace
}  // namespace axon::client::test
