// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/application.hpp"

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <sstream>

namespace axon::peoplebot {
namespace {

using arcos::Command;
using arcos::RobotState;

constexpr auto kDriving = "Driving";
constexpr auto kTurning = "Turning";
constexpr Duration kControlPeriod =
    std::chrono::milliseconds{10};  // ten looks at each of the robot's packets
constexpr int kSonarsInScan = 24;
constexpr std::uint64_t kPacketsPerSecond = 10;

constexpr double kVelocity_mm_s = 200;  // the profile's, for a link that does not fill in defaults
constexpr double kRangeThreshold_mm = 500;
constexpr double kVelocity_deg_s = 30;

Driving::Request drivingRequest(const Task& task) {
    return {.distance_mm = task.number("Distance"),
            .velocity_mm_s = task.number("Velocity", kVelocity_mm_s),
            .range_threshold_mm = task.number("Range Threshold", kRangeThreshold_mm)};
}

Turning::Request turningRequest(const Task& task) {
    return {.angle_deg = task.number("Angle"), .velocity_deg_s = task.number("Velocity", kVelocity_deg_s)};
}

EntityInterfacer::Options interfacerOptions(const Settings& settings) {
    EntityInterfacer::Options options;
    options.application = settings.application;
    options.instance = settings.instance;
    if (std::filesystem::exists(settings.ports)) {
        options.ports_file = settings.ports;
    } else if (!settings.ports.empty()) {
        std::tie(options.first_port, options.last_port) = parsePortRange(settings.ports);
    }
    return options;
}

std::string contentOf(const std::filesystem::path& file) {
    std::ostringstream content;
    content << std::ifstream(file).rdbuf();
    return content.str();
}

}  // namespace

Application::Application(const Settings& settings)
    : entity_(interfacerOptions(settings)),
      pose_stream_(entity_.stream("pose")),
      sonar_stream_(entity_.stream("sonar")),
      battery_stream_(entity_.stream("battery")),
      origin_(settings.at),
      pose_(settings.at) {
    const auto folder = profileFolder(settings);
    if (settings.name.empty()) {
        entity_.uploadBasicProfile(folder / "basic_profile.xml");
    } else {
        renamed_profile_ = std::make_unique<TemporaryFile>(
            withEntityName(contentOf(folder / "basic_profile.xml"), settings.name));
        entity_.uploadBasicProfile(renamed_profile_->path());
    }
    entity_.uploadServiceProfile(folder / "services_profile.xml");
    entity_.setPosition(settings.at.x_mm, settings.at.y_mm, 0);
    setServicesActive(false, "the robot is not connected yet");

    auto open = arcos::tcpStreams(settings.robot);
    gate_ = std::make_unique<DriveGate>(DriveGate::Robot{
        .drive = [this](double forward, double left) { return robot_->drive(forward, left); },
        .stop = [this] { return robot_->stop(); },
    });
    offerServices();
    // Two steps: its callbacks use robot_.
    robot_ = std::make_unique<arcos::ArcosClient>(
        std::move(open),
        arcos::ArcosClient::Callbacks{
            .on_online = [this](const arcos::RobotIdentity& identity) { onRobotOnline(identity); },
            .on_state = [this](const RobotState& robot) { onRobotState(robot); },
            .on_lost = [this](const std::string& reason) { onRobotLost(reason); },
        },
        settings.robot_silence_limit);
    robot_->start();
}

Application::~Application() {
    // Stops the robot, and ends the handlers, which use it, before it goes.
    entity_.shutdown();
    robot_.reset();
}

void Application::start() {
    entity_.start();
}
void Application::run() {
    entity_.run();
}

void Application::offerServices() {
    entity_.onTask(kDriving, [this](Task& task) { drive(task); });
    entity_.onTask(kTurning, [this](Task& task) { turn(task); });
    entity_.onTaskRequest([this](const Task& task) { return consider(task); });
    entity_.onStop([this](const StopSignal& /*signal*/) { onStop(); });
}

Decision Application::consider(const Task& task) const {
    if (!robot_->state().online) return Decision::robotLost("the robot is not connected: is it switched on, is its address right?");
    try {
        const auto objection = task.service() == kDriving ? Driving::objection(drivingRequest(task))
                                                          : Turning::objection(turningRequest(task));
        return objection.empty() ? Decision::grant() : Decision::deny(objection);
    } catch (const std::invalid_argument& error) {
        return Decision::deny(error.what());
    }
}

void Application::drive(Task& task) {
    Driving motion(drivingRequest(task), robot_->state(), clock_.now());
    perform(task, motion, [&] { task.result("Travelled", std::round(motion.travelled_mm()), "mm"); });
}

void Application::turn(Task& task) {
    Turning motion(turningRequest(task), robot_->state(), clock_.now());
    perform(task, motion, [&] { task.result("Turned", std::round(motion.turned_deg() * 10) / 10, "deg"); });
}

template <class Motion>
void Application::perform(Task& task, Motion& motion, const std::function<void()>& report) {
    if (!gate_->take([&task] { return task.stopRequested(); })) {
        if (!task.stopRequested()) task.fail("another motion has the drive: stop it first");
        return;
    }
    // The drive is given back, and the robot halted, however this ends.
    const std::unique_ptr<DriveGate, void (*)(DriveGate*)> back(gate_.get(),
                                                                [](DriveGate* gate) { gate->giveBack(); });
    robot_->command(Command::Enable, 1);
    std::uint64_t seen = 0;
    bool resting = false;
    while (task.waitFor(seen == 0 ? Duration::zero() : kControlPeriod)) {
        const auto robot = robot_->state();
        if (task.paused() && robot.online) {
            if (!resting) gate_->drive(0, 0);
            resting = true;
            continue;
        }
        if (std::exchange(resting, false)) motion.resume(clock_.now());
        if (robot.online && robot.sequence == seen) continue;
        seen = robot.sequence;
        const auto step = motion.step(robot, clock_.now());
        report();
        task.progress(step.progress);
        if (step.outcome == MotionStep::Outcome::Running) {
            if (step.halt)
                gate_->halt();
            else
                gate_->drive(step.forward_mm_s, step.left_deg_s);
            continue;
        }
        if (step.outcome == MotionStep::Outcome::Failed) {
            // Before the verdict travels: the robot is told first.
            gate_->stop();
            if (robot.online)
                task.fail(step.reason);
            else
                task.robotLost(step.reason);
        } else {
            task.succeed();
        }
        return;
    }
}

void Application::onStop() {
    if (!gate_->stop()) return;  // lost: nothing to tell, and the robot's own watchdog stops it
    // One packet may have been on its way already, two that say "at rest" are about the time after the stop.
    standstill_after_ = robot_->state().sequence + 2;
}

void Application::onRobotOnline(const arcos::RobotIdentity& identity) {
    was_online_ = true;
    last_loss_.clear();
    // The odometry starts at zero again; the robot is taken to stand where it was last seen.
    origin_ = pose_;
    robot_->command(Command::SetA, 300);
    robot_->command(Command::SetA, -600);
    robot_->command(Command::SetRa, 100);
    robot_->command(Command::SetRa, -100);
    robot_->command(Command::SetV, static_cast<int>(Driving::kFastest_mm_s));
    robot_->command(Command::SetRv, static_cast<int>(Turning::kFastest_deg_s));
    setServicesActive(true, "");
    entity_.sendInfoMsg(fmt::format("connected to the robot {} ({})", identity.name, identity.subtype));
}

void Application::onRobotState(const RobotState& robot) {
    auto waiting = standstill_after_.load();
    if (waiting != 0 && robot.sequence >= waiting && !robot.moving &&
        standstill_after_.compare_exchange_strong(waiting, 0)) {
        entity_.standstill();
    }
    publish(robot);
}

void Application::publish(const RobotState& robot) {
    pose_ = origin_.then({robot.x_mm, robot.y_mm, robot.heading_deg});
    if (pose_stream_.wanted()) {
        Pose pose;
        pose.x = pose_.x_mm / 1000;
        pose.y = pose_.y_mm / 1000;
        pose.yaw = std::remainder(pose_.heading_deg, 360.0) * std::numbers::pi / 180;
        pose_stream_.send(pose);
    }
    if (sonar_stream_.wanted()) {
        Scan scan;
        scan.max_range = arcos::kNoEcho_mm / 1000.0;
        for (int i = 0; i < kSonarsInScan; ++i) {
            scan.ranges.push_back(static_cast<float>(robot.sonars[static_cast<std::size_t>(i)].range_mm) /
                                  1000);
            scan.angles.push_back(static_cast<float>(*sonarDirection_deg(i) * std::numbers::pi / 180));
        }
        sonar_stream_.send(scan);
    }
    if (robot.sequence % kPacketsPerSecond != 1) return;
    battery_stream_.send(robot.battery_v, "V");
    if (!told_position_ ||
        std::hypot(pose_.x_mm - told_position_->x_mm, pose_.y_mm - told_position_->y_mm) >= 1) {
        entity_.setPosition(pose_.x_mm, pose_.y_mm, 0);
        told_position_ = pose_;
    }
}

void Application::onRobotLost(const std::string& reason) {
    if (reason == last_loss_) return;  // each attempt to connect is reported; one line tells it
    last_loss_ = reason;
    standstill_after_ = 0;
    setServicesActive(false, "the robot is lost: " + reason);
    entity_.sendInfoMsg("the robot is lost: " + reason);
    fmt::print(stderr, "axon-peoplebot: {}{}\n", reason,
               was_online_ ? "" : "; trying again until it answers");
}

void Application::setServicesActive(bool active, const std::string& reason) {
    for (const auto* service : {kDriving, kTurning}) entity_.setServiceActive(service, active, reason);
}

}  // namespace axon::peoplebot
