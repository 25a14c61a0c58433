// SPDX-License-Identifier: GPL-2.0-or-later
// The client library against the real servers, with the real core of the Entity Manager behind them and a
// robot application that lives in this file.
#include <axon/entitycomm.h>
#include <axon/link.pb.h>
#include <axon/messages.pb.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <axon/client.hpp>

#include <deque>
#include <fstream>
#include <future>
#include <thread>

#include "entity_manager/core/entity_manager_core.hpp"
#include "entity_manager/storage/file_resources.hpp"
#include "entity_manager/storage/file_storage.hpp"
#include "server/server.hpp"
#include "support/loopback.hpp"
#include "support/tcp_valve.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"
#include "transport/ice/timer_thread.hpp"

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;
using axon::test::loopbackAddress;
using axon::test::TcpValve;
using axon::test::waitUntil;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::SizeIs;
using transport::ByteRange;
using transport::toRange;
namespace slice = ::Axon::EntityComm;

constexpr const char* kServices = R"(<?xml version="1.0"?>
<ServiceProfile count="1">
  <Service name="Drive" global_id="drive" type="SMPL" pausable="true">
    <Parameters>
      <Param name="Distance" type="INPUT" data_type="INT" units="mm" required="true" minimum="-5000" maximum="5000"/>
      <Param name="Speed" type="CONFIG" data_type="DBL" units="mm/s" value="200" ready="true" savable="true"/>
    </Parameters>
    <Resources>
      <Resource name="Map" url="lab.map" savable="true"/>
    </Resources>
  </Service>
</ServiceProfile>)";

/// For what comes sooner or later: an entity that has left its server is lost after its grace of 5 s, and
/// some tests send ten thousand messages.
constexpr auto kPatience = 60s;

/// A robot with its Entity Manager. The application grants everything but a Speed above 700, and runs a task
/// until it is told to end it.
class TestRobot final : public entity_manager::BackEndPort, public entity_manager::ServerPort {
  public:
    TestRobot(const std::string& server, const std::string& name)
        : home_{std::filesystem::path(testing::TempDir()) /
                ("axon-client-" + Id128::uuid(random_).toString())},
          storage_(folder_),
          resources_(folder_),
          core_({name}, clock_, random_, *this, *this, storage_, resources_, stop_generations_),
          data_(transport::makeCommunicator({"robot-data", Lane::Data, 1, 1, {}})),
          signal_(transport::makeCommunicator({"robot-signal", Lane::Signal, 1, 1, {}})) {
        const auto callback = openLane(data_, transport::tcpEndpoint(server), data_session_);
        const auto facts = data_session_->setCallback(callback);
        const auto signal_callback = openLane(signal_, facts.signalEndpoint, signal_session_);
        signal_session_->attachSignalLane(facts.token, signal_callback);
        std::filesystem::create_directories(profiles());
        resources_.onAnswer([this] { onStrand([&] { core_.onStored(); }); });
        onStrand([&] {
            core_.start();
            core_.onLinkUp();
        });
        profile(false,
                "<BasicProfile name=\"" + name + "\" category=\"ROBOT\" type=\"MOBILE\" descr=\"a robot\"/>");
        profile(true, kServices);
        EXPECT_TRUE(wanted_);
        onStrand([&] { core_.onServerUp(); });
        beat_ =
            std::make_unique<transport::TimerThread>("robot-beat", Lane::Signal, Duration{}, clock_, [this] {
                signal_session_->ice_oneway()->ice_invocationTimeout(-1)->keepAliveAsync(1, nullptr,
                                                                                         [](auto) {});
                onStrand([&] { core_.onTimer(); });
                return clock_.now() + 20ms;
            });
    }
    ~TestRobot() override { leave(); }
    void leave() {
        beat_.reset();
        resources_.onAnswer({});
        data_.communicator()->destroy();
        signal_.communicator()->destroy();
    }

    void endTask(proto::TaskState state) {
        proto::EiToEm message;
        auto& event = *message.mutable_task()->mutable_event();
        event.set_task_id(lastTask());
        event.set_state(state);
        event.set_progress(1);
        fromApplication(std::move(message));
    }
    void text(const std::string& text) {
        proto::EiToEm message;
        message.mutable_text()->set_text(text);
        fromApplication(std::move(message));
    }
    void sample(const std::string& stream, double value) {
        proto::EiToEm message;
        message.mutable_sample()->set_stream(stream);
        message.mutable_sample()->mutable_scalar()->set_value(value);
        fromApplication(std::move(message));
    }
    std::string lastTask() {
        const std::lock_guard lock(seen_mutex_);
        return task_;
    }
    std::vector<std::string> texts() {
        const std::lock_guard lock(seen_mutex_);
        return texts_;
    }
    std::string uuid() {
        const std::lock_guard lock(strand_);
        return core_.uuid();
    }
    EntityState state() {
        const std::lock_guard lock(strand_);
        return core_.state();
    }
    std::filesystem::path folder() const { return folder_; }
    std::atomic<int> stops{0};
    std::atomic<bool> deaf{false};   ///< the application does not return from its stop callback
    std::atomic<bool> rolls{false};  ///< it comes to rest after that

  private:
    class Callback final : public slice::EntityCallback {
      public:
        explicit Callback(TestRobot& robot) : robot_(robot) {}
        void newClientMsg(Axon::CommUtil::Header head, ByteRange message, const Ice::Current&) override {
            robot_.onStrand([&] {
                robot_.core_.onClientMsg(transport::fromIce(std::move(head)), transport::toView(message));
            });
        }
        void newClientMsgDataSeq(Axon::CommUtil::Header head, ByteRange message,
                                 const Ice::Current& current) override {
            newClientMsg(std::move(head), message, current);
        }
        void stopSignal(Axon::CommUtil::Header ice_head, Axon::CommUtil::StopCause cause,
                        const Ice::Current&) override {
            const auto head = transport::fromIce(std::move(ice_head));
            if (cause == Axon::CommUtil::StopCause::Drill) {
                const auto number = robot_.stop_generations_.drill(head.sender.id, head.sequence);
                if (!number) return;
                robot_.stop(*number, StopCause::Drill);
                robot_.onStrand([&] { robot_.core_.onDrill(head, *number); });
                return;
            }
            const auto generation = robot_.stop_generations_.raise(head.sender.id, head.sequence);
            if (!generation) return;
            robot_.stop(*generation, transport::fromIce(cause));
            robot_.onStrand([&] { robot_.core_.onStopSignal(head, transport::fromIce(cause), *generation); });
        }
        void resetSignal(Axon::CommUtil::Header head, const Ice::Current&) override {
            robot_.onStrand([&] { robot_.core_.onResetSignal(transport::fromIce(std::move(head))); });
        }
        void clearSignal(Axon::CommUtil::Header head, const Ice::Current&) override {
            robot_.onStrand([&] { robot_.core_.onClearSignal(transport::fromIce(std::move(head))); });
        }
        void newClientUpdate(Axon::CommUtil::Header head, Axon::CommUtil::ClientChange change,
                             const Ice::Current&) override {
            robot_.onStrand([&] {
                robot_.core_.onClientUpdate(transport::fromIce(std::move(head)), transport::fromIce(change));
            });
        }
        void newRefusalMsg(Axon::CommUtil::Header, int, std::string, const Ice::Current&) override {}
        void newHeartbeat(double, const Ice::Current&) override {
            robot_.onStrand([&] { robot_.core_.onServerHeartbeat(); });
        }

      private:
        TestRobot& robot_;
    };

    std::shared_ptr<slice::EntityCallbackPrx> openLane(const Ice::CommunicatorHolder& home,
                                                       const std::string& endpoint,
                                                       std::shared_ptr<slice::EntitySessionPrx>& session) {
        const auto gate =
            Ice::uncheckedCast<slice::EntityGatePrx>(home.communicator()
                                                         ->stringToProxy("EntityGate:" + endpoint)
                                                         ->ice_context(transport::contractContext()));
        const auto opened = gate->open("", "");
        const auto connection = gate->ice_getCachedConnection();
        const auto adapter = home.communicator()->createObjectAdapter("");
        auto callback = Ice::uncheckedCast<slice::EntityCallbackPrx>(
            adapter->addWithUUID(std::make_shared<Callback>(*this)));
        adapter->activate();
        connection->setAdapter(adapter);
        session =
            Ice::uncheckedCast<slice::EntitySessionPrx>(connection->createProxy(opened->ice_getIdentity()));
        return callback;
    }

    /// One event at a time; what the application answers to it comes after it.
    template <class Event>
    void onStrand(Event event) {
        const std::lock_guard lock(strand_);
        event();
        while (true) {
            proto::EiToEm next;
            {
                const std::lock_guard answers(answers_mutex_);
                if (answers_.empty()) return;
                next = std::move(answers_.front());
                answers_.pop_front();
            }
            core_.onLinkMessage(std::move(next));
        }
    }
    std::filesystem::path profiles() const { return folder_ / "profiles"; }
    void fromApplication(proto::EiToEm message) {
        onStrand([&] { core_.onLinkMessage(std::move(message)); });
    }
    void profile(bool services, const std::string& xml) {
        proto::EiToEm message;
        message.mutable_profile()->set_services(services);
        message.mutable_profile()->set_file_name("profile.xml");
        message.mutable_profile()->set_folder(profiles());
        message.mutable_profile()->set_xml(xml);
        fromApplication(std::move(message));
    }
    void answer(proto::EiToEm message) {
        const std::lock_guard lock(answers_mutex_);
        answers_.push_back(std::move(message));
    }

    // BackEndPort: the application.
    bool send(const proto::EmToEi& message) override {
        proto::EiToEm out;
        if (message.has_param()) {
            out.mutable_answer()->set_request(message.param().request());
            if (message.param().param().values(0).dbl() > 700) {
                out.mutable_answer()->mutable_refusal()->set_code(proto::DENIED);
                out.mutable_answer()->mutable_refusal()->set_message("too fast");
            }
            answer(out);
        } else if (message.has_resource()) {
            out.mutable_answer()->set_request(message.resource().request());
            answer(out);
        } else if (message.has_task()) {
            {
                const std::lock_guard lock(seen_mutex_);
                task_ = message.task().task_id();
            }
            out.mutable_task_answer()->set_task_id(message.task().task_id());
            answer(out);
        } else if (message.has_pause() || message.has_cancel()) {
            auto& event = *out.mutable_task()->mutable_event();
            event.set_progress(-1);
            event.set_task_id(message.has_pause() ? message.pause().task_id() : message.cancel().task_id());
            event.set_state(message.has_cancel()       ? proto::TASK_CANCELLED
                            : message.pause().resume() ? proto::TASK_RUNNING
                                                       : proto::TASK_PAUSED);
            answer(out);
        } else if (message.has_text()) {
            const std::lock_guard lock(seen_mutex_);
            texts_.push_back(message.text().text());
        }
        return true;
    }
    void stop(std::uint32_t generation, StopCause cause) override {
        if (cause == StopCause::Drill) {  // the Entity Interfacer's answer; the application is not called
            proto::EiToEm done;
            done.mutable_stop_done()->set_drill(generation);
            done.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
            answer(done);
            return;
        }
        ++stops;
        if (deaf) return;
        proto::EiToEm done;
        done.mutable_stop_done()->set_stop_generation(generation);
        done.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
        done.mutable_stop_done()->set_standstill_follows(rolls);
        answer(done);
        if (rolls) {
            done.mutable_stop_done()->set_stage(proto::StopReceipt::STANDSTILL);
            answer(done);
        }
        const auto task = lastTask();
        if (task.empty()) return;
        proto::EiToEm ended;
        ended.mutable_task()->mutable_event()->set_task_id(task);
        ended.mutable_task()->mutable_event()->set_state(proto::TASK_STOPPED);
        ended.mutable_task()->mutable_event()->set_progress(-1);
        answer(ended);
    }
    void setBusy(bool) override {}

    // ServerPort.
    void wantConnection(bool wanted) override { wanted_ = wanted; }
    void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) override {
        const auto bytes = profile.SerializeAsString();
        data_session_->sendBasicPrfl(transport::toIce(registration), toRange(bytes), {});
    }
    void sendStatus(const EntityStatus& status) override {
        data_session_->ice_oneway()->sendStatusAsync(transport::toIce(status), nullptr, [](auto) {});
    }
    void sendToClient(Lane lane, const Header& head, const proto::ToClient& message) override {
        const auto bytes = message.SerializeAsString();
        const auto& session = lane == Lane::Signal ? signal_session_ : data_session_;
        session->ice_oneway()->sendToClientAsync(transport::toIce(head), toRange(bytes), nullptr,
                                                 [](auto) {});
    }
    void sendToPeer(Lane, const Header&, const proto::ToEntity&) override {}
    void sendToClientDataSeq(const Header& head, const proto::ToClient& message) override {
        const auto bytes = message.SerializeAsString();
        data_session_->ice_oneway()->sendToClientDataSeqAsync(transport::toIce(head), toRange(bytes), nullptr,
                                                              [](auto) {});
    }

    SteadyClock clock_;
    SystemRandom random_;
    /// Goes when the threads of the stores have ended.
    struct Home {
        const std::filesystem::path folder;
        ~Home() { std::filesystem::remove_all(folder); }
    } home_;
    const std::filesystem::path& folder_ = home_.folder;
    entity_manager::FileStorage storage_;
    entity_manager::FileResourceStore resources_;
    entity_manager::StopGenerations stop_generations_;
    std::mutex answers_mutex_;
    std::deque<proto::EiToEm> answers_;  // guarded by answers_mutex_
    std::mutex strand_;
    entity_manager::EntityManagerCore core_;  // guarded by strand_
    bool wanted_ = false;
    std::mutex seen_mutex_;
    std::string task_;                // guarded by seen_mutex_
    std::vector<std::string> texts_;  // guarded by seen_mutex_
    Ice::CommunicatorHolder data_, signal_;
    std::shared_ptr<slice::EntitySessionPrx> data_session_, signal_session_;
    std::unique_ptr<transport::TimerThread> beat_;
};

server::ServerSettings onLoopback() {
    const auto any_port = loopbackAddress() + ":0";
    server::ServerSettings settings;
    settings.client_endpoint = settings.client_signal_endpoint = any_port;
    settings.entity_endpoint = settings.entity_signal_endpoint = any_port;
    return settings;
}

class ClientTest : public ::testing::Test {
  protected:
    Options options() const {
        Options options;
        options.server = server->clientAddress(Lane::Data);
        options.display_name = "client1@lab";
        return options;
    }
    std::unique_ptr<Client> client(const Options& with) const {
        auto connected = Client::connect(with);
        EXPECT_TRUE(connected.ok()) << connected.refusal().message;
        return std::move(connected).value();
    }
    std::unique_ptr<Client> client() const { return client(options()); }
    std::unique_ptr<TestRobot> robot(const std::string& name = "PeopleBot") const {
        return std::make_unique<TestRobot>(server->entityAddress(Lane::Data), name);
    }
    static CheckOut take(Client& from, const std::string& name = "PeopleBot") {
        EXPECT_TRUE(from.waitFor(name, 5s).ok());
        auto taken = from.checkOut(name);
        EXPECT_TRUE(taken.ok()) << taken.refusal().message;
        return std::move(taken).value();
    }
    /// The reason, once `held` is lost. The client may tell it when the test has ended.
    static std::future<Refusal> lossOf(const CheckOut& held) {
        const auto lost = std::make_shared<std::promise<Refusal>>();
        held.onLost([lost](const Refusal& why) { lost->set_value(why); });
        return lost->get_future();
    }
    /// A task that runs.
    static Task drive(const CheckOut& held, TestRobot& robot) {
        auto task = held.run("Drive", {{"Distance", {std::string("1000mm")}, "", true}});
        EXPECT_TRUE(waitUntil([&] { return task.report().state == TaskState::Running; }))
            << toString(task.report().state) << " " << task.report().reason.message;
        EXPECT_FALSE(robot.lastTask().empty());
        return task;
    }

    std::unique_ptr<server::Server> server = std::make_unique<server::Server>(onLoopback());
};

TEST_F(ClientTest, NobodyThereIsAnAnswerWithTheMend) {
    auto nowhere = options();
    nowhere.server = loopbackAddress() + ":1";
    const auto refused = Client::connect(nowhere);
    ASSERT_FALSE(refused.ok());
    EXPECT_EQ(refused.refusal().code, RefusalCode::Unavailable);
    EXPECT_THAT(refused.refusal().message, HasSubstr("axon-server"));
    nowhere.server = "not an address";
    EXPECT_EQ(Client::connect(nowhere).refusal().code, RefusalCode::Malformed);
    nowhere.server = "http://127.0.0.1:10417/";
    const auto page = Client::connect(nowhere);
    ASSERT_FALSE(page.ok());
    EXPECT_EQ(page.refusal().code, RefusalCode::Malformed);
    EXPECT_THAT(page.refusal().message, AllOf(HasSubstr("web console"), HasSubstr("10410")));
}

TEST_F(ClientTest, KnowsWhoIsThereAsSoonAsItIsConnected) {
    const auto first = robot();
    const auto second = robot();
    const auto early = client();
    ASSERT_TRUE(waitUntil([&] { return early->entities().size() == 2; }));
    const auto late = client();
    EXPECT_THAT(late->entities(), SizeIs(2));
    EXPECT_EQ(late->find("PeopleBot").refusal().code, RefusalCode::AmbiguousEntity);
    EXPECT_EQ(late->find(first->uuid())->name, "PeopleBot");
    EXPECT_TRUE(late->find("PeopleBot#2").ok());
    EXPECT_EQ(late->self().name, "client1@lab");
}

TEST_F(ClientTest, RunsATaskFromCheckOutToRelease) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    EXPECT_EQ(held.services().at(0).name, "Drive");
    auto task = drive(held, *robots);
    std::promise<TaskReport> told;
    task.onUpdate([&, once = false](const TaskReport& report) mutable {
        if (isFinal(report.state) && !once) told.set_value(report);
        once = once || isFinal(report.state);
    });
    robots->endTask(proto::TASK_SUCCEEDED);
    EXPECT_EQ(task.wait(5s).state, TaskState::Succeeded);
    EXPECT_EQ(told.get_future().get().state, TaskState::Succeeded);
    EXPECT_TRUE(held.release().ok());
    EXPECT_EQ(held.sendText("too late").refusal().code, RefusalCode::NotHolder);
    EXPECT_EQ(robots->state(), EntityState::IDLE);
}

TEST_F(ClientTest, TheApplicationsReasonReachesTheClient) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    EXPECT_TRUE(held.set("Drive", {"Speed", {250.0}}).ok());
    const auto refused = held.set("Drive", {"Speed", {std::int64_t{900}}});
    EXPECT_EQ(refused.refusal().code, RefusalCode::Denied);
    EXPECT_THAT(refused.refusal().message, HasSubstr("too fast"));
}

TEST_F(ClientTest, AHeldEntityIsRefusedWithItsHoldersNameAndSeveralAllOrNone) {
    const auto first = robot("First");
    const auto second = robot("Second");
    const auto client1 = client();
    auto other = options();
    other.display_name = "client2@lab";
    const auto client2 = client(other);
    const auto held = take(*client1, "Second");
    ASSERT_TRUE(client2->waitFor("First", 5s).ok());
    const auto refused = client2->checkOut(std::vector<std::string>{"First", "Second"});
    ASSERT_FALSE(refused.ok());
    EXPECT_EQ(refused.refusal().code, RefusalCode::AlreadyHeld);
    EXPECT_EQ(refused.refusal().holder, "client1@lab");
    EXPECT_TRUE(client2->held().empty());
    ASSERT_TRUE(held.release().ok());
    ASSERT_TRUE(waitUntil([&] { return first->state() == EntityState::IDLE; }))
        << "the reservation was given back";
    const auto both = client2->checkOut(std::vector<std::string>{"First", "Second"});
    ASSERT_TRUE(both.ok()) << both.refusal().message;
    EXPECT_THAT(client2->held(), SizeIs(2));
}

TEST_F(ClientTest, WhoIsRefusedAndEndsAtOnceLeavesNothingReserved) {
    const auto first = robot("First");
    const auto second = robot("Second");
    const auto holder = client();
    const auto held = take(*holder, "Second");
    for (int i = 0; i < 50; ++i) {
        const auto refused = client();
        ASSERT_TRUE(refused->waitFor("First", 5s).ok());
        ASSERT_FALSE(refused->checkOut(std::vector<std::string>{"First", "Second"}).ok());
        refused->close();
        const auto free = holder->checkOut("First");
        ASSERT_TRUE(free.ok()) << "trial " << i << ": " << free.refusal().message;
        ASSERT_TRUE(free->release().ok());
    }
}

TEST_F(ClientTest, AStopIsConfirmedLatchesAndIsRearmed) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    const auto task = drive(held, *robots);
    const auto receipts = me->stop({"PeopleBot"});
    ASSERT_TRUE(receipts.ok());
    ASSERT_THAT(receipts.value(), SizeIs(1));
    EXPECT_TRUE(receipts->front().confirmed());
    EXPECT_TRUE(receipts->front().server);
    EXPECT_EQ(task.wait(5s).state, TaskState::Stopped);
    auto refused = held.run("Drive", {{"Distance", {std::int64_t{1}}}});
    EXPECT_EQ(refused.wait(5s).reason.code, RefusalCode::Latched);
    ASSERT_TRUE(me->rearm("PeopleBot").ok());
    drive(held, *robots);
}

TEST_F(ClientTest, StandstillIsToldToWhoeverStoppedItAndOfARobotThatStoodNobodyWaits) {
    const auto robots = robot();
    robots->rolls = true;
    const auto me = client();
    auto with = options();
    with.display_name = "client2@lab";
    const auto other = client(with);
    ASSERT_TRUE(other->waitFor("PeopleBot", 5s).ok());
    const auto held = take(*me);
    for (auto* who : {me.get(), other.get()}) {
        drive(held, *robots);
        const auto receipts = who->stop({"PeopleBot"}, 1s, 5s);
        ASSERT_TRUE(receipts.ok());
        ASSERT_THAT(receipts.value(), SizeIs(1));
        EXPECT_TRUE(receipts->front().standstill);
        ASSERT_TRUE(waitUntil([&] { return me->rearm("PeopleBot").ok(); })) << "once it knows of the stop";
    }
    const auto receipts = me->stop({"PeopleBot"}, 1s, 60s);
    ASSERT_TRUE(receipts.ok());
    EXPECT_FALSE(receipts->front().standstill_follows) << "nothing moved";
}

TEST_F(ClientTest, AResetAndAClearSayWhatTheyHaveDone) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    auto done = held.reset();
    ASSERT_TRUE(done.ok()) << done.refusal().message;
    EXPECT_TRUE(done->confirmed());
    EXPECT_EQ(done->tasks_ended, 0);
    const auto first = drive(held, *robots);
    done = held.reset();
    ASSERT_TRUE(done.ok()) << done.refusal().message;
    EXPECT_EQ(done->tasks_ended, 1);
    EXPECT_EQ(first.wait(5s).state, TaskState::Stopped);
    drive(held, *robots);
    const auto waiting = held.run("Drive", {{"Distance", {std::int64_t{1}}}});
    ASSERT_TRUE(waitUntil([&] { return waiting.report().accepted; })) << "or the clear is there before it";
    done = held.clear();
    ASSERT_TRUE(done.ok()) << done.refusal().message;
    EXPECT_EQ(done->tasks_ended, 1);
    EXPECT_EQ(done->tasks_removed, 1);
    robots->deaf = true;
    const auto begin = std::chrono::steady_clock::now();
    done = held.clear();
    ASSERT_TRUE(done.ok()) << "the Entity Manager has it";
    EXPECT_FALSE(done->confirmed());
    EXPECT_GE(std::chrono::steady_clock::now() - begin, 1s);
    ASSERT_TRUE(held.release().ok());
    EXPECT_EQ(held.reset().refusal().code, RefusalCode::NotHolder);
}

TEST_F(ClientTest, AnybodyStopsEverythingAndALateStageIsShownAsMissing) {
    const auto first = robot("First");
    const auto second = robot("Second");
    second->deaf = true;
    const auto me = client();
    ASSERT_TRUE(me->waitFor("First", 5s).ok() && me->waitFor("Second", 5s).ok());
    const auto receipts = me->stop({}, 400ms);
    ASSERT_TRUE(receipts.ok());
    ASSERT_THAT(receipts.value(), SizeIs(2));
    for (const auto& receipt : receipts.value()) EXPECT_EQ(receipt.confirmed(), receipt.name == "First");
    EXPECT_EQ(first->stops, 1) << "sent again on both lanes, and taken for the same stop";
}

TEST_F(ClientTest, PausesResumesAndCancels) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    const auto task = drive(held, *robots);
    EXPECT_TRUE(task.pause().ok());
    EXPECT_EQ(task.report().state, TaskState::Paused);
    EXPECT_TRUE(task.resume().ok());
    EXPECT_TRUE(task.cancel().ok());
    EXPECT_EQ(task.wait(5s).state, TaskState::Cancelled);
    EXPECT_EQ(task.pause().refusal().code, RefusalCode::WrongState);
}

TEST_F(ClientTest, UploadsAFileInItsWindow) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    const auto path = robots->folder() / "lab.map";
    constexpr std::size_t kSize = 1'500'000;
    std::ofstream(path) << std::string(kSize, 'm');
    std::uint64_t last = 0;
    const auto uploaded = held.upload("Drive", "Map", path, [&](std::uint64_t sent, std::uint64_t total) {
        EXPECT_EQ(total, kSize);
        EXPECT_GE(sent, last);
        last = sent;
    });
    EXPECT_TRUE(uploaded.ok()) << uploaded.refusal().message;
    EXPECT_EQ(last, kSize);
    EXPECT_EQ(held.upload("Drive", "Mapp", path).refusal().code, RefusalCode::UnknownResource);
    std::filesystem::resize_file(path, 1ULL << 40U);  // of holes; to hash it would take an hour
    const auto refused = held.upload("Drive", "Map", path).refusal();
    EXPECT_EQ(refused.code, RefusalCode::TooLarge);
    EXPECT_THAT(refused.message,
                HasSubstr("takes at most 1073741824. Upload a smaller one, or raise Axon.ResourceBytesMax"));
    EXPECT_EQ(held.upload("Drive", "Map", robots->folder() / "none").refusal().code,
              RefusalCode::UnknownResource);
}

TEST_F(ClientTest, AnUploadThatWasGivenUpGoesOnUnderTheSameCheckOutAndUnderTheNext) {
    const auto robots = robot();
    const auto me = client();
    auto held = take(*me);
    const auto path = robots->folder() / "lab.map";
    constexpr std::size_t kSize = 1'500'000;
    std::ofstream(path) << std::string(kSize, 'm');
    std::stop_source give_up;
    std::uint64_t last = 0;
    const auto giveUpBehind = [&](std::uint64_t end) {
        give_up = std::stop_source();
        std::optional<std::uint64_t> first;
        const auto ended = held.upload(
            "Drive", "Map", path,
            [&](std::uint64_t sent, std::uint64_t) {
                if (!first) first = sent;
                last = sent;
                if (sent > end) give_up.request_stop();
            },
            give_up.get_token());
        EXPECT_EQ(ended.refusal().code, RefusalCode::Cancelled);
        EXPECT_LT(last, kSize);
        return first;
    };
    giveUpBehind(kSize / 3);
    const auto before = last;
    EXPECT_EQ(giveUpBehind(kSize / 2), before);
    ASSERT_TRUE(held.release().ok());
    held = take(*me);
    std::optional<std::uint64_t> first;
    const auto uploaded = held.upload("Drive", "Map", path, [&](std::uint64_t sent, std::uint64_t) {
        if (!first) first = sent;
    });
    EXPECT_TRUE(uploaded.ok()) << uploaded.refusal().message;
    EXPECT_EQ(first, last) << "where the one before ended";
}

TEST_F(ClientTest, TextsAndStreamsArriveInOrder) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    ASSERT_TRUE(held.sendText("hello").ok());
    EXPECT_TRUE(waitUntil([&] { return robots->texts() == std::vector<std::string>{"hello"}; }));
    std::mutex mutex;
    std::vector<std::string> texts, samples;
    held.onText([&](const std::string& text) {
        const std::lock_guard lock(mutex);
        texts.push_back(text);
    });
    auto watching = me->watch("PeopleBot", {"battery"}, [&](const Sample& sample) {
        const std::lock_guard lock(mutex);
        samples.push_back(sample.json());
    });
    ASSERT_TRUE(watching.ok());
    ASSERT_TRUE(waitUntil([&] {
        robots->sample("battery", 12.5);
        const std::lock_guard lock(mutex);
        return !samples.empty();
    }));
    for (int i = 0; i < 50; ++i) robots->text(std::to_string(i));
    ASSERT_TRUE(waitUntil([&] {
        const std::lock_guard lock(mutex);
        return texts.size() == 50;
    }));
    const std::lock_guard lock(mutex);
    for (int i = 0; i < 50; ++i) EXPECT_EQ(texts[static_cast<std::size_t>(i)], std::to_string(i));
    EXPECT_THAT(samples.front(), HasSubstr("12.5"));
}

TEST_F(ClientTest, ADestroyedClientLeavesAStoppedAndFreeRobot) {
    const auto robots = robot();
    Task task = [&] {
        const auto me = client();
        return drive(take(*me), *robots);
    }();
    EXPECT_TRUE(isFinal(task.report().state));
    EXPECT_GE(robots->stops, 1);
    EXPECT_TRUE(waitUntil([&] { return robots->state() == EntityState::IDLE; }));
    EXPECT_FALSE(task.pause().ok());
}

TEST_F(ClientTest, AnEntityThatLeavesIsLostWithAReason) {
    auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    const auto task = drive(held, *robots);
    auto why = lossOf(held);
    robots->leave();
    ASSERT_EQ(why.wait_for(kPatience), std::future_status::ready);
    EXPECT_FALSE(why.get().message.empty());
    EXPECT_EQ(task.wait(5s).state, TaskState::Unknown);
}

/// For a server that comes back in the place of this one.
server::ServerSettings atItsPorts(const server::Server& server) {
    auto same = onLoopback();
    same.client_endpoint = server.clientAddress(Lane::Data);
    same.client_signal_endpoint = server.clientAddress(Lane::Signal);
    same.entity_endpoint = server.entityAddress(Lane::Data);
    same.entity_signal_endpoint = server.entityAddress(Lane::Signal);
    return same;
}

TEST_F(ClientTest, ALostServerIsToldAndTheClientComesBack) {
    const auto settings = atItsPorts(*server);
    auto robots = robot();
    auto with = options();
    with.resume = false;
    const auto me = client(with);
    const auto held = take(*me);
    const auto task = drive(held, *robots);
    std::atomic<int> up{0}, down{0};
    me->onConnection([&](bool connected, const std::string&) { ++(connected ? up : down); });
    server.reset();
    ASSERT_TRUE(waitUntil([&] { return down == 1; }));
    EXPECT_FALSE(me->connected());
    EXPECT_EQ(task.wait(5s).reason.code, RefusalCode::OutcomeUnknown);
    EXPECT_EQ(me->stop({}).refusal().code, RefusalCode::NotConnected);
    robots->leave();

    server = std::make_unique<server::Server>(settings);
    const auto again = robot();
    ASSERT_TRUE(waitUntil([&] { return up == 1; }));
    drive(take(*me), *again);
}

TEST_F(ClientTest, KeepsItsSessionWithWatchdogsOfTheServerThatItHasReconnectedTo) {
    auto settings = atItsPorts(*server);
    const auto me = client();
    std::atomic<int> up{0}, down{0};
    me->onConnection([&](bool connected, const std::string&) { ++(connected ? up : down); });
    const SteadyClock clock{};
    int restarts = 0;
    // With a heartbeat every 2 s, as is right for the first server, the second loses its client within 1 s.
    for (const auto& [busy, idle] : {std::pair{400ms, 1000ms}, std::pair{1500ms, 1500ms}}) {
        server.reset();
        settings.front_end.watchdog_busy = busy;
        settings.front_end.watchdog_idle = idle;
        server = std::make_unique<server::Server>(settings);
        ++restarts;
        ASSERT_TRUE(waitUntil([&] { return down == restarts && up == restarts; }));
        const auto its_robot = robot();
        const auto lives = [&](Duration time) {
            const auto end = clock.now() + time;
            return waitUntil([&] { return clock.now() > end || down > restarts; }) && down == restarts;
        };
        EXPECT_TRUE(lives(3 * idle)) << "without a lease";
        const auto held = take(*me);
        EXPECT_TRUE(lives(2 * idle)) << "with one";
        const auto task = drive(held, *its_robot);
        EXPECT_TRUE(lives(3 * busy)) << "with a task";
        its_robot->endTask(proto::TASK_SUCCEEDED);
        EXPECT_EQ(task.wait(5s).state, TaskState::Succeeded);
        EXPECT_TRUE(lives(2 * idle)) << "after it";
        its_robot->leave();
    }
}

TEST_F(ClientTest, AnOperatorWhoIsNotThereStopsTheRobot) {
    const auto robots = robot();
    auto with = options();
    std::atomic<bool> there{true};
    with.keep_running = [&] { return there.load(); };
    with.reconnect = false;
    const auto me = client(with);
    const auto held = take(*me);
    drive(held, *robots);
    EXPECT_EQ(robots->stops, 0);
    there = false;
    EXPECT_TRUE(waitUntil([&] { return robots->stops >= 1; }));
}

TEST_F(ClientTest, WaitingInACallbackIsAMisuseThatIsNamed) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    std::promise<bool> threw;
    const auto task = drive(held, *robots);
    task.onUpdate([&, told = false](const TaskReport&) mutable {
        if (std::exchange(told, true)) return;
        try {
            (void)held.set("Drive", {"Speed", {250.0}});
            threw.set_value(false);
        } catch (const std::logic_error&) {
            threw.set_value(true);
        }
    });
    EXPECT_TRUE(threw.get_future().get());
}

TEST_F(ClientTest, ManyThreadsMayUseOneClient) {
    const auto robots = robot();
    const auto me = client();
    const auto held = take(*me);
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; ++t) {
        threads.emplace_back([&, t] {
            for (int i = 0; i < 50; ++i) {
                switch (t) {
                    case 0:
                        EXPECT_TRUE(held.set("Drive", {"Speed", {100.0 + i}}).ok());
                        break;
                    case 1:
                        EXPECT_TRUE(me->services("PeopleBot").ok());
                        break;
                    case 2:
                        EXPECT_TRUE(held.sendText("x").ok());
                        break;
                    default:
                        EXPECT_TRUE(me->find("PeopleBot").ok());
                }
            }
        });
    }
    for (auto& thread : threads) thread.join();
    EXPECT_TRUE(waitUntil([&] { return robots->texts().size() == 50; }));
}

class OwnershipTest : public ClientTest {
  protected:
    std::unique_ptr<Client> named(const std::string& name) const {
        auto with = options();
        with.display_name = name;
        return client(with);
    }
    /// A client whose connection the valve can cut.
    std::unique_ptr<Client> behind(TcpValve& valve) const {
        auto with = options();
        with.server = valve.address();
        return client(with);
    }
};

/// Bursts are written together, large messages alone, and what meets a full socket waits: by turns.
TEST_F(OwnershipTest, WhatWasAcceptedArrivesOnceWholeAndInOrderHoweverItIsWritten) {
    const auto robots = robot();
    TcpValve valve(server->clientAddress(Lane::Data));
    const auto me = behind(valve);
    const auto held = take(*me);
    std::vector<std::string> accepted;
    const auto next = [&] {
        const auto number = accepted.size();
        return std::to_string(number) + std::string(number % 7 == 0 ? 20'000 : number % 50, '.');
    };
    for (const int turn : {1, 2, 3}) {
        valve.hold(true);
        auto sent = held.sendText(next());
        for (; sent.ok() && accepted.size() < 100'000; sent = held.sendText(next()))
            accepted.push_back(next());
        EXPECT_EQ(sent.refusal().code, RefusalCode::Overloaded) << "turn " << turn;
        valve.hold(false);
        int burst = 0;  // while the others are under way
        ASSERT_TRUE(waitUntil([&] {
            while (burst < 500 && held.sendText(next()).ok()) {
                accepted.push_back(next());
                ++burst;
            }
            return burst == 500;
        }));
        EXPECT_TRUE(waitUntil([&] { return robots->texts().size() >= accepted.size(); }, kPatience));
    }
    EXPECT_TRUE(robots->texts() == accepted)
        << accepted.size() << " accepted, " << robots->texts().size() << " arrived";
}

TEST_F(OwnershipTest, ALostConnectionIsResumedUnderTheSameLease) {
    const auto robots = robot();
    TcpValve valve(server->clientAddress(Lane::Data));
    const auto me = behind(valve);
    const auto held = take(*me);
    const auto ticket = held.ticket();
    const auto task = drive(held, *robots);
    std::atomic<int> resumed{0}, lost{0};
    held.onResumed([&] { ++resumed; });
    held.onLost([&](const Refusal&) { ++lost; });
    valve.cut();
    ASSERT_TRUE(waitUntil([&] { return held.orphaned(); }));
    EXPECT_EQ(held.sendText("x").refusal().code, RefusalCode::NotConnected);
    ASSERT_TRUE(waitUntil([&] { return robots->stops >= 1; })) << "nobody drives it any more";
    valve.open();
    ASSERT_TRUE(waitUntil([&] { return resumed == 1; }));
    EXPECT_EQ(lost, 0);
    EXPECT_EQ(held.ticket(), ticket);
    EXPECT_EQ(task.wait(5s).state, TaskState::Stopped) << "told as it ended";
    auto refused = held.run("Drive", {{"Distance", {std::int64_t{1}}}});
    EXPECT_EQ(refused.wait(5s).reason.code, RefusalCode::Latched) << "coming back starts nothing";
    ASSERT_TRUE(me->rearm("PeopleBot").ok());
    drive(held, *robots);
}

TEST_F(OwnershipTest, WithoutResumingTheLeaseIsLostWithTheConnection) {
    const auto robots = robot();
    TcpValve valve(server->clientAddress(Lane::Data));
    auto with = options();
    with.server = valve.address();
    with.resume = false;
    const auto me = client(with);
    const auto held = take(*me);
    auto why = lossOf(held);
    valve.cut();
    ASSERT_EQ(why.wait_for(kPatience), std::future_status::ready);
    EXPECT_EQ(why.get().code, RefusalCode::NotConnected);
}

TEST_F(OwnershipTest, ATicketTakesTheLeaseToAnotherClientAndStopsTheRobotFirst) {
    const auto robots = robot();
    const auto client1 = named("client1@lab");
    const auto held = take(*client1);
    drive(held, *robots);
    auto why = lossOf(held);
    const auto client2 = named("client1@lab, restarted");
    const auto ticket = held.ticket();
    const auto resumed = client2->resume(ticket);
    ASSERT_TRUE(resumed.ok()) << resumed.refusal().message;
    EXPECT_EQ(resumed->ticket(), ticket) << "the same lease";
    EXPECT_GE(robots->stops, 1);
    ASSERT_EQ(why.wait_for(kPatience), std::future_status::ready);
    EXPECT_TRUE(held.ticket().empty()) << "it is no longer the first one's";
    EXPECT_TRUE(resumed->sendText("here I am").ok());
}

TEST_F(OwnershipTest, WhoWaitsIsToldItsPlaceAndIsNext) {
    const auto robots = robot();
    const auto client1 = named("client1@lab");
    const auto client2 = named("client2@lab");
    const auto held = take(*client1);
    ASSERT_TRUE(client2->waitFor("PeopleBot", 5s).ok());
    CheckOutOptions options;
    options.wait = 20s;
    std::atomic<int> place{0};
    options.on_waiting = [&](const Waiting& waiting) { place = waiting.place; };
    auto granted = std::async(std::launch::async, [&] { return client2->checkOut("PeopleBot", options); });
    ASSERT_TRUE(waitUntil([&] { return place == 1; }));
    EXPECT_TRUE(waitUntil([&] { return client1->find("PeopleBot")->waiting == 1; }));
    ASSERT_TRUE(held.release().ok());
    const auto now = granted.get();
    ASSERT_TRUE(now.ok()) << now.refusal().message;
    EXPECT_TRUE(now->sendText("mine").ok());
}

TEST_F(OwnershipTest, AWaitThatIsGivenUpLeavesTheLine) {
    const auto robots = robot();
    const auto client1 = named("client1@lab");
    const auto client2 = named("client2@lab");
    const auto held = take(*client1);
    ASSERT_TRUE(client2->waitFor("PeopleBot", 5s).ok());
    std::stop_source give_up;
    CheckOutOptions options;
    options.wait = 20s;
    options.give_up = give_up.get_token();
    options.on_waiting = [&](const Waiting&) { give_up.request_stop(); };
    EXPECT_EQ(client2->checkOut("PeopleBot", options).refusal().code, RefusalCode::Cancelled);
    EXPECT_TRUE(waitUntil([&] { return client1->find("PeopleBot")->waiting == 0; }));
}

TEST_F(OwnershipTest, TheHolderIsAskedAndItsAnswerCounts) {
    const auto robots = robot();
    const auto client1 = named("client1@lab");
    const auto client2 = named("client2@lab");
    const auto held = take(*client1);
    drive(held, *robots);
    std::atomic<bool> accept{false};
    held.onHandOverRequest([&](const HandOverRequest& request) {
        EXPECT_EQ(request.by, "client2@lab");
        EXPECT_EQ(request.reason, "a demonstration");
        EXPECT_TRUE(held.answerHandOver(accept, "because").ok());
    });
    auto why = lossOf(held);
    CheckOutOptions options;
    options.ask = true;
    options.reason = "a demonstration";
    ASSERT_TRUE(client2->waitFor("PeopleBot", 5s).ok());
    const auto refused = client2->checkOut("PeopleBot", options);
    EXPECT_EQ(refused.refusal().code, RefusalCode::HandOverRefused) << refused.refusal().message;
    EXPECT_EQ(robots->stops, 0) << "a refusal disturbs nobody";
    accept = true;
    const auto granted = client2->checkOut("PeopleBot", options);
    ASSERT_TRUE(granted.ok()) << granted.refusal().message;
    EXPECT_GE(robots->stops, 1) << "a moving robot is never handed over";
    ASSERT_EQ(why.wait_for(kPatience), std::future_status::ready);
    EXPECT_EQ(why.get().code, RefusalCode::RevokedLease);
}

TEST_F(OwnershipTest, AnAdminTakesOverAndTheLoserIsTold) {
    const auto robots = robot();
    const auto client1 = named("client1@lab");
    const auto admin = named("client2@lab");
    ASSERT_EQ(admin->self().role, Role::Admin) << "of this process's own user on loopback";
    const auto held = take(*client1);
    const auto task = drive(held, *robots);
    auto why = lossOf(held);
    CheckOutOptions options;
    options.force = true;
    options.reason = "fire drill";
    ASSERT_TRUE(admin->waitFor("PeopleBot", 5s).ok());
    const auto granted = admin->checkOut("PeopleBot", options);
    ASSERT_TRUE(granted.ok()) << granted.refusal().message;
    ASSERT_EQ(why.wait_for(kPatience), std::future_status::ready);
    const auto told = why.get();
    EXPECT_EQ(told.code, RefusalCode::RevokedLease);
    EXPECT_THAT(told.message, HasSubstr("fire drill"));
    EXPECT_THAT(told.holder, HasSubstr("client2@lab"));
    EXPECT_TRUE(isFinal(task.wait(5s).state));
}

TEST_F(OwnershipTest, AQueryFindsWhatIsFreeAndSaysWhatIsNot) {
    const auto first = robot("First");
    const auto second = robot("Second");
    const auto client1 = named("client1@lab");
    const auto client2 = named("client2@lab");
    take(*client1, "First");
    ASSERT_TRUE(waitUntil([&] {
        const auto seen = client2->find("First");
        return seen.ok() && seen->state == EntityState::REG && client2->waitFor("Second", 1s).ok();
    }));
    const auto both = client2->checkOutQuery("2 ROBOT/MOBILE");
    ASSERT_FALSE(both.ok());
    EXPECT_THAT(both.refusal().message, HasSubstr("First is held by client1@lab"));
    const auto one = client2->checkOutQuery("1 mobile with drive");
    ASSERT_TRUE(one.ok()) << one.refusal().message;
    EXPECT_EQ(one->front().entity().name, "Second");
    EXPECT_EQ(client2->checkOutQuery("1 ROBTO").refusal().code, RefusalCode::Malformed);
}

TEST_F(OwnershipTest, ADrillMeasuresAndDisturbsNothing) {
    const auto robots = robot();
    const auto client1 = named("client1@lab");
    const auto client2 = named("client2@lab");
    const auto held = take(*client1);
    const auto task = drive(held, *robots);
    ASSERT_TRUE(client2->waitFor("PeopleBot", 5s).ok());
    const auto drilled = client2->drill({"PeopleBot"}, 5, 10ms);
    ASSERT_TRUE(drilled.ok()) << drilled.refusal().message;
    ASSERT_THAT(drilled.value(), SizeIs(1));
    ASSERT_THAT(drilled->front().callback, SizeIs(5));
    for (const auto& time : drilled->front().callback) EXPECT_TRUE(time) << "it never arrived";
    EXPECT_EQ(task.report().state, TaskState::Running);
    EXPECT_EQ(robots->stops, 0);
    EXPECT_FALSE(client2->find("PeopleBot")->latched);
    EXPECT_TRUE(held.sendText("and commands are still obeyed").ok());
    EXPECT_TRUE(waitUntil([&] { return !robots->texts().empty(); }));
    EXPECT_EQ(client2->drill({"Nobody"}).refusal().code, RefusalCode::UnknownEntity);
}

}  // namespace
}  // namespace axon::client::test
