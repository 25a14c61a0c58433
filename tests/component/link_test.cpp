// SPDX-License-Identifier: GPL-2.0-or-later
// The EM-EI link: the real Entity Interfacer (shared library) and the real BackEndInterface over loopback
// TCP.
#include <arpa/inet.h>
#include <axon/link.pb.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <asio/executor_work_guard.hpp>
#include <asio/io_context.hpp>
#include <asio/post.hpp>
#include <asio/strand.hpp>
#include <atomic>
#include <axon/entity_interfacer.hpp>
#include <condition_variable>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <future>
#include <mutex>
#include <thread>
#include <type_traits>
#include <utility>

#include "common/descriptor.hpp"
#include "common/frame.hpp"
#include "common/ids.hpp"
#include "common/release.hpp"
#include "entity_manager/links/back_end/back_end_interface.hpp"
#include "support/loopback.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;
using entity_manager::BackEndEvents;
using entity_manager::BackEndInterface;
using entity_manager::BackEndSettings;
using entity_manager::LinkEnd;
using entity_manager::StopGenerations;
using test::waitUntil;
using Clock = std::chrono::steady_clock;
using Cause = StopSignal::Cause;

// Sanitizers slow everything; bounds that a person reads as a promise stay those of the plain build.
#ifdef AXON_SANITIZED
constexpr int kSlow = 5;
#else
constexpr int kSlow = 1;
#endif

/// The Entity Manager's side, with a thread for its strand. Its watchdogs are long, so that a machine that
/// stands still for a moment does not fail a test of something else; who tests them names them.
class Manager : public BackEndEvents {
  public:
    explicit Manager(const std::string& application, PortRange ports = {5500, 5600},
                     const std::string& instance = {}, std::chrono::milliseconds busy = 10s,
                     std::chrono::milliseconds idle = 10s)
        : work_(context_.get_executor()), strand_(asio::make_strand(context_)) {
        BackEndSettings settings;
        settings.application = application;
        settings.instance = instance;
        settings.where = {ports, test::loopbackAddress()};
        settings.manager = "test " + application;
        settings.ports_from = "the test";
        settings.report_after = 20ms;
        settings.watchdog_busy = busy * kSlow;
        settings.watchdog_idle = idle * kSlow;
        link_ =
            std::make_unique<BackEndInterface>(strand_, settings, stop_generations, clock_, random_, *this);
        thread_ = std::thread([this] { context_.run(); });
        started_at = Clock::now();
        post([this] { link_->start(); });
    }
    ~Manager() override {
        if (thread_.joinable()) die();
    }
    /// As a process that ends: its sockets close.
    void die() {
        post([this] { link_->close(); });
        work_.reset();
        thread_.join();
    }
    template <class Call>
    void post(Call call) {
        asio::post(strand_, std::move(call));
    }
    void send(const proto::EmToEi& message) {
        post([this, message] { link_->send(message); });
    }
    void setBusy(bool busy) {
        post([this, busy] { link_->setBusy(busy); });
    }
    std::uint32_t stop(StopCause cause = StopCause::Requested) {
        const auto generation = stop_generations.raise();
        link_->stop(generation, cause);
        return generation;
    }
    void rawStop(std::uint32_t generation, StopCause cause) { link_->stop(generation, cause); }
    /// The strand is stuck, as in a frozen Entity Manager whose sockets stay open.
    void freeze(std::shared_future<void> until) {
        post([until] { until.wait(); });
    }
    /// On the strand, as the core does it in the middle of an event.
    bool sendNow(const proto::EmToEi& message) { return link_->send(message); }
    std::uint64_t rawDropped() const { return link_->rawDropped(); }
    std::vector<entity_manager::HopMargin> margins() {
        std::promise<std::vector<entity_manager::HopMargin>> got;
        post([this, &got] { got.set_value(link_->margins()); });
        return got.get_future().get();
    }
    std::string dispatch(const std::string& service, std::uint32_t generation,
                         const std::vector<proto::Param>& params = {}) {
        const auto id = Id128::random(random_).bytes();
        proto::EmToEi message;
        auto& task = *message.mutable_task();
        task.set_task_id(id);
        task.set_service(service);
        task.set_stop_generation(generation);
        for (const auto& param : params) *task.add_params() = param;
        send(message);
        return id;
    }

    void onLinkUp() override {
        up_at = Clock::now();
        ups++;
        if (on_up) on_up();
    }
    void onLinkDown(const std::string& reason, LinkEnd end) override {
        const std::lock_guard lock(mutex_);
        down_reason_ = reason;
        down_end_ = end;
        downs++;
    }
    void onLinkMessage(const proto::EiToEm& message) override {
        {
            const std::lock_guard lock(mutex_);
            messages_.push_back(message);
        }
        if (on_message) on_message(message);
    }
    void onLinkSought(const entity_manager::SearchReport& report) override {
        const std::lock_guard lock(mutex_);
        sought_ = report;
    }
    void onLinkRelease(const std::string& note) override {
        const std::lock_guard lock(mutex_);
        release_notes_.push_back(note);
    }
    std::vector<std::string> releaseNotes() {
        const std::lock_guard lock(mutex_);
        return release_notes_;
    }
    entity_manager::SearchReport sought() {
        const std::lock_guard lock(mutex_);
        return sought_;
    }
    void onLinkRefused(const Refusal& refusal) override {
        const std::lock_guard lock(mutex_);
        refusal_ = refusal;
    }
    std::vector<proto::EiToEm> messages() {
        const std::lock_guard lock(mutex_);
        return messages_;
    }
    Refusal refusal() {
        const std::lock_guard lock(mutex_);
        return refusal_;
    }
    std::string downReason() {
        const std::lock_guard lock(mutex_);
        return down_reason_;
    }
    std::optional<LinkEnd> downEnd() {
        const std::lock_guard lock(mutex_);
        return down_end_;
    }
    bool linked() const { return ups > downs; }
    std::optional<proto::TaskEvent> finalOf(const std::string& id) {
        for (const auto& message : messages())
            if (message.has_task() && message.task().event().task_id() == id &&
                message.task().event().state() >= proto::TASK_SUCCEEDED)
                return message.task().event();
        return std::nullopt;
    }
    std::optional<proto::RefusalCode> answerOf(const std::string& id) {
        for (const auto& message : messages())
            if (message.has_task_answer() && message.task_answer().task_id() == id)
                return message.task_answer().refusal().code();
        return std::nullopt;
    }
    std::optional<proto::Refusal> answerTo(std::uint64_t request) {
        for (const auto& message : messages())
            if (message.has_answer() && message.answer().request() == request)
                return message.answer().refusal();
        return std::nullopt;
    }
    bool acknowledged(std::uint32_t generation,
                      proto::StopReceipt::Stage stage = proto::StopReceipt::CALLBACK_RETURNED) {
        for (const auto& message : messages())
            if (message.has_stop_done() && message.stop_done().stop_generation() == generation &&
                message.stop_done().stage() == stage)
                return true;
        return false;
    }

    bool drilled(std::uint32_t number) {
        for (const auto& message : messages())
            if (message.has_stop_done() && message.stop_done().drill() == number) return true;
        return false;
    }

    /// What the application has said last of a service: "on", or why it is off; empty: nothing yet.
    std::string activityOf(const std::string& service) {
        std::string last;
        for (const auto& message : messages())
            if (message.has_active() && message.active().service() == service)
                last = message.active().active() ? "on" : message.active().reason();
        return last;
    }

    std::function<void(const proto::EiToEm&)> on_message;  // on the strand; set before anything is sent
    std::function<void()> on_up;                           // likewise, before the application starts
    StopGenerations stop_generations;
    std::atomic<int> ups{0}, downs{0};
    Clock::time_point started_at;
    std::atomic<Clock::time_point> up_at{};

  private:
    asio::io_context context_;
    asio::executor_work_guard<asio::io_context::executor_type> work_;
    asio::strand<asio::io_context::executor_type> strand_;
    SteadyClock clock_;
    SystemRandom random_;
    std::unique_ptr<BackEndInterface> link_;
    std::mutex mutex_;
    std::vector<proto::EiToEm> messages_;
    std::string down_reason_;
    std::optional<LinkEnd> down_end_;
    Refusal refusal_;
    entity_manager::SearchReport sought_;
    std::vector<std::string> release_notes_;
    std::thread thread_;
};

/// What onStop saw.
class Stops {
  public:
    void attach(EntityInterfacer& interfacer) {
        interfacer.onStop([this](const StopSignal& stop) {
            const std::lock_guard lock(mutex_);
            seen_.push_back(stop);
            last_at_ = Clock::now();
        });
    }
    std::vector<StopSignal> seen() const {
        const std::lock_guard lock(mutex_);
        return seen_;
    }
    std::size_t count(Cause cause) const {
        const auto all = seen();
        return static_cast<std::size_t>(
            std::count_if(all.begin(), all.end(), [&](const auto& s) { return s.cause == cause; }));
    }
    Clock::time_point lastAt() const {
        const std::lock_guard lock(mutex_);
        return last_at_;
    }

  private:
    mutable std::mutex mutex_;
    std::vector<StopSignal> seen_;
    Clock::time_point last_at_;
};

/// A plain TCP client or server of a test that misbehaves.
class RawSocket {
  public:
    explicit RawSocket(Descriptor socket = Descriptor(::socket(AF_INET, SOCK_STREAM, 0)))
        : socket_(std::move(socket)) {
        timeval time{5, 0};
        ::setsockopt(fd(), SOL_SOCKET, SO_RCVTIMEO, &time, sizeof time);
    }
    static sockaddr_in address(std::uint16_t port) {
        sockaddr_in a{};
        a.sin_family = AF_INET;
        a.sin_port = htons(port);
        ::inet_pton(AF_INET, test::loopbackAddress().c_str(), &a.sin_addr);
        return a;
    }
    bool connect(std::uint16_t port) {
        const auto a = address(port);
        return ::connect(fd(), reinterpret_cast<const sockaddr*>(&a), sizeof a) == 0;
    }
    bool listen(std::uint16_t port) {
        const auto a = address(port);
        const int on = 1;
        ::setsockopt(fd(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
        return ::bind(fd(), reinterpret_cast<const sockaddr*>(&a), sizeof a) == 0 && ::listen(fd(), 16) == 0;
    }
    RawSocket accept() { return RawSocket(Descriptor(::accept(fd(), nullptr, nullptr))); }
    void write(const std::string& bytes) { (void)::send(fd(), bytes.data(), bytes.size(), MSG_NOSIGNAL); }
    template <class Message>
    requires std::is_base_of_v<google::protobuf::Message, Message>
    void write(const Message& message) {
        std::string frame;
        appendFrame(frame, message.SerializeAsString());
        write(frame);
    }
    /// Nothing when the peer closes, or is silent for five seconds.
    template <class Message = proto::EiToEm>
    std::optional<Message> read() {
        std::string payload;
        while (!reader_.next(payload)) {
            char bytes[4096];
            const auto got = ::recv(fd(), bytes, sizeof bytes, 0);
            if (got <= 0) return std::nullopt;
            reader_.feed({bytes, static_cast<std::size_t>(got)});
        }
        Message message;
        if (!message.ParseFromString(payload)) return std::nullopt;
        return message;
    }
    bool closedByPeer() {
        char byte = 0;
        while (true) {
            const auto got = ::recv(fd(), &byte, 1, 0);
            if (got > 0) continue;
            return got == 0 || errno == ECONNRESET;
        }
    }

  private:
    int fd() const { return socket_.get(); }
    Descriptor socket_;
    FrameReader reader_;
};

proto::EmToEi helloOf(const std::string& application, proto::LinkLane lane, const std::string& nonce) {
    proto::EmToEi message;
    auto& hello = *message.mutable_hello();
    hello.set_protocol(1);
    hello.set_application(application);
    hello.set_lane(lane);
    hello.set_nonce(nonce);
    hello.set_manager("raw");
    return message;
}

EntityInterfacer::Options options(const std::string& application, std::uint16_t first = 5500,
                                  std::uint16_t last = 5600) {
    EntityInterfacer::Options o;
    o.application = application;
    o.address = test::loopbackAddress();
    o.first_port = first;
    o.last_port = last;
    o.logger = [](LogLevel level, const std::string& text) {
        if (std::getenv("AXON_TEST_LOG") != nullptr)
            std::fprintf(stderr, "[%d] %s\n", static_cast<int>(level), text.c_str());
    };
    return o;
}

proto::Param param(const std::string& name, double value) {
    proto::Param p;
    p.set_name(name);
    p.add_values()->set_dbl(value);
    return p;
}

/// A file that goes with the test.
class ScratchFile {
  public:
    explicit ScratchFile(const std::string& name, const std::string& text)
        : path_(std::filesystem::temp_directory_path() /
                ("axon-link-" + std::to_string(::getpid()) + "-" + name)) {
        rewrite(text);
    }
    ~ScratchFile() { std::filesystem::remove(path_); }
    void rewrite(const std::string& text) const {
        std::ofstream(path_, std::ios::binary | std::ios::trunc) << text;
    }
    const std::filesystem::path& path() const { return path_; }

  private:
    std::filesystem::path path_;
};

TEST(Link, ComesUpSoonAfterTheApplicationsStart) {
    Manager manager("Hello", {5500, 8000});
    EXPECT_FALSE(
        waitUntil([&] { return manager.linked(); }, 1200ms));  // it has been looking, and is backing off
    auto o = options("Hello", 5500, 8000);
    EntityInterfacer interfacer(o);
    const auto started = Clock::now();
    interfacer.start();
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    EXPECT_LT(manager.up_at.load() - started, 1s * kSlow);  // measured: about a tenth of it
}

TEST(Link, AFarPortOfTheWholeRangeIsFound) {
    Manager manager("Far", {5500, 8000});
    EntityInterfacer interfacer(options("Far", 7990, 8000));
    interfacer.start();
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }, 4s));
}

TEST(Link, AManagerWithAMisspeltNameNamesTheApplicationsThatAreThere) {
    EntityInterfacer interfacer(options("Greeter"));
    interfacer.start();
    Manager manager("Greetr");
    ASSERT_TRUE(waitUntil([&] {
        return manager.sought().finding.find("found there: \"Greeter\" (port 55") != std::string::npos;
    })) << manager.sought().finding;
    const auto report = manager.sought();
    EXPECT_NE(report.finding.find("no robot application \"Greetr\" is found at " + test::loopbackAddress() +
                                  ", ports 5500 to 5600 (the test)"),
              std::string::npos)
        << report.finding;
    EXPECT_NE(report.fix.find("did you mean \"Greeter\"?"), std::string::npos) << report.fix;
}

TEST(Link, ASecondManagerSaysThatTheApplicationIsLinkedWithTheFirst) {
    EntityInterfacer interfacer(options("Taken"));
    interfacer.start();
    Manager first("Taken");
    ASSERT_TRUE(waitUntil([&] { return first.linked(); }));
    Manager second("Taken");
    ASSERT_TRUE(waitUntil([&] { return second.sought().finding.find("declines") != std::string::npos; }));
    EXPECT_NE(second.sought().finding.find("test Taken"), std::string::npos) << second.sought().finding;
}

TEST(Link, ProfilesAndStatementsArriveOnLinkUp) {
    const ScratchFile basic("basic.xml", "<BasicProfile/>");
    const ScratchFile services("services.xml", "<ServiceProfile/>");
    auto o = options("P");
    o.resource_folders = {"/srv/maps", "relative"};
    EntityInterfacer interfacer(o);
    interfacer.uploadBasicProfile(basic.path());
    interfacer.uploadServiceProfile(services.path());
    interfacer.setPosition(1, 2, 3);
    interfacer.setServiceActive("S", false, "no battery");
    interfacer.start();
    Manager manager("P");
    ASSERT_TRUE(waitUntil([&] { return manager.messages().size() >= 4; }));
    const auto messages = manager.messages();
    EXPECT_EQ(messages[0].profile().xml(), "<BasicProfile/>");
    EXPECT_FALSE(messages[0].profile().services());
    EXPECT_EQ(messages[0].profile().file_name(), basic.path().string());
    EXPECT_EQ(messages[1].profile().xml(), "<ServiceProfile/>");
    EXPECT_TRUE(messages[1].profile().services());
    EXPECT_EQ(messages[1].profile().folder(), std::filesystem::absolute(services.path()).parent_path());
    ASSERT_EQ(messages[1].profile().resource_folders_size(), 2);
    EXPECT_EQ(messages[1].profile().resource_folders(0), "/srv/maps");
    EXPECT_EQ(messages[1].profile().resource_folders(1), std::filesystem::current_path() / "relative");
    EXPECT_EQ(messages[2].position().zpos(), 3);
    EXPECT_EQ(messages[3].active().reason(), "no battery");
}

TEST(Link, AChangedProfileIsUploadedAgain) {
    const ScratchFile basic("changing.xml", "<BasicProfile/>");
    EntityInterfacer interfacer(options("Change"));
    interfacer.uploadBasicProfile(basic.path());
    interfacer.start();
    Manager manager("Change");
    ASSERT_TRUE(waitUntil([&] { return manager.messages().size() == 1; }));
    basic.rewrite("<BasicProfile name=\"new\"/>");
    ASSERT_TRUE(waitUntil([&] { return manager.messages().size() == 2; }));
    EXPECT_EQ(manager.messages()[1].profile().xml(), "<BasicProfile name=\"new\"/>");
}

TEST(Link, ParametersAndResourcesAreGrantedOrDeniedWithTheReason) {
    EntityInterfacer interfacer(options("Grant"));
    interfacer.onParameter([](const std::string& service, const Parameter& p) {
        if (service == "Drive" && p.number() <= 100) return Decision::grant();
        return Decision::deny("faster than this floor allows");
    });
    interfacer.onResource([](const std::string&, const std::string& name, const std::filesystem::path& path) {
        return name == "map" && path == "/tmp/map" ? Decision::grant() : Decision::deny("no such map");
    });
    interfacer.start();
    Manager manager("Grant");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    for (std::uint64_t i = 1; i <= 2; ++i) {
        proto::EmToEi message;
        message.mutable_param()->set_request(i);
        message.mutable_param()->set_service("Drive");
        *message.mutable_param()->mutable_param() = param("Speed", i == 1 ? 50 : 500);
        manager.send(message);
        proto::EmToEi resource;
        resource.mutable_resource()->set_request(10 + i);
        resource.mutable_resource()->set_resource("map");
        resource.mutable_resource()->set_path(i == 1 ? "/tmp/map" : "/tmp/other");
        manager.send(resource);
    }
    ASSERT_TRUE(waitUntil([&] { return manager.answerTo(12).has_value(); }));
    EXPECT_EQ(manager.answerTo(1)->code(), proto::OK);
    EXPECT_EQ(manager.answerTo(2)->code(), proto::DENIED);
    EXPECT_EQ(manager.answerTo(2)->message(), "faster than this floor allows");
    EXPECT_EQ(manager.answerTo(11)->code(), proto::OK);
    EXPECT_EQ(manager.answerTo(12)->message(), "no such map");
}

/// "Service.Name=value" of all that onConfig was told.
class Told {
  public:
    void attach(EntityInterfacer& interfacer) {
        interfacer.onConfig([this](const std::string& service, const Parameter& p) {
            const std::lock_guard lock(mutex_);
            all_.push_back(service + '.' + p.name + '=' + std::to_string(static_cast<int>(p.number())) +
                           p.units);
        });
    }
    std::vector<std::string> all() {
        const std::lock_guard lock(mutex_);
        return all_;
    }

  private:
    std::mutex mutex_;
    std::vector<std::string> all_;
};

proto::EmToEi configuration(double speed, const std::string& task = {}) {
    proto::EmToEi message;
    auto& one = *message.mutable_configuration()->add_params();
    one.set_service("Drive");
    *one.mutable_param() = param("Speed", speed);
    one.mutable_param()->set_units("mm/s");
    message.mutable_configuration()->set_task_id(task);
    return message;
}

TEST(Link, ARunningHandlerReadsTheConfigurationThatIsSetMeanwhileOthersDoNot) {
    Told told;
    EntityInterfacer interfacer(options("Configured"));
    told.attach(interfacer);
    std::atomic<int> drive{0}, other{0};
    std::atomic<bool> unchanged{true};
    const auto follow = [&](std::atomic<int>& seen) {
        return [&](Task& task) {
            while (task.waitFor(1ms)) {
                seen = static_cast<int>(task.number("Speed", -1));
                unchanged = unchanged && task.parameters().size() == 1 && task.parameters()[0].number() == 1;
            }
        };
    };
    interfacer.onTask("Drive", follow(drive));
    interfacer.onTask("Other", follow(other));
    interfacer.start();
    Manager manager("Configured");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto first = manager.dispatch("Drive", 0, {param("Speed", 1)});
    manager.dispatch("Other", 0, {param("Speed", 1)});
    ASSERT_TRUE(waitUntil([&] { return drive == 1 && other == 1; }));
    manager.send(configuration(2, first));
    manager.send(configuration(3, first));
    EXPECT_TRUE(waitUntil([&] { return drive == 3; }));
    // Of a composite around it, and so of no running task.
    manager.send(configuration(4));
    manager.send(configuration(5, std::string(16, 'z')));
    ASSERT_TRUE(waitUntil([&] { return told.all().size() == 4; }));
    EXPECT_EQ(told.all(), (std::vector<std::string>{"Drive.Speed=2mm/s", "Drive.Speed=3mm/s",
                                                    "Drive.Speed=4mm/s", "Drive.Speed=5mm/s"}));
    EXPECT_EQ(drive, 3);
    EXPECT_EQ(other, 1);
    EXPECT_TRUE(unchanged) << "parameters() are those of the beginning";
}

TEST(Link, ConfigurationIsToldWhileAStopIsObeyedAndDoesNotHoldItUp) {
    std::promise<void> go;
    const auto gone = go.get_future().share();
    Stops stops;
    std::atomic<int> told{0};
    EntityInterfacer interfacer(options("ConfigStop"));
    stops.attach(interfacer);
    interfacer.onConfig([&, gone](const std::string&, const Parameter&) {
        told++;
        gone.wait();
    });
    interfacer.start();
    Manager manager("ConfigStop");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    manager.send(configuration(1));
    ASSERT_TRUE(waitUntil([&] { return told == 1; }));
    const auto generation = manager.stop();
    EXPECT_TRUE(waitUntil([&] { return manager.acknowledged(generation); }))
        << "the callback has not returned";
    manager.send(configuration(2));
    go.set_value();
    EXPECT_TRUE(waitUntil([&] { return told == 2; }));
}

/// An application that takes a Speed of at most 300, and its Entity Manager, which tells 500 with every link.
struct ConfigThrows : ::testing::Test {
    ConfigThrows() {
        stops.attach(interfacer);
        interfacer.onConfig([this](const std::string&, const Parameter& p) {
            told++;
            if (p.number() > 300) throw std::out_of_range("the drive takes at most 300");
        });
        for (const char* service : {"Drive", "Other"})
            interfacer.onTask(service, [](Task& task) { task.succeed(); });
        manager.on_up = [this] { manager.sendNow(configuration(500)); };
        interfacer.start();
    }
    bool isOff() { return manager.activityOf("Drive").find("'Speed'") != std::string::npos; }
    bool isOn() { return manager.activityOf("Drive") == "on"; }
    bool succeeds(const std::string& service, std::uint32_t generation = 0) {
        const auto id = manager.dispatch(service, generation);
        return waitUntil([&] { return manager.finalOf(id).has_value(); }) &&
               manager.finalOf(id)->state() == proto::TASK_SUCCEEDED;
    }
    std::atomic<int> told{0};
    Stops stops;
    EntityInterfacer interfacer{options("ConfigThrow")};
    Manager manager{"ConfigThrow"};
};

TEST_F(ConfigThrows, AtLinkUpSwitchTheServiceOffUntilAnotherValueIsTaken) {
    ASSERT_TRUE(waitUntil([&] { return isOff(); }));
    EXPECT_EQ(manager.activityOf("Drive"),
              "the value of parameter 'Speed' was not accepted: onConfig threw (the drive takes at most "
              "300); fix: set another value");
    const auto refused = manager.dispatch("Drive", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(refused).has_value(); }));
    EXPECT_EQ(manager.answerOf(refused), proto::INACTIVE_SERVICE);
    EXPECT_TRUE(succeeds("Other")) << "the rest of the robot is usable";
    EXPECT_EQ(manager.ups, 1);
    EXPECT_EQ(told, 1);
    EXPECT_TRUE(stops.seen().empty()) << "nothing had moved";

    manager.send(configuration(200));
    ASSERT_TRUE(waitUntil([&] { return isOn(); }));
    EXPECT_TRUE(succeeds("Drive"));
}

TEST_F(ConfigThrows, AfterATaskAreAFaultAndTheNextLinkStays) {
    ASSERT_TRUE(waitUntil([&] { return isOff(); }));
    manager.send(configuration(200));
    ASSERT_TRUE(waitUntil([&] { return isOn(); }));
    EXPECT_TRUE(succeeds("Drive"));
    manager.send(configuration(400));
    ASSERT_TRUE(waitUntil([&] { return stops.count(Cause::Fault) == 1 && manager.ups == 2; }));
    ASSERT_TRUE(waitUntil([&] { return told == 4 && isOff() && manager.linked(); }))
        << "by the first link once, by the second with what it tells";
    EXPECT_NE(manager.downReason().find("onConfig for parameter 'Speed' of 'Drive'"), std::string::npos)
        << manager.downReason();
    manager.send(configuration(200));
    ASSERT_TRUE(waitUntil([&] { return isOn(); }));
    EXPECT_EQ(manager.ups, 2);
    EXPECT_EQ(stops.count(Cause::Fault), 1U);
}

TEST_F(ConfigThrows, LeaveAServiceOffThatTheApplicationHasSwitchedOffItself) {
    ASSERT_TRUE(waitUntil([&] { return isOff(); }));
    interfacer.setServiceActive("Drive", true);
    interfacer.setServiceActive("Other", true);
    ASSERT_TRUE(waitUntil([&] { return manager.activityOf("Other") == "on"; }));
    EXPECT_TRUE(isOff()) << "whatever the application says";
    interfacer.setServiceActive("Drive", false, "no wheels");
    manager.send(configuration(200));
    EXPECT_TRUE(waitUntil([&] { return told == 2 && manager.activityOf("Drive") == "no wheels"; }));
    interfacer.setServiceActive("Drive", true);
    EXPECT_TRUE(waitUntil([&] { return isOn(); }));
}

TEST(Link, WhatIsGivenWithATaskIsPutToOnParameterAndAVetoRefusesTheTask) {
    std::atomic<int> asked{0}, requests{0}, runs{0};
    EntityInterfacer interfacer(options("GivenVeto"));
    interfacer.onParameter([&](const std::string& service, const Parameter& p) {
        asked++;
        if (service == "Drive" && p.name == "Speed" && p.number() > 100)
            return Decision::deny("faster than this floor allows");
        if (service == "Tour") return Decision::robotLost("the base does not answer");
        return Decision::grant();
    });
    interfacer.onTaskRequest([&](const Task&) {
        requests++;
        return Decision::grant();
    });
    interfacer.onTask("Drive", [&](Task&) { runs++; });
    interfacer.start();
    Manager manager("GivenVeto");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto dispatch = [&](const std::string& id, double speed, const std::string& declared_by,
                              bool given) {
        proto::EmToEi message;
        auto& task = *message.mutable_task();
        task.set_task_id(id);
        task.set_service("Drive");
        *task.add_params() = param("Speed", speed);
        if (given) {
            task.add_given()->set_service(declared_by);
            if (declared_by == "Drive")
                task.mutable_given(0)->mutable_param()->set_name("Speed");
            else
                *task.mutable_given(0)->mutable_param() = param("Speed", speed);
        }
        manager.send(message);
    };
    const std::string too_fast(16, 'a'), slow(16, 'b'), stored(16, 'c'), whole(16, 'd');
    dispatch(too_fast, 500, "Drive", true);
    dispatch(slow, 50, "Drive", true);
    dispatch(stored, 500, "Drive", false);  // set before: it was asked for then
    dispatch(whole, 50, "Tour", true);
    ASSERT_TRUE(waitUntil([&] {
        return manager.answerOf(too_fast) && manager.finalOf(slow) && manager.finalOf(stored) &&
               manager.answerOf(whole);
    }));
    EXPECT_EQ(manager.answerOf(too_fast), proto::DENIED);
    for (const auto& message : manager.messages()) {
        if (!message.has_task_answer() || message.task_answer().task_id() != too_fast) continue;
        EXPECT_EQ(message.task_answer().refusal().message(),
                  "parameter 'Speed' of 'Drive': faster than this floor allows");
    }
    EXPECT_EQ(manager.answerOf(slow), proto::OK);
    EXPECT_EQ(manager.answerOf(stored), proto::OK);
    EXPECT_EQ(manager.answerOf(whole), proto::ROBOT_LOST);
    EXPECT_EQ(asked, 3);
    EXPECT_EQ(requests, 2) << "what is refused for a parameter is no request any more";
    EXPECT_EQ(runs, 2);
}

TEST(Link, ATaskRunsWithProgressFeedbackAndResults) {
    EntityInterfacer interfacer(options("Task"));
    interfacer.onTask("Drive", [](Task& task) {
        task.progress(0.5);
        task.feedback("half way");
        task.result("Travelled", task.number("Distance"), "mm");
    });
    interfacer.onTask("Fail", [](Task& task) { task.fail("no wheels"); });
    interfacer.start();
    Manager manager("Task");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto drive = manager.dispatch("Drive", 0, {param("Distance", 250)});
    const auto fail = manager.dispatch("Fail", 0);
    const auto unknown = manager.dispatch("Fly", 0);
    ASSERT_TRUE(waitUntil(
        [&] { return manager.finalOf(drive) && manager.finalOf(fail) && manager.answerOf(unknown); }));
    EXPECT_EQ(manager.answerOf(drive), proto::OK);
    EXPECT_EQ(manager.finalOf(drive)->state(), proto::TASK_SUCCEEDED);
    EXPECT_EQ(manager.finalOf(drive)->feedback(), "half way");
    EXPECT_EQ(manager.finalOf(drive)->results(0).values(0).dbl(), 250);
    EXPECT_EQ(manager.finalOf(drive)->results(0).units(), "mm");
    EXPECT_EQ(manager.finalOf(fail)->state(), proto::TASK_FAILED);
    EXPECT_EQ(manager.finalOf(fail)->reason().message(), "no wheels");
    EXPECT_EQ(manager.answerOf(unknown), proto::UNKNOWN_SERVICE);
}

TEST(Link, ATaskEndsForTheManagerOnlyOnceItsHandlerHasReturned) {
    std::promise<void> go;
    const auto released = go.get_future().share();
    std::atomic<int> given_back{0};
    EntityInterfacer interfacer(options("Device"));
    const auto keep = [&](Task& task, const auto& verdict) {
        const std::shared_ptr<void> device(nullptr, [&](void*) {
            released.wait();
            given_back++;
        });
        verdict(task);
        task.progress(0.1);                      // after the verdict: ignored
        interfacer.sendInfoMsg(task.service());  // what is sent now overtakes nothing on the data lane
    };
    interfacer.onTask("Succeed", [&](Task& task) { keep(task, [](Task& t) { t.succeed(); }); });
    interfacer.onTask("Fail", [&](Task& task) { keep(task, [](Task& t) { t.fail("no wheels"); }); });
    interfacer.onTask("Lose", [&](Task& task) { keep(task, [](Task& t) { t.robotLost("no robot"); }); });
    interfacer.start();
    Manager manager("Device");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    std::vector<int> given_back_at_end;
    manager.on_message = [&](const proto::EiToEm& message) {
        if (message.has_task() && message.task().event().state() >= proto::TASK_SUCCEEDED)
            given_back_at_end.push_back(given_back);
    };
    const auto said = [&](const std::string& text) {
        const auto all = manager.messages();
        return std::any_of(all.begin(), all.end(),
                           [&](const auto& m) { return m.has_text() && m.text().text() == text; });
    };
    const auto succeed = manager.dispatch("Succeed", 0);
    const auto fail = manager.dispatch("Fail", 0);
    const auto lose = manager.dispatch("Lose", 0);
    ASSERT_TRUE(waitUntil([&] { return said("Succeed") && said("Fail") && said("Lose"); }));
    for (const auto& id : {succeed, fail, lose}) EXPECT_FALSE(manager.finalOf(id));
    go.set_value();
    ASSERT_TRUE(waitUntil(
        [&] { return manager.finalOf(succeed) && manager.finalOf(fail) && manager.finalOf(lose); }));
    EXPECT_EQ(manager.finalOf(succeed)->state(), proto::TASK_SUCCEEDED);
    EXPECT_EQ(manager.finalOf(succeed)->progress(), 1);
    EXPECT_EQ(manager.finalOf(fail)->state(), proto::TASK_FAILED);
    EXPECT_EQ(manager.finalOf(fail)->reason().message(), "no wheels");
    EXPECT_EQ(manager.finalOf(lose)->reason().code(), proto::ROBOT_LOST);
    manager.die();
    ASSERT_EQ(given_back_at_end.size(), 3U);
    for (int i = 0; i < 3; ++i) EXPECT_GT(given_back_at_end[static_cast<std::size_t>(i)], i);
}

TEST(Link, AVerdictOfAnotherThreadIsToldOnceTheHandlerHasReturnedAndNoneAfterThat) {
    std::optional<Task> kept;
    std::promise<void> in_other_hands;
    EntityInterfacer interfacer(options("Hands"));
    interfacer.onTask("Wait", [&](Task& task) {
        std::thread other([task]() mutable { task.fail("the other thread says so"); });
        other.join();
        interfacer.sendInfoMsg("verdict given");
        in_other_hands.get_future().wait();
    });
    interfacer.onTask("Leave", [&](Task& task) { kept = task; });
    interfacer.start();
    Manager manager("Hands");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto wait = manager.dispatch("Wait", 0);
    ASSERT_TRUE(waitUntil([&] {
        const auto all = manager.messages();
        return std::any_of(all.begin(), all.end(), [](const auto& m) { return m.has_text(); });
    }));
    EXPECT_FALSE(manager.finalOf(wait));
    in_other_hands.set_value();
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(wait).has_value(); }));
    EXPECT_EQ(manager.finalOf(wait)->state(), proto::TASK_FAILED);
    EXPECT_EQ(manager.finalOf(wait)->reason().message(), "the other thread says so");

    // A handler that returns without a verdict has succeeded, whoever still has the task.
    const auto leave = manager.dispatch("Leave", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(leave).has_value(); }));
    EXPECT_EQ(manager.finalOf(leave)->state(), proto::TASK_SUCCEEDED);
    kept->fail("too late");
    const auto last = manager.dispatch("Leave", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(last).has_value(); }));
    const auto all = manager.messages();
    EXPECT_EQ(
        std::count_if(all.begin(), all.end(),
                      [&](const auto& m) { return m.has_task() && m.task().event().task_id() == leave; }),
        1);
}

TEST(Link, AStopIsConfirmedWhileAHandlerThatHasGivenItsVerdictDoesNotReturn) {
    std::promise<void> go;
    Stops stops;
    EntityInterfacer interfacer(options("Linger"));
    stops.attach(interfacer);
    interfacer.onTask("Linger", [&](Task& task) {
        task.succeed();
        interfacer.sendInfoMsg("verdict given");
        go.get_future().wait();
    });
    interfacer.start();
    Manager manager("Linger");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto id = manager.dispatch("Linger", 0);
    ASSERT_TRUE(waitUntil([&] {
        const auto all = manager.messages();
        return std::any_of(all.begin(), all.end(), [](const auto& m) { return m.has_text(); });
    }));
    const auto generation = manager.stop();
    EXPECT_TRUE(waitUntil([&] { return manager.acknowledged(generation); }));
    EXPECT_FALSE(manager.finalOf(id));
    go.set_value();
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(id).has_value(); }));
    EXPECT_EQ(manager.finalOf(id)->state(), proto::TASK_SUCCEEDED);  // before the stop came
}

TEST(Link, AnExceptionAfterTheVerdictTurnsASuccessIntoAFailureAndKeepsAReason) {
    Stops stops;
    EntityInterfacer interfacer(options("ThrowLate"));
    stops.attach(interfacer);
    interfacer.onTask("Succeed", [](Task& task) {
        task.succeed();
        throw std::runtime_error("the brake did not take");
    });
    interfacer.onTask("Fail", [](Task& task) {
        task.fail("no wheels");
        throw 7;
    });
    interfacer.start();
    Manager manager("ThrowLate");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto succeed = manager.dispatch("Succeed", 0);
    ASSERT_TRUE(
        waitUntil([&] { return manager.finalOf(succeed) && manager.ups == 2 && interfacer.linked(); }));
    EXPECT_EQ(manager.finalOf(succeed)->state(), proto::TASK_FAILED);
    EXPECT_NE(manager.finalOf(succeed)->reason().message().find("the brake did not take"), std::string::npos);
    const auto fail = manager.dispatch("Fail", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(fail) && stops.count(Cause::Fault) == 2; }));
    EXPECT_EQ(manager.finalOf(fail)->state(), proto::TASK_FAILED);
    EXPECT_EQ(manager.finalOf(fail)->reason().message(), "no wheels");
}

TEST(Link, ATaskRequestCanBeVetoedAndAnIdRunsOnce) {
    std::atomic<int> runs{0};
    EntityInterfacer interfacer(options("Veto"));
    interfacer.onTaskRequest([](const Task& task) {
        return task.has("Distance") ? Decision::grant() : Decision::deny("how far?");
    });
    interfacer.onAnyTask([&](Task&) { runs++; });
    interfacer.start();
    Manager manager("Veto");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto denied = manager.dispatch("Drive", 0);
    const auto granted = manager.dispatch("Drive", 0, {param("Distance", 1)});
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(granted) && manager.answerOf(denied); }));
    EXPECT_EQ(manager.answerOf(denied), proto::DENIED);
    proto::EmToEi again;
    again.mutable_task()->set_task_id(granted);
    again.mutable_task()->set_service("Drive");
    *again.mutable_task()->add_params() = param("Distance", 1);
    const auto before = manager.messages().size();
    manager.send(again);
    ASSERT_TRUE(waitUntil([&] { return manager.messages().size() > before; }));
    EXPECT_EQ(manager.messages().back().task_answer().refusal().code(), proto::DUPLICATE);
    EXPECT_EQ(runs, 1);
}

TEST(Link, StopReachesTheCallbackWhileEveryHandlerIsBlocked) {
    std::promise<void> release;
    const auto released = release.get_future().share();
    Stops stops;
    EntityInterfacer interfacer(options("Blocked"));
    stops.attach(interfacer);
    interfacer.onTask("Stubborn", [released](Task&) { released.wait(); });
    interfacer.onText([released](const std::string&, const std::string&) { released.wait(); });
    interfacer.start();
    Manager manager("Blocked");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto id = manager.dispatch("Stubborn", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(id).has_value(); }));
    proto::EmToEi text;
    text.mutable_text()->set_text("blocks the data thread");
    manager.send(text);
    const auto at = Clock::now();
    const auto generation = manager.stop();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation); }, 2s));
    EXPECT_LT(stops.lastAt() - at, 1s * kSlow);
    EXPECT_EQ(stops.seen().size(), 1U);
    EXPECT_EQ(stops.seen()[0].generation, generation);
    EXPECT_EQ(stops.seen()[0].cause, Cause::Requested);
    release.set_value();
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(id).has_value(); }));
    EXPECT_EQ(manager.finalOf(id)->state(), proto::TASK_STOPPED);
}

TEST(Link, StopIsWrittenWhileTheStrandIsStuck) {
    Stops stops;
    std::promise<void> go;
    EntityInterfacer interfacer(options("Stuck"));
    stops.attach(interfacer);
    interfacer.start();
    Manager manager("Stuck");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    manager.freeze(go.get_future().share());
    manager.stop();
    EXPECT_TRUE(waitUntil([&] { return stops.count(Cause::Requested) == 1; }, 900ms));
    go.set_value();
}

TEST(Link, StopIsIdempotentByGenerationAndOlderTasksAreRefused) {
    Stops stops;
    EntityInterfacer interfacer(options("Level"));
    stops.attach(interfacer);
    interfacer.onAnyTask([](Task& task) { task.waitFor(30s); });
    interfacer.start();
    Manager manager("Level");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto running = manager.dispatch("Wait", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(running).has_value(); }));
    const auto generation = manager.stop();
    manager.rawStop(generation, StopCause::Requested);
    manager.rawStop(generation, StopCause::ClientLost);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(running).has_value(); }));
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation); }));
    const auto older = manager.dispatch("Wait", generation - 1);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(older).has_value(); }));
    EXPECT_EQ(manager.answerOf(older), proto::OLD_GENERATION);
    const auto newer = manager.dispatch("Wait", generation);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(newer).has_value(); }));
    EXPECT_EQ(manager.answerOf(newer), proto::OK);
    EXPECT_EQ(stops.seen().size(), 1U);
    EXPECT_EQ(stops.seen()[0].cause, Cause::Requested);
}

TEST(Link, ATaskWaitsForTheStopCallbackBeforeIt) {
    std::promise<void> release;
    const auto released = release.get_future().share();
    std::atomic<bool> in_stop{false}, overlapped{false};
    EntityInterfacer interfacer(options("Order"));
    interfacer.onStop([&, released](const StopSignal& stop) {
        if (stop.cause != Cause::Reset) return;
        in_stop = true;
        released.wait_for(200ms);
        in_stop = false;
    });
    interfacer.onAnyTask([&](Task&) { overlapped = in_stop.load(); });
    interfacer.start();
    Manager manager("Order");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto generation = manager.stop(StopCause::Reset);
    const auto next = manager.dispatch("Next", generation);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(next).has_value(); }));
    EXPECT_FALSE(overlapped);
    release.set_value();
}

TEST(Link, AGenerationRaisedWithoutAStopIsHealedByTheBeats) {
    Stops stops;
    EntityInterfacer interfacer(options("Heal"));
    stops.attach(interfacer);
    interfacer.start();
    Manager manager("Heal", {5500, 5600}, {}, 2s, 2s);  // a fifth of it from beat to beat
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto generation = manager.stop_generations.raise();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation); }));
    EXPECT_EQ(stops.seen().size(), 1U);
}

TEST(Link, ALinkBeginsAtItsManagersGenerationWithoutAStop) {
    Stops stops;
    EntityInterfacer interfacer(options("Base"));
    stops.attach(interfacer);
    interfacer.onAnyTask([](Task&) {});
    Manager manager("Base");
    for (int i = 0; i < 7; ++i) manager.stop_generations.raise();
    interfacer.start();
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto id = manager.dispatch("Any", 7);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(id).has_value(); }));
    EXPECT_TRUE(stops.seen().empty());
}

TEST(Link, ADrillIsAcknowledgedWithoutCallingTheApplicationOrEndingATask) {
    Stops stops;
    EntityInterfacer interfacer(options("Drill"));
    stops.attach(interfacer);
    interfacer.onAnyTask([](Task& task) { task.waitFor(30s); });
    interfacer.start();
    Manager manager("Drill");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto running = manager.dispatch("Wait", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(running).has_value(); }));
    manager.rawStop(9, StopCause::Drill);  // its number, and no generation
    ASSERT_TRUE(waitUntil([&] { return manager.drilled(9); }));
    EXPECT_FALSE(manager.acknowledged(9)) << "a drill confirms no stop";
    const auto next = manager.dispatch("Wait", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(next).has_value(); }));
    EXPECT_EQ(manager.answerOf(next), proto::OK);
    EXPECT_TRUE(stops.seen().empty());
    EXPECT_FALSE(manager.finalOf(running));
    manager.stop();
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(running) && manager.finalOf(next); }));
    EXPECT_EQ(stops.count(Cause::Requested), 1U);
}

TEST(Link, StandstillIsTheLastStageOfTheReceipt) {
    EntityInterfacer interfacer(options("Still"));
    interfacer.onStop([&](const StopSignal&) { interfacer.standstill(); });
    interfacer.start();
    Manager manager("Still");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto generation = manager.stop();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation, proto::StopReceipt::STANDSTILL); }));
}

TEST(Link, StandstillThatIsSaidWhileTheStopCallbackRunsIsToldOnceItHasReturned) {
    EntityInterfacer interfacer(options("Still"));
    std::promise<void> called, release;
    const auto released = release.get_future().share();
    interfacer.onStop([&, first = true](const StopSignal&) mutable {
        interfacer.standstill();
        if (!std::exchange(first, false)) return;
        called.set_value();
        released.wait();
    });
    interfacer.start();
    Manager manager("Still");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto generation = manager.stop();
    called.get_future().wait();
    interfacer.standstill();  // of another thread, such as one that reads the motors
    EXPECT_FALSE(manager.acknowledged(generation, proto::StopReceipt::STANDSTILL));
    release.set_value();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation, proto::StopReceipt::STANDSTILL); }));
    std::vector<proto::StopReceipt::Stage> stages;
    for (const auto& message : manager.messages())
        if (message.has_stop_done()) stages.push_back(message.stop_done().stage());
    EXPECT_EQ(stages, (std::vector<proto::StopReceipt::Stage>{proto::StopReceipt::CALLBACK_RETURNED,
                                                              proto::StopReceipt::STANDSTILL}));
}

TEST(Link, AStandstillBeforeTheStopCallbackIsCalledAgainIsNotTold) {
    std::promise<void> go;
    const auto released = go.get_future().share();
    std::atomic<bool> inside{false};
    std::atomic<int> stops{0};
    EntityInterfacer interfacer(options("Still"));
    interfacer.onStop([&](const StopSignal&) {
        if (++stops == 1) interfacer.standstill();
    });
    interfacer.onRaw([&, released](const std::vector<std::string>&, const std::string&) {
        inside = true;
        released.wait();  // then it drives on
    });
    Manager manager("Still");
    interfacer.start();
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    proto::EmToEi velocities;
    velocities.mutable_raw()->add_data("fast");
    manager.send(velocities);
    ASSERT_TRUE(waitUntil([&] { return inside.load(); }));
    const auto generation = manager.stop();
    ASSERT_TRUE(waitUntil([&] { return stops == 1; }));
    go.set_value();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation); }));
    EXPECT_EQ(stops, 2);
    manager.rawStop(9, StopCause::Drill);
    ASSERT_TRUE(waitUntil([&] { return manager.drilled(9); })) << "what was said before it is here";
    EXPECT_FALSE(manager.acknowledged(generation, proto::StopReceipt::STANDSTILL));
    interfacer.standstill();
    EXPECT_TRUE(waitUntil([&] { return manager.acknowledged(generation, proto::StopReceipt::STANDSTILL); }));
}

TEST(Link, WhetherStandstillFollowsIsDeclaredOrKnownFromTheFirstTimeOn) {
    for (const bool declared : {true, false}) {
        auto with = options("Rolls");
        with.reports_standstill = declared;
        EntityInterfacer interfacer(with);
        interfacer.start();
        Manager manager("Rolls");
        ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
        const auto follows = [&](std::uint32_t generation) {
            for (const auto& message : manager.messages())
                if (message.stop_done().stop_generation() == generation &&
                    message.stop_done().standstill_follows())
                    return true;
            return false;
        };
        const auto first = manager.stop();
        ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(first); }));
        EXPECT_EQ(follows(first), declared);
        interfacer.standstill();
        const auto second = manager.stop();
        ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(second); }));
        EXPECT_TRUE(follows(second));
    }
}

TEST(Link, AnApplicationThatEndsInOrderSaysGoodByeUnlessItsStopCallbackHasThrown) {
    for (const bool broken : {false, true}) {
        std::atomic<int> calls{0};
        auto interfacer = std::make_unique<EntityInterfacer>(options("Bye"));
        interfacer->onStop([&](const StopSignal&) {
            ++calls;
            if (broken) throw std::runtime_error("the brake does not answer");
        });
        interfacer->start();
        Manager manager("Bye");
        ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer->linked(); }));
        interfacer.reset();
        ASSERT_TRUE(waitUntil([&] { return manager.downs == 1; }));
        EXPECT_GE(calls, 1);
        EXPECT_EQ(manager.downEnd(), broken ? LinkEnd::Closed : LinkEnd::GoodBye);
    }
}

TEST(Link, WhatIsRefusedToAnApplicationReachesIt) {
    std::atomic<int> told{0};
    std::string why;
    EntityInterfacer interfacer(options("Astray"));
    interfacer.onNotSent([&](const std::string& to, const std::string& reason) {
        why = to + ": " + reason;
        ++told;
    });
    interfacer.start();
    Manager manager("Astray");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    proto::EmToEi message;
    message.mutable_not_sent()->set_to("Cyton");
    message.mutable_not_sent()->mutable_reason()->set_message("there is no run");
    manager.send(message);
    ASSERT_TRUE(waitUntil([&] { return told == 1; }));
    EXPECT_EQ(why, "Cyton: there is no run");
    EXPECT_TRUE(manager.linked());
}

TEST(Link, AStopCallbackThatThrowsIsNotConfirmedIsCalledAgainAndNobodyLinksMeanwhile) {
    std::atomic<bool> broken{true};
    std::atomic<int> calls{0}, ran{0};
    EntityInterfacer interfacer(options("Brake"));
    interfacer.onStop([&](const StopSignal&) {
        ++calls;
        if (broken) throw std::runtime_error("the brake does not answer");
    });
    interfacer.onTask("Drive", [&](Task&) { ran++; });
    interfacer.start();
    std::optional<Manager> manager(std::in_place, "Brake", PortRange{5500, 5600}, std::string(), 100ms,
                                   500ms);
    ASSERT_TRUE(waitUntil([&] { return manager->linked() && interfacer.linked(); }));
    const auto generation = manager->stop();
    ASSERT_TRUE(waitUntil([&] { return calls >= 3; }));
    manager->dispatch("Drive", generation);
    EXPECT_FALSE(manager->acknowledged(generation));
    std::string fault;
    for (const auto& message : manager->messages())
        if (message.has_stop_done()) fault = message.stop_done().fault();
    EXPECT_NE(fault.find("the brake does not answer"), std::string::npos) << fault;

    manager.reset();
    Manager next("Brake");
    ASSERT_TRUE(waitUntil([&] { return next.refusal().code == RefusalCode::WrongState; }));
    EXPECT_FALSE(next.linked());
    EXPECT_EQ(ran, 0);
    broken = false;
    EXPECT_TRUE(waitUntil([&] { return next.linked() && interfacer.linked(); }));
}

TEST(Link, AStopCallbackThatThrewIsConfirmedOnceItReturns) {
    std::atomic<int> calls{0};
    EntityInterfacer interfacer(options("Late"));
    interfacer.onStop([&](const StopSignal&) {
        if (++calls < 3) throw 7;
    });
    interfacer.onTask("Drive", [](Task&) {});
    interfacer.start();
    Manager manager("Late");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto generation = manager.stop();
    const auto task = manager.dispatch("Drive", generation);
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation); }));
    EXPECT_EQ(calls, 3);
    EXPECT_TRUE(waitUntil([&] { return manager.finalOf(task).has_value(); }));
}

TEST(Link, ADeadManagerStopsTheRobot) {
    Stops stops;
    std::atomic<Cause> seen_by_task{Cause::Unspecified};
    std::atomic<bool> running{false};
    std::atomic<int> downs{0};
    EntityInterfacer interfacer(options("Dead"));
    stops.attach(interfacer);
    interfacer.onAnyTask([&](Task& task) {
        running = true;
        task.waitFor(30s);
        seen_by_task = task.stopCause();
        running = false;
    });
    interfacer.onLinkDown([&](const std::string&) { downs++; });
    interfacer.start();
    auto manager = std::make_unique<Manager>("Dead");
    ASSERT_TRUE(waitUntil([&] { return manager->linked(); }));
    manager->dispatch("Any", 0);
    ASSERT_TRUE(waitUntil([&] { return running.load(); }));
    const auto at = Clock::now();
    manager->die();
    ASSERT_TRUE(waitUntil([&] { return stops.count(Cause::LinkLost) == 1; }));
    EXPECT_LT(stops.lastAt() - at,
              1s * kSlow);  // far below its watchdog: the closed connection is what is seen
    EXPECT_TRUE(waitUntil([&] { return !running && downs == 1; }));
    EXPECT_EQ(seen_by_task, Cause::LinkLost);
    manager = std::make_unique<Manager>("Dead");  // and everything works again
    ASSERT_TRUE(waitUntil([&] { return manager->linked() && interfacer.linked(); }));
    EXPECT_EQ(stops.seen().size(), 1U);
}

TEST(Link, ASilentManagerStopsTheRobotWithinTheWatchdog) {
    Stops stops;
    std::promise<void> go;
    EntityInterfacer interfacer(options("Silent"));
    stops.attach(interfacer);
    interfacer.start();
    Manager manager("Silent", {5500, 5600}, {}, 100ms, 500ms);
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    proto::EmToEi text;
    manager.setBusy(true);
    manager.freeze(go.get_future().share());
    const auto at = Clock::now();
    ASSERT_TRUE(waitUntil([&] { return stops.count(Cause::LinkLost) == 1; }, 5s));
    EXPECT_LT(stops.lastAt() - at, 100ms * kSlow + 400ms);  // axon-faults measures the promise, 100 ms
    go.set_value();
    ASSERT_TRUE(waitUntil([&] { return manager.downs >= 1; }));
    // Whoever reads the log must not look for the fault in the robot application.
    EXPECT_NE(manager.downReason().find("the Entity Manager has been silent"), std::string::npos)
        << manager.downReason();
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
}

TEST(Link, ASlowStopCallbackIsNoSilenceOfTheManager) {
    std::atomic<int> lost{0};
    std::promise<void> never;
    const auto future = never.get_future().share();
    EntityInterfacer interfacer(options("SlowStop"));
    interfacer.onStop([&, future](const StopSignal& stop) {
        if (stop.cause == Cause::Requested) future.wait_for(1200ms * kSlow);  // four of the watchdogs below
        if (stop.cause == Cause::LinkLost) lost++;
    });
    interfacer.start();
    Manager manager("SlowStop", {5500, 5600}, {}, 300ms, 500ms);
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    manager.setBusy(true);
    const auto generation = manager.stop();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation); }));
    EXPECT_EQ(lost, 0);
    EXPECT_TRUE(manager.linked());
}

TEST(Link, AStopCallbackMayWaitForALockThatTheTaskHolds) {
    std::mutex robot;  // of the application
    std::mutex mutex;
    std::vector<std::uint32_t> stopped;
    std::atomic<bool> in_callback{false}, task_saw_it{false};
    std::atomic<int> lost{0};
    std::promise<void> release;
    const auto released = release.get_future().share();
    EntityInterfacer interfacer(options("Lock"));
    interfacer.onStop([&](const StopSignal& stop) {
        if (stop.cause == Cause::LinkLost) lost++;
        in_callback = true;
        const std::lock_guard held(robot);
        const std::lock_guard lock(mutex);
        stopped.push_back(stop.generation);
    });
    interfacer.onTask("Grip", [&, released](Task& task) {
        const std::lock_guard held(robot);
        task.waitFor(30s);
        task_saw_it = task.stopRequested();
        released.wait_for(1200ms * kSlow);  // four of the watchdogs below
    });
    interfacer.start();
    Manager manager("Lock", {5500, 5600}, {}, 300ms, 500ms);
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    manager.setBusy(true);
    const auto id = manager.dispatch("Grip", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(id) == proto::OK; }));
    const auto first = manager.stop();
    // The task learns of the stop while the callback waits for it: who looks at stopRequested() cannot lock
    // up.
    ASSERT_TRUE(waitUntil([&] { return in_callback && task_saw_it; }));
    const auto second = manager.stop();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(second) && manager.finalOf(id); }));
    EXPECT_EQ(manager.finalOf(id)->state(), proto::TASK_STOPPED);
    const std::lock_guard lock(mutex);
    EXPECT_EQ(stopped, (std::vector{first, second}));
    EXPECT_EQ(lost, 0) << "beats were answered all the time";
    EXPECT_EQ(manager.downs, 0);
}

TEST(Link, AnExceptionInAHandlerFailsTheTaskStopsAndNoQueuedTaskBegins) {
    Stops stops;
    std::atomic<int> good_runs{0};
    EntityInterfacer interfacer(options("Throw"));
    stops.attach(interfacer);
    interfacer.onTask("Bad", [](Task& task) { task.number("Missing"); });
    interfacer.onParameter([](const std::string&, const Parameter&) -> Decision { throw 7; });
    interfacer.onTask("Good", [&](Task&) { good_runs++; });
    interfacer.start();
    Manager manager("Throw");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    // The next of the queue goes out in the same moment as the verdict comes in.
    proto::EmToEi next;
    next.mutable_task()->set_task_id(std::string(16, 'n'));
    next.mutable_task()->set_service("Good");
    manager.on_message = [&](const proto::EiToEm& message) {
        if (message.has_task() && message.task().event().state() == proto::TASK_FAILED) manager.sendNow(next);
    };
    const auto bad = manager.dispatch("Bad", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(bad) && stops.count(Cause::Fault) == 1; }));
    EXPECT_EQ(manager.finalOf(bad)->state(), proto::TASK_FAILED);
    EXPECT_NE(manager.finalOf(bad)->reason().message().find("Missing"), std::string::npos);
    ASSERT_TRUE(waitUntil([&] { return manager.downs == 1 && manager.ups == 2 && interfacer.linked(); }));
    proto::EmToEi ask;
    ask.mutable_param()->set_request(1);
    manager.send(ask);
    ASSERT_TRUE(waitUntil([&] { return manager.answerTo(1) && stops.count(Cause::Fault) == 2; }));
    EXPECT_EQ(manager.answerTo(1)->code(), proto::DENIED);
    ASSERT_TRUE(waitUntil([&] { return manager.downs == 2 && manager.ups == 3 && interfacer.linked(); }));
    EXPECT_EQ(good_runs, 0);
    const auto good = manager.dispatch("Good", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(good).has_value(); }));
    EXPECT_EQ(manager.finalOf(good)->state(), proto::TASK_SUCCEEDED);
}

TEST(Link, WhatAStopHasOvertakenDoesNotReachTheApplication) {
    std::atomic<int> params{0}, resumes{0};
    std::mutex mutex;
    std::vector<std::string> raw;
    std::promise<void> end;
    const auto ended = end.get_future().share();
    EntityInterfacer interfacer(options("Overtaken"));
    interfacer.onStop([](const StopSignal&) {});
    interfacer.onRaw([&](const std::vector<std::string>& blocks, const std::string&) {
        const std::lock_guard lock(mutex);
        raw.push_back(blocks.at(0));
    });
    interfacer.onParameter([&](const std::string&, const Parameter&) {
        params++;
        return Decision::grant();
    });
    interfacer.onResume([&](const Task&) { resumes++; });
    interfacer.onTask("Stubborn", [ended](Task&) { ended.wait_for(10s); });
    interfacer.start();
    Manager manager("Overtaken");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    const auto task = manager.dispatch("Stubborn", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(task).has_value(); }));
    proto::EmToEi pause;
    pause.mutable_pause()->set_task_id(task);
    manager.send(pause);
    const auto newest = manager.stop();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(newest); }));
    for (const auto generation : {newest - 1, newest}) {
        proto::EmToEi velocities;
        velocities.mutable_raw()->add_data(generation == newest ? "new" : "old");
        velocities.mutable_raw()->set_stop_generation(generation);
        manager.send(velocities);
        pause.mutable_pause()->set_resume(true);
        pause.mutable_pause()->set_stop_generation(generation);  // the task itself is older in both cases
        manager.send(pause);
        proto::EmToEi ask;
        ask.mutable_param()->set_request(generation + 10);
        ask.mutable_param()->set_stop_generation(generation);
        manager.send(ask);
    }
    ASSERT_TRUE(waitUntil([&] { return manager.answerTo(newest + 10).has_value(); }));
    EXPECT_EQ(manager.answerTo(newest + 9)->code(), proto::OLD_GENERATION);
    EXPECT_EQ(manager.answerTo(newest + 10)->code(), proto::OK);
    EXPECT_EQ(params, 1);
    EXPECT_EQ(resumes, 0);
    end.set_value();
    const std::lock_guard lock(mutex);
    EXPECT_EQ(raw, std::vector<std::string>{"new"});
}

TEST(Link, AStopThatMeetsRawDataInTheApplicationHasTheLastWord) {
    std::promise<void> go;
    const auto released = go.get_future().share();
    std::atomic<bool> inside{false};
    std::atomic<int> raw{0};
    std::mutex mutex;
    std::vector<std::string> story;
    const auto tell = [&](const char* what) {
        const std::lock_guard lock(mutex);
        story.emplace_back(what);
    };
    EntityInterfacer interfacer(options("LastWord"));
    interfacer.onStop([&](const StopSignal&) { tell("stop"); });
    interfacer.onRaw([&, released](const std::vector<std::string>&, const std::string&) {
        inside = true;
        released.wait();
        tell("moved");
        raw++;
    });
    Manager manager("LastWord");
    interfacer.start();
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    proto::EmToEi velocities;
    velocities.mutable_raw()->add_data("fast");
    manager.send(velocities);
    manager.send(velocities);
    ASSERT_TRUE(waitUntil([&] { return inside.load(); }));
    const auto first = manager.stop();
    const auto second = manager.stop(StopCause::ClientLost);
    EXPECT_TRUE(waitUntil([&] {
        const std::lock_guard lock(mutex);
        return story.size() == 2;
    })) << "a stop does not wait for the application";
    EXPECT_FALSE(manager.acknowledged(first));
    EXPECT_FALSE(manager.acknowledged(second));
    go.set_value();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(second); }));
    EXPECT_EQ(raw, 1) << "what had been sent before the stop does not arrive after it";
    const std::lock_guard lock(mutex);
    EXPECT_EQ(story, (std::vector<std::string>{"stop", "stop", "moved", "stop"}));
}

TEST(Link, ATaskWhoseTimePassesInTheApplicationDoesNotBegin) {
    std::promise<void> go;
    const auto released = go.get_future().share();
    std::atomic<int> runs{0};
    EntityInterfacer interfacer(options("TooLate"));
    interfacer.onStop([](const StopSignal&) {});
    interfacer.onTaskRequest([released](const Task& task) {
        if (task.service() == "Slow") released.wait();
        return Decision::grant();
    });
    interfacer.onTask("Slow", [&](Task&) { runs++; });
    interfacer.onTask("Quick", [&](Task&) { runs++; });
    interfacer.start();
    Manager manager("TooLate");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    proto::EmToEi message;
    auto& task = *message.mutable_task();
    task.set_task_id(std::string(16, 's'));
    task.set_service("Slow");
    task.set_start_within_ms(1);
    const auto sent = Clock::now();
    manager.send(message);
    ASSERT_TRUE(waitUntil([&] { return Clock::now() > sent + 50ms; }));
    go.set_value();
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(task.task_id()).has_value(); }));
    EXPECT_EQ(manager.answerOf(task.task_id()), proto::EXPIRED);
    task.set_task_id(std::string(16, 'q'));
    task.set_service("Quick");
    task.set_start_within_ms(60'000);
    manager.send(message);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(task.task_id()).has_value(); }));
    EXPECT_EQ(runs, 1);
}

TEST(Link, BothEndsMeasureTheLongestSilenceOfTheOther) {
    EntityInterfacer interfacer(options("Margins"));
    interfacer.onStop([](const StopSignal&) {});
    interfacer.start();
    Manager manager("Margins", {5500, 5600}, {}, 1s, 2s);
    EXPECT_TRUE(waitUntil([&] {
        const auto margins = manager.margins();
        return margins.size() == 2 && std::all_of(margins.begin(), margins.end(), [](const auto& margin) {
                   return margin.gap.allowed == 2s * kSlow && margin.gap.length > Duration{} &&
                          margin.gap.part() < 1;
               });
    }));
    manager.setBusy(true);
    EXPECT_TRUE(waitUntil([&] {
        const auto margins = manager.margins();
        return margins.size() == 2 && margins[0].gap.part() < 1 && manager.linked();
    }));
}

TEST(Link, ALoggerThatBlocksHoldsUpNeitherStopNorWatchdog) {
    std::promise<void> release, go;
    const auto released = release.get_future().share();
    std::atomic<bool> blocked{false};
    std::atomic<int> requested{0}, lost{0};
    auto o = options("Logger");
    o.logger = [&, released](LogLevel, const std::string& text) {
        if (text.find("stop callback has not stopped the robot") == std::string::npos) return;
        blocked = true;
        released.wait();
    };
    EntityInterfacer interfacer(o);
    interfacer.onStop([&](const StopSignal& stop) {
        if (stop.cause == Cause::LinkLost) lost++;
        if (stop.cause == Cause::Requested && ++requested == 1) throw std::runtime_error("first");
    });
    Manager manager("Logger", {5500, 5600}, {}, 100ms, 500ms);
    const std::shared_ptr<void> at_end(nullptr, [&](void*) { release.set_value(), go.set_value(); });
    interfacer.start();
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    manager.stop();
    ASSERT_TRUE(waitUntil([&] { return blocked.load(); }));
    const auto second = manager.stop();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(second); }));
    EXPECT_GE(requested, 2);  // the first is called again, too
    manager.freeze(go.get_future().share());
    EXPECT_TRUE(waitUntil([&] { return lost == 1; }, 2s * kSlow));
}

TEST(Link, TextThatIsNoUtf8DoesNotEndTheLink) {
    EntityInterfacer interfacer(options("Bytes"));
    interfacer.onTask("Bad", [](Task& task) {
        task.feedback(std::string(64 * 1024 - 1, 'a') + "\xC3\xBC");
        task.result("R\xFF", std::string("\xFF"), "\xFF");
        task.fail("gr\xFC\xDF");
    });
    interfacer.onParameter([](const std::string&, const Parameter&) { return Decision::deny("\xFF"); });
    interfacer.start();
    Manager manager("Bytes");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    interfacer.sendInfoMsg("\xFF");
    interfacer.setStatus(true, "\xFF");
    interfacer.setServiceActive("S\xFF", false, "\xFF");
    interfacer.stream("pose\xFF").send(1.0, "\xFF");
    interfacer.stream("map").send(Pose{0, 0, 0, 0, 0, 0, "\xFF"});
    proto::EmToEi ask;
    ask.mutable_param()->set_request(1);
    manager.send(ask);
    const auto bad = manager.dispatch("Bad", 0);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(bad) && manager.answerTo(1); }));
    EXPECT_EQ(manager.finalOf(bad)->reason().message(), "gr\xEF\xBF\xBD\xEF\xBF\xBD");
    EXPECT_EQ(manager.finalOf(bad)->results(0).values(0).str(), "\xEF\xBF\xBD");
    EXPECT_LE(manager.finalOf(bad)->feedback().size(), 64U * 1024U);
    EXPECT_EQ(manager.answerTo(1)->message(), "\xEF\xBF\xBD");
    EXPECT_EQ(manager.downs, 0);
}

TEST(Link, ASlowApplicationLosesOldRawDataAndKeepsTheLink) {
    constexpr int kFrames = 120;
    std::promise<void> go;
    const auto gone = go.get_future().share();
    std::atomic<int> newest{-1};
    std::atomic<std::uint64_t> count{0};
    bool set = false;
    EntityInterfacer interfacer(options("Slow"));
    interfacer.onRaw([&, gone](const std::vector<std::string>& blocks, const std::string&) {
        gone.wait();
        newest = std::stoi(blocks.at(0));
        count++;
    });
    Manager manager("Slow");
    const std::shared_ptr<void> at_end(nullptr, [&](void*) {
        if (!set) go.set_value();
    });
    interfacer.start();
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    proto::EmToEi raw;
    raw.mutable_raw()->add_data();
    raw.mutable_raw()->add_data(std::string(250'000, 'x'));
    for (int i = 0; i < kFrames; ++i) {
        raw.mutable_raw()->set_data(0, std::to_string(i));
        manager.send(raw);
    }
    ASSERT_TRUE(waitUntil([&] { return manager.rawDropped() > 0; }));
    set = true;
    go.set_value();
    ASSERT_TRUE(waitUntil([&] { return newest == kFrames - 1; }));
    EXPECT_TRUE(waitUntil([&] { return count + manager.rawDropped() == kFrames; }));
    EXPECT_EQ(manager.downs, 0);
}

TEST(Link, AMessageLargerThanAFrameIsNotSentAndSaysSo) {
    EntityInterfacer interfacer(options("Large"));
    interfacer.start();
    Manager manager("Large");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    std::promise<std::pair<bool, bool>> sent;
    manager.post([&] {
        proto::EmToEi message;
        message.mutable_text()->set_text("fits");
        const bool small = manager.sendNow(message);
        message.mutable_text()->set_text(std::string(kFrameMax, 'x'));
        sent.set_value({small, manager.sendNow(message)});
    });
    EXPECT_EQ(sent.get_future().get(), (std::pair{true, false}));
    EXPECT_TRUE(waitUntil([&] { return manager.refusal().code == RefusalCode::TooLarge; }));
    EXPECT_EQ(manager.downs, 0);
}

TEST(Link, DestructionStopsAndTheManagerIsTold) {
    Stops stops;
    Manager manager("End");
    std::string id;
    {
        EntityInterfacer interfacer(options("End"));
        stops.attach(interfacer);
        interfacer.onAnyTask([](Task& task) { task.waitFor(30s); });
        interfacer.start();
        ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
        id = manager.dispatch("Any", 0);
        ASSERT_TRUE(waitUntil([&] { return manager.answerOf(id).has_value(); }));
    }
    EXPECT_EQ(stops.count(Cause::Shutdown), 1U);
    ASSERT_TRUE(waitUntil([&] { return manager.downs == 1; }));
    EXPECT_EQ(manager.downReason(),
              "the robot application has ended the link: the robot application shuts down");
    ASSERT_TRUE(manager.finalOf(id));
    EXPECT_EQ(manager.finalOf(id)->state(), proto::TASK_STOPPED);
}

TEST(Link, CancelAndPauseReachTheOneTask) {
    std::atomic<bool> paused{false};
    std::atomic<int> finished{0}, pauses{0};
    EntityInterfacer interfacer(options("Cancel"));
    interfacer.onPause([&](const Task&) { pauses++; });
    interfacer.onResume([&](const Task&) { pauses++; });
    interfacer.onTask("A", [&](Task& task) {
        waitUntil([&] { return task.paused(); });
        paused = true;
        if (!task.waitWhilePaused()) return;
        paused = false;
        task.waitFor(30s);
    });
    interfacer.onTask("B", [&](Task& task) {
        task.waitFor(30s);
        finished++;
    });
    interfacer.start();
    Manager manager("Cancel");
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    const auto a = manager.dispatch("A", 0);
    manager.dispatch("B", 0);
    proto::EmToEi pause;
    pause.mutable_pause()->set_task_id(a);
    manager.send(pause);
    ASSERT_TRUE(waitUntil([&] { return paused.load(); }));
    pause.mutable_pause()->set_resume(true);
    manager.send(pause);
    ASSERT_TRUE(waitUntil([&] { return !paused; }));
    proto::EmToEi cancel;
    cancel.mutable_cancel()->set_task_id(a);
    manager.send(cancel);
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(a).has_value(); }));
    EXPECT_EQ(manager.finalOf(a)->state(), proto::TASK_CANCELLED);
    EXPECT_EQ(finished, 0);
    EXPECT_EQ(pauses, 2);
}

TEST(Link, TextRawAndStreamsTravelBothWays) {
    std::promise<std::string> text;
    std::promise<std::vector<std::string>> raw;
    EntityInterfacer interfacer(options("Talk"));
    interfacer.onText([&](const std::string& t, const std::string& from) { text.set_value(from + ":" + t); });
    interfacer.onRaw(
        [&](const std::vector<std::string>& blocks, const std::string&) { raw.set_value(blocks); });
    interfacer.start();
    auto stream = interfacer.stream("pose");
    stream.send(Pose{});  // nobody is linked: counted, and dropped
    Manager manager("Talk");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    proto::EmToEi message;
    message.mutable_text()->set_text("hi");
    message.mutable_text()->set_from("me");
    manager.send(message);
    message.mutable_raw()->add_data("ab");
    message.mutable_raw()->add_data("");
    manager.send(message);
    EXPECT_EQ(text.get_future().get(), "me:hi");
    EXPECT_EQ(raw.get_future().get(), (std::vector<std::string>{"ab", ""}));
    stream.send(Pose{1, 2, 3, 0, 0, 0.5, "map"});
    interfacer.sendInfoMsg("ready");
    interfacer.sendRaw("bytes");
    interfacer.setStatus(true, "working");
    ASSERT_TRUE(waitUntil([&] { return manager.messages().size() == 4; }));
    const auto got = manager.messages();
    EXPECT_EQ(got[0].sample().sequence(), 2U);
    EXPECT_EQ(got[0].sample().pose().frame(), "map");
    EXPECT_EQ(got[1].text().text(), "ready");
    EXPECT_EQ(got[2].raw().data(0), "bytes");
    EXPECT_TRUE(got[3].status().busy());
    const auto other = interfacer.stream("scan");
    const auto turn = [&](const std::string& name, bool on) {
        proto::EmToEi control;
        control.mutable_stream()->set_stream(name);
        control.mutable_stream()->set_on(on);
        manager.send(control);
    };
    turn("", false);
    EXPECT_TRUE(waitUntil([&] { return !stream.wanted() && !other.wanted(); }));
    turn("pose", true);
    turn("", true);
    turn("", false);  // who watches all leaves; who watches "pose" stays
    turn("scan", true);
    EXPECT_TRUE(waitUntil([&] { return other.wanted(); }));
    EXPECT_TRUE(stream.wanted());
    turn("pose", false);
    EXPECT_TRUE(waitUntil([&] { return !stream.wanted(); }));
    EXPECT_TRUE(other.wanted());
}

TEST(Link, ASecondManagerIsRefusedWithATypedErrorAndTakesOverLater) {
    EntityInterfacer interfacer(options("Only"));
    interfacer.start();
    auto first = std::make_unique<Manager>("Only");
    ASSERT_TRUE(waitUntil([&] { return first->linked(); }));
    Manager second("Only");
    ASSERT_TRUE(waitUntil([&] { return !second.refusal().ok(); }));
    EXPECT_EQ(second.refusal().code, RefusalCode::AlreadyHeld);
    EXPECT_NE(second.refusal().message.find("test Only"), std::string::npos);
    EXPECT_FALSE(second.linked());
    EXPECT_TRUE(first->linked());
    EXPECT_EQ(first->downs, 0);
    first.reset();
    EXPECT_TRUE(waitUntil([&] { return second.linked(); }));
}

/// What an application has logged about releases.
class ReleaseLog {
  public:
    explicit ReleaseLog(EntityInterfacer::Options& of) {
        of.logger = [this](LogLevel level, const std::string& text) {
            const std::lock_guard lock(mutex_);
            if (text.find("release") == std::string::npos) return;
            EXPECT_EQ(level, LogLevel::Info);
            lines_.push_back(text);
        };
    }
    std::vector<std::string> lines() {
        const std::lock_guard lock(mutex_);
        return lines_;
    }

  private:
    std::mutex mutex_;
    std::vector<std::string> lines_;
};

TEST(Link, EndsOfOneReleaseSayNothingOfIt) {
    auto its = options("Same");
    ReleaseLog log(its);
    EntityInterfacer interfacer(its);
    interfacer.start();
    Manager manager("Same");
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && interfacer.linked(); }));
    interfacer.shutdown();
    EXPECT_TRUE(log.lines().empty());
    EXPECT_TRUE(manager.releaseNotes().empty());
}

TEST(Link, AnApplicationSaysOnceThatItsManagerHasAnotherRelease) {
    auto its = options("Older");
    ReleaseLog log(its);
    EntityInterfacer interfacer(its);
    interfacer.start();
    for (const std::string release : {"7.1", "7.1", "\x1b[2J of nobody"}) {
        RawSocket signal, data;
        auto hello = helloOf("Older", proto::LANE_SIGNAL, "12345678");
        hello.mutable_hello()->set_release(release);
        ASSERT_TRUE(waitUntil([&] {  // the link before has to end
            signal = RawSocket();
            if (!signal.connect(interfacer.port())) return false;
            signal.write(hello);
            const auto answer = signal.read();
            return answer && answer->welcome().refusal().code() == proto::OK;
        }));
        ASSERT_TRUE(data.connect(interfacer.port()));
        data.write(helloOf("Older", proto::LANE_DATA, "12345678"));
        const auto answer = data.read();
        ASSERT_TRUE(answer && answer->welcome().refusal().code() == proto::OK);
        EXPECT_EQ(answer->welcome().release(), kRelease);
        ASSERT_TRUE(waitUntil([&] { return interfacer.linked(); }));
    }
    ASSERT_TRUE(waitUntil([&] { return log.lines().size() == 2; }));
    EXPECT_EQ(log.lines()[0],
              std::string("connected with an Entity Manager of release 7.1, this robot application has ") +
                  kRelease + "; they work together, because both have protocol 1");
    EXPECT_NE(log.lines()[1].find(R"(of an unknown release ('\x1b[2J of nobody'))"), std::string::npos)
        << log.lines()[1];
}

TEST(Link, AManagerSaysOnceThatItsApplicationHasAnotherRelease) {
    RawSocket application;
    ASSERT_TRUE(application.listen(5500));
    Manager manager("Newer", {5500, 5500});
    for (const std::string release : {"7.1", "7.1", "7.2"}) {
        const auto before = manager.ups.load();
        std::vector<RawSocket> lanes;
        while (lanes.size() < 2) {
            lanes.push_back(application.accept());
            const auto hello = lanes.back().read<proto::EmToEi>();
            ASSERT_TRUE(hello && hello->has_hello());
            EXPECT_EQ(hello->hello().release(), kRelease);
            proto::EiToEm answer;
            auto& welcome = *answer.mutable_welcome();
            welcome.set_protocol(1);
            welcome.set_application("Newer");
            welcome.set_lane(hello->hello().lane());
            welcome.set_nonce(hello->hello().nonce());
            welcome.set_release(release);
            lanes.back().write(answer);
        }
        ASSERT_TRUE(waitUntil([&] { return manager.ups > before; }));
    }
    const auto notes = manager.releaseNotes();
    ASSERT_EQ(notes.size(), 2U);
    EXPECT_EQ(notes[0],
              std::string("connected with a robot application of release 7.1, this Entity Manager has ") +
                  kRelease + "; they work together, because both have protocol 1");
    EXPECT_NE(notes[1].find("release 7.2"), std::string::npos) << notes[1];
}

TEST(Link, ForeignAndSilentListenersInTheRangeArePassedOver) {
    RawSocket silent, garbage;
    ASSERT_TRUE(silent.listen(5500));
    ASSERT_TRUE(garbage.listen(5501));
    EntityInterfacer interfacer(options("Third"));
    interfacer.start();
    EXPECT_EQ(interfacer.port(), 5502);
    Manager manager("Third");
    EXPECT_TRUE(waitUntil([&] { return manager.linked(); }, 2s * kSlow));
}

TEST(Link, AListenerThatKeepsSilentCostsTheManagerNoDescriptorForLong) {
    Manager manager("Nobody", {5500, 5500});
    RawSocket silent;
    ASSERT_TRUE(silent.listen(5500));
    RawSocket first = silent.accept();
    EXPECT_TRUE(first.closedByPeer());
    RawSocket second = silent.accept();
    EXPECT_TRUE(second.closedByPeer()) << "and it is asked again later";
}

TEST(Link, TwoPairsInOneRangeFindTheirOwn) {
    EntityInterfacer one(options("Robot"));
    auto with_instance = options("Arm");
    with_instance.instance = "left";
    EntityInterfacer left(with_instance);
    with_instance.instance = "right";
    EntityInterfacer right(with_instance);
    for (auto* interfacer : {&one, &left, &right}) interfacer->start();
    Manager arm_right("Arm", {5500, 5600}, "right");
    Manager robot("Robot");
    Manager arm_left("Arm", {5500, 5600}, "left");
    ASSERT_TRUE(waitUntil([&] { return arm_right.linked() && robot.linked() && arm_left.linked(); }));
    right.sendInfoMsg("I am right");
    ASSERT_TRUE(waitUntil([&] { return right.linked() && left.linked() && one.linked(); }));
    right.sendInfoMsg("I am right");
    ASSERT_TRUE(waitUntil([&] { return !arm_right.messages().empty(); }));
    EXPECT_EQ(arm_right.messages()[0].text().text(), "I am right");
    EXPECT_TRUE(arm_left.messages().empty());
}

TEST(Link, BadFirstFramesAreRefusedAndDropped) {
    EntityInterfacer interfacer(options("Strict"));
    interfacer.start();
    const auto refusalOf = [&](const proto::EmToEi& message) {
        RawSocket peer;
        EXPECT_TRUE(peer.connect(interfacer.port()));
        peer.write(message);
        const auto answer = peer.read();
        EXPECT_TRUE(answer && answer->has_welcome());
        EXPECT_TRUE(peer.closedByPeer());
        return answer ? answer->welcome().refusal().code() : proto::OK;
    };
    auto hello = helloOf("Strict", proto::LANE_SIGNAL, "12345678");
    hello.mutable_hello()->set_protocol(2);
    EXPECT_EQ(refusalOf(hello), proto::NOT_SUPPORTED);
    EXPECT_EQ(refusalOf(helloOf("Other", proto::LANE_SIGNAL, "12345678")), proto::UNKNOWN_ENTITY);
    EXPECT_EQ(refusalOf(helloOf("Strict", proto::LANE_SIGNAL, "1")), proto::MALFORMED);
    EXPECT_EQ(refusalOf(helloOf("Strict", proto::LANE_UNSPECIFIED, "12345678")), proto::MALFORMED);
    EXPECT_EQ(refusalOf(helloOf("Strict", proto::LANE_DATA, "12345678")), proto::WRONG_STATE);
    proto::EmToEi beat;
    beat.mutable_beat()->set_sequence(1);
    EXPECT_EQ(refusalOf(beat), proto::MALFORMED);
    for (const auto& bytes :
         {std::string("\xFF\xFF\xFF\xFF", 4), std::string("GET / HTTP/1.0\r\n\r\n"), std::string(4, '\0')}) {
        RawSocket peer;
        ASSERT_TRUE(peer.connect(interfacer.port()));
        peer.write(bytes);
        EXPECT_TRUE(peer.closedByPeer());
    }
    Manager manager("Strict");
    EXPECT_TRUE(waitUntil([&] { return manager.linked(); }));
}

TEST(Link, SilentPeersAndAFloodOfHalfOpenOnesAreDropped) {
    EntityInterfacer interfacer(options("Flood"));
    interfacer.start();
    RawSocket silent;
    ASSERT_TRUE(silent.connect(interfacer.port()));
    const auto at = Clock::now();
    EXPECT_TRUE(silent.closedByPeer());
    EXPECT_LT(Clock::now() - at, 1200ms * kSlow);
    std::vector<RawSocket> flood(300);
    for (auto& peer : flood) ASSERT_TRUE(peer.connect(interfacer.port()));
    Manager manager("Flood");
    EXPECT_TRUE(waitUntil([&] { return manager.linked(); }, 3s * kSlow));
}

TEST(Link, MalformedFramesAfterTheLinkIsUpStopTheRobot) {
    for (const bool on_signal_lane : {true, false}) {
        Stops stops;
        EntityInterfacer interfacer(options("Garbage"));
        stops.attach(interfacer);
        interfacer.start();
        RawSocket signal, data;
        ASSERT_TRUE(signal.connect(interfacer.port()) && data.connect(interfacer.port()));
        signal.write(helloOf("Garbage", proto::LANE_SIGNAL, "abcdefgh"));
        ASSERT_TRUE(signal.read().has_value());
        data.write(helloOf("Garbage", proto::LANE_DATA, "abcdefgh"));
        ASSERT_TRUE(data.read().has_value());
        (on_signal_lane ? signal : data).write(std::string("\0\0\0\5\xFF\xFF\xFF\xFF\xFF", 9));
        EXPECT_TRUE(waitUntil([&] { return stops.count(Cause::LinkLost) == 1; }, 400ms * kSlow));
        EXPECT_TRUE((on_signal_lane ? data : signal).closedByPeer());
    }
}

#ifdef HELLO_ENTITY
TEST(HelloEntity, GreetsWithProgressWaitsAndEndsOnSigterm) {
    const ScratchFile ports("hello-ports.cfg",
                            "Axon.Ports = 5600-5620\nAxon.Address = " + test::loopbackAddress() + "\n");
    const auto child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
        ::execl(HELLO_ENTITY, "hello-entity", "examples/01_hello_entity", ports.path().c_str(), nullptr);
        ::_exit(127);
    }
    Manager manager("Greeter", {5600, 5620});
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && manager.messages().size() >= 2; }));
    EXPECT_NE(manager.messages()[1].profile().xml().find("\"Greet\""), std::string::npos);
    proto::Param name;
    name.set_name("Name");
    name.add_values()->set_str("Ada");
    const auto greet = manager.dispatch("Greet", 0, {name});
    const auto wait = manager.dispatch("Wait", 0, {param("Seconds", 0.01)});
    ASSERT_TRUE(waitUntil([&] { return manager.finalOf(greet) && manager.finalOf(wait); }));
    EXPECT_EQ(manager.finalOf(greet)->state(), proto::TASK_SUCCEEDED);
    EXPECT_EQ(manager.finalOf(greet)->feedback(), "Hello, Ada!");
    const auto messages = manager.messages();
    EXPECT_GE(std::count_if(messages.begin(), messages.end(),
                            [](const auto& m) { return m.has_task() && m.task().event().progress() > 0; }),
              3);
    const auto long_wait = manager.dispatch("Wait", 0, {param("Seconds", 600)});
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(long_wait).has_value(); }));
    const auto generation = manager.stop();
    ASSERT_TRUE(waitUntil([&] { return manager.acknowledged(generation) && manager.finalOf(long_wait); }));
    EXPECT_EQ(manager.finalOf(long_wait)->state(), proto::TASK_STOPPED);
    ::kill(child, SIGTERM);
    int status = -1;
    EXPECT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    EXPECT_TRUE(waitUntil([&] { return manager.downs == 1; }));
    EXPECT_EQ(manager.downEnd(), LinkEnd::GoodBye);
}

/// An application in a process of its own, killed with the test.
class HelloProcess {
  public:
    explicit HelloProcess(const std::string& ports) : id_(::fork()) {
        if (id_ != 0) return;
        ::execl(HELLO_ENTITY, "hello-entity", "examples/01_hello_entity", ports.c_str(), nullptr);
        ::_exit(127);
    }
    ~HelloProcess() {
        ::kill(id_, SIGKILL);
        ::waitpid(id_, nullptr, 0);
    }
    HelloProcess(const HelloProcess&) = delete;
    HelloProcess& operator=(const HelloProcess&) = delete;
    void signal(int which) const { ::kill(id_, which); }

  private:
    const pid_t id_;
};

TEST(HelloEntity, OneThatIsKilledHasSaidNoGoodByeAndOneThatIsFrozenIsSilent) {
    const ScratchFile ports("killed-ports.cfg",
                            "Axon.Ports = 5600-5620\nAxon.Address = " + test::loopbackAddress() + "\n");
    Manager manager("Greeter", {5600, 5620}, {}, 100ms, 500ms);
    {
        const HelloProcess application(ports.path());
        ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
        application.signal(SIGKILL);
        ASSERT_TRUE(waitUntil([&] { return manager.downs == 1; }));
        EXPECT_EQ(manager.downEnd(), LinkEnd::Closed);
    }
    const HelloProcess application(ports.path());
    ASSERT_TRUE(waitUntil([&] { return manager.linked(); }));
    application.signal(SIGSTOP);
    ASSERT_TRUE(waitUntil([&] { return manager.downs == 2; }));
    EXPECT_EQ(manager.downEnd(), LinkEnd::Silent);
    EXPECT_NE(manager.downReason().find("silent"), std::string::npos);
    application.signal(SIGCONT);
    EXPECT_TRUE(waitUntil([&] { return manager.linked(); }, 10s)) << "it stops by itself, and links again";
}

TEST(HelloEntity, EndedInTheMiddleOfATaskItLeavesOnceItHasStopped) {
    const ScratchFile ports("leave-ports.cfg",
                            "Axon.Ports = 5600-5620\nAxon.Address = " + test::loopbackAddress() + "\n");
    const ScratchFile said("leave-said", "");
    const auto child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
        ::dup2(::open(said.path().c_str(), O_WRONLY | O_APPEND), STDOUT_FILENO);
        ::execl(HELLO_ENTITY, "hello-entity", "examples/01_hello_entity", ports.path().c_str(), nullptr);
        ::_exit(127);
    }
    Manager manager("Greeter", {5600, 5620});
    ASSERT_TRUE(waitUntil([&] { return manager.linked() && manager.messages().size() >= 2; }));
    const auto id = manager.dispatch("Wait", 0, {param("Seconds", 600)});
    ASSERT_TRUE(waitUntil([&] { return manager.answerOf(id).has_value(); }));
    ::kill(child, SIGTERM);
    int status = -1;
    EXPECT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    // What the stop callback says, it says before it returns.
    std::string last;
    std::ifstream text(said.path());
    for (std::string line; std::getline(text, line);) last = line;
    EXPECT_EQ(last, toString(Cause::Shutdown));
    ASSERT_TRUE(waitUntil([&] { return manager.downs == 1; }));
    ASSERT_TRUE(manager.finalOf(id)) << "the last words come before the end of the link";
    EXPECT_EQ(manager.finalOf(id)->state(), proto::TASK_STOPPED);
}
#endif

TEST(Link, MisconfigurationNamesTheMend) {
    const auto messageOf = [](const EntityInterfacer::Options& o) -> std::string {
        try {
            EntityInterfacer interfacer(o);
            interfacer.start();
        } catch (const Misconfiguration& error) {
            return error.what();
        }
        return {};
    };
    EXPECT_NE(messageOf(options("")).find("expected"), std::string::npos);
    EXPECT_NE(messageOf(options("A", 5499, 6000)).find("5500 to 8000"), std::string::npos);
    auto beyond = options("A");
    beyond.address = "0.0.0.0";
    EXPECT_NE(messageOf(beyond).find("loopback"), std::string::npos);
    const ScratchFile ports("ports.cfg", "# range\nAxon.Ports = 80\n");
    auto from_file = options("A");
    from_file.ports_file = ports.path();
    EXPECT_NE(messageOf(from_file).find("ports.cfg:2"), std::string::npos);
    RawSocket other;
    ASSERT_TRUE(other.listen(5700));
    EXPECT_NE(messageOf(options("A", 5700, 5700)).find("in use"), std::string::npos);
    EntityInterfacer interfacer(options("A"));
    EXPECT_THROW(interfacer.uploadBasicProfile("/nonexistent.xml"), Misconfiguration);
}

}  // namespace
}  // namespace axon
