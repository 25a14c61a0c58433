// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/application.hpp"

#include <fmt/format.h>

#include <cmath>
#include <random>

#include "robots/common/robot_entity.hpp"
#include "robots/peoplebot/home.hpp"
#include "robots/peoplebot/navigation.hpp"
#include "robots/peoplebot/table_approach.hpp"

namespace axon::peoplebot {
namespace {

using arcos::Command;
using arcos::RobotState;

constexpr auto kDriving = "Driving";
constexpr auto kTurning = "Turning";
constexpr auto kWander = "Wander";
constexpr auto kNavigation = "Navigation";
constexpr auto kTableApproach = "Approach Table";
constexpr auto kMap = "Map";
constexpr Duration kControlPeriod =
    std::chrono::milliseconds{10};  // ten looks at each of the robot's packets
constexpr int kSonarsInScan = 24;
constexpr std::uint64_t kPacketsPerSecond = 10;
constexpr double kLaserReach_m = 32;
constexpr Duration kFreshScan = std::chrono::seconds{1};
constexpr std::size_t kParticlesShown = 100;
constexpr double kDegree = std::numbers::pi / 180;

constexpr double kVelocity_mm_s = 200;  // the profile's, for a link that does not fill in defaults
constexpr double kRangeThreshold_mm = 500;
constexpr double kVelocity_deg_s = 30;

Driving::Request drivingRequest(const Task& task) {
    return {.distance_mm = task.number("Distance"),
            .velocity_mm_s = task.number("Velocity", kVelocity_mm_s),
            .range_threshold_mm = task.number("Range Threshold", kRangeThreshold_mm),
            .speed_limit_mm_s = task.number("Speed Limit", Driving::kFastest_mm_s)};
}

Turning::Request turningRequest(const Task& task) {
    return {.angle_deg = task.number("Angle"),
            .velocity_deg_s = task.number("Velocity", kVelocity_deg_s),
            .speed_limit_deg_s = task.number("Speed Limit", Turning::kFastest_deg_s)};
}

Wander::Request wanderRequest(const Task& task) {
    Wander::Request request;
    request.velocity_mm_s = task.number("Velocity", request.velocity_mm_s);
    request.duration_s = task.number("Duration", 0);
    request.seed = std::random_device()();
    return request;
}

Navigation::Request navigationRequest(const Task& task) {
    Navigation::Request request;
    request.destination = task.text("Destination");
    request.velocity_mm_s = task.number("Velocity", request.velocity_mm_s);
    request.tolerance_mm = task.number("Tolerance", request.tolerance_mm);
    return request;
}

TableApproach::Request tableApproachRequest(const Task& task) {
    TableApproach::Request request;
    request.distance_mm = task.number("Distance", request.distance_mm);
    request.velocity_mm_s = task.number("Velocity", request.velocity_mm_s);
    request.reach_mm = task.number("Reach", request.reach_mm);
    request.range_threshold_mm = task.number("Range Threshold", request.range_threshold_mm);
    return request;
}

void tellSpeed(Task& task, const RobotState& robot) {
    task.result("Speed", std::round(robot.speed_mm_s()), "mm/s");
}

Pose toPose(const MapPose& place, const std::string& frame) {
    Pose pose;
    pose.x = place.x_mm / 1000;
    pose.y = place.y_mm / 1000;
    pose.yaw = std::remainder(place.heading_deg, 360.0) * kDegree;
    pose.frame = frame;
    return pose;
}

/// What the guard writes if this process cannot.
std::string stopOrders() {
    std::string stop;
    for (const auto& command :
         {arcos::encodeCommand(Command::EStop),
          arcos::encodeCommand(Command::Gripper, static_cast<int>(arcos::GripperOrder::Halt))})
        stop.append(command.begin(), command.end());
    return stop;
}

}  // namespace

Application::Application(const Settings& settings, std::shared_ptr<const Clock> clock)
    : clock_(std::move(clock)),
      entity_(robots::interfacerOptions(settings, clock_)),
      pose_stream_(entity_.stream("pose")),
      sonar_stream_(entity_.stream("sonar")),
      battery_stream_(entity_.stream("battery")),
      laser_stream_(entity_.stream("laser")),
      localisation_stream_(entity_.stream("localisation")),
      quality_stream_(entity_.stream("localisation quality")),
      particles_stream_(entity_.stream("particles")),
      start_given_(settings.at_given),
      wander_rules_(loadWanderRules(rulesFile(settings, "wander.rules"))),
      navigation_rules_(loadNavigationRules(rulesFile(settings, "navigation.rules"))),
      origin_(settings.at),
      pose_(settings.at) {
    renamed_profile_ = robots::uploadProfiles(entity_, settings);
    entity_.setPosition(settings.at.x_mm, settings.at.y_mm, 0);

    auto open = robots::robotLink(settings, settings.robot, stopOrders());
    gate_ = std::make_unique<DriveGate>(DriveGate::Robot{
        .drive = [this](double forward, double left) { return robot_->drive(forward, left); },
        .stop = [this] { return robot_->stop(); },
    });
    grasp_ = std::make_unique<GraspServices>(
        GraspServices::Parts{entity_, clock_, *gate_, [this]() -> arcos::ArcosClient& { return *robot_; }},
        settings.camera);
    offerServices();
    setServicesActive(false, "the robot is not connected yet");
    // Two steps: its callbacks use robot_.
    robot_ = std::make_unique<arcos::ArcosClient>(
        std::move(open),
        arcos::ArcosClient::Callbacks{
            .on_online = [this](const arcos::RobotIdentity& identity) { onRobotOnline(identity); },
            .on_state = [this](const RobotState& robot) { onRobotState(robot); },
            .on_lost = [this](const std::string& reason) { onRobotLost(reason); },
        },
        settings.robot_silence_limit, clock_);
    if (!settings.laser.empty()) {
        laser_ = std::make_unique<lms2xx::Lms2xxClient>(
            robots::robotStreams(settings.laser),
            lms2xx::Lms2xxClient::Callbacks{
                .on_online = [this](const lms2xx::Setting& setting) { onLaserOnline(setting); },
                .on_scan = [this](const lms2xx::Scan& scan) { onLaserScan(scan); },
                .on_lost = [this](const std::string& reason) { onLaserLost(reason); },
            },
            lms2xx::ClientSession::kSilenceLimit, clock_);
        laser_->start();
    }
    robot_->start();
}

Application::~Application() {
    // Stops the robot, and ends the handlers, which use it, before it goes.
    entity_.shutdown();
    // Before it goes: callbacks that are under way use it.
    robot_->finish();
    laser_.reset();
    robot_.reset();
}

void Application::start() {
    entity_.start();
}
void Application::run() {
    entity_.run();
}

void Application::offer(const std::string& service, Objection objection, Handler handler) {
    services_[service] = std::move(objection);
    entity_.onTask(service, std::move(handler));
}

void Application::offerServices() {
    offerDriving();
    offerTurning();
    offerWander();
    offerNavigation();
    offerTableApproach();
    grasp_->offer([this](const std::string& service, Objection objection, Handler handler) {
        offer(service, std::move(objection), std::move(handler));
    });
    entity_.onTaskRequest([this](const Task& task) { return consider(task); });
    entity_.onStop([this](const StopSignal& /*signal*/) { onStop(); });
}

Decision Application::consider(const Task& task) const {
    if (!robot_->state().online)
        return Decision::robotLost("the robot is not connected: is it switched on, is its address right?");
    const auto service = services_.find(task.service());
    if (service == services_.end()) return Decision::grant();
    try {
        const auto objection = service->second(task);
        return objection.empty() ? Decision::grant() : Decision::deny(objection);
    } catch (const std::exception& error) {  // a parameter that is missing, a map that cannot be read
        return Decision::deny(error.what());
    }
}

void Application::offerDriving() {
    offer(
        kDriving, [](const Task& task) { return Driving::objection(drivingRequest(task)); },
        [this](Task& task) {
            Driving motion(drivingRequest(task), robot_->state(), clock_->now());
            perform(
                task, motion, [&] { motion.limitSpeed(drivingRequest(task).speed_limit_mm_s); },
                [&](const RobotState& robot) {
                    task.result("Travelled", std::round(motion.travelled_mm()), "mm");
                    task.result("Remaining", std::round(motion.remaining_mm()), "mm");
                    tellSpeed(task, robot);
                });
        });
}

void Application::offerTurning() {
    offer(
        kTurning, [](const Task& task) { return Turning::objection(turningRequest(task)); },
        [this](Task& task) {
            Turning motion(turningRequest(task), robot_->state(), clock_->now());
            perform(
                task, motion, [&] { motion.limitSpeed(turningRequest(task).speed_limit_deg_s); },
                [&](const RobotState& /*robot*/) {
                    task.result("Turned", std::round(motion.turned_deg() * 10) / 10, "deg");
                    task.result("Remaining", std::round(motion.remaining_deg() * 10) / 10, "deg");
                });
        });
}

void Application::offerWander() {
    offer(
        kWander, [](const Task& task) { return Wander::objection(wanderRequest(task)); },
        [this](Task& task) {
            Wander motion(wanderRequest(task), wander_rules_, robot_->state(), clock_->now());
            perform(
                task, motion,
                [&] { motion.setVelocity(task.number("Velocity", Wander::Request{}.velocity_mm_s)); },
                [&](const RobotState& robot) {
                    task.result("Travelled", std::round(motion.travelled_mm()), "mm");
                    task.result("Recoveries", static_cast<std::int64_t>(motion.recoveries()));
                    tellSpeed(task, robot);
                });
        });
}

void Application::offerTableApproach() {
    offer(
        kTableApproach, [](const Task& task) { return TableApproach::objection(tableApproachRequest(task)); },
        [this](Task& task) {
            TableApproach motion(tableApproachRequest(task), robot_->state(), clock_->now());
            perform(
                task, motion,
                [&] {
                    const auto set = tableApproachRequest(task);
                    motion.reconfigure(set.velocity_mm_s, set.range_threshold_mm);
                },
                [&](const RobotState& robot) {
                    task.result("Travelled", std::round(motion.travelled_mm()), "mm");
                    tellSpeed(task, robot);
                });
        });
}

void Application::offerNavigation() {
    offer(
        kNavigation,
        [this](const Task& task) {
            const auto plan = planOf(task.resource(kMap));
            const auto objection = Navigation::objection(navigationRequest(task), *plan);
            if (objection.empty()) startOn(plan, task);
            return objection;
        },
        [this](Task& task) { navigate(task); });
    entity_.onResource(
        [this](const std::string& service, const std::string& resource, const std::filesystem::path& file) {
            if (service != kNavigation || resource != kMap) return Decision::grant();
            try {
                planOf(file);
                return Decision::grant();
            } catch (const std::exception& error) {
                return Decision::deny(error.what());
            }
        });
}

std::shared_ptr<const FloorPlan> Application::planOf(const std::filesystem::path& file) const {
    if (file.empty())
        throw std::invalid_argument(
            "Navigation needs a map: upload one made with Mapper3 as the resource Map");
    std::error_code error;
    const auto written = std::filesystem::last_write_time(file, error);
    const std::lock_guard lock(read_map_mutex_);
    if (!read_map_.plan || read_map_.file != file || read_map_.written != written)
        read_map_ = {file, written,
                     std::make_shared<const FloorPlan>(mapper3::parseMap(robots::contentOf(file), "map"))};
    return read_map_.plan;
}

std::optional<Localisation::Start> Application::startOn(const std::shared_ptr<const FloorPlan>& plan,
                                                        const Task& task) const {
    const auto told = task.text("Start", "");
    if (!told.empty()) {
        const auto at = parsePose(told, "Start");
        if (!plan->contains({at.x_mm, at.y_mm}))
            throw std::invalid_argument(fmt::format("Start {} is not on the map", told));
        return Localisation::Start{.pose = at};
    }
    const std::lock_guard lock(place_mutex_);
    if (localisation_ && localisation_->plan() == plan) return std::nullopt;
    // On another map, or for the first time: the pose is the odometry's, which drifts, above all in turns.
    if (localisation_ || start_given_) {
        if (!plan->contains({pose_.x_mm, pose_.y_mm}))
            throw std::invalid_argument(
                fmt::format("the robot, at ({:.0f}, {:.0f}) mm as far as it knows, is not on this map: say "
                            "where it is with Start",
                            pose_.x_mm, pose_.y_mm));
        return Localisation::Start{.pose = pose_, .spread_mm = 350, .spread_deg = 15};
    }
    const auto scan = robot_->state().laser;
    if (!scan || clock_->now() - scan->taken > kFreshScan) {
        throw std::invalid_argument(
            "nobody has said where the robot is, and its laser sends no readings to find it by; fix: switch "
            "the laser on, or give Start "
            "(X,Y,HEADING in mm, mm, degrees)");
    }
    return startFromHome(*plan, origin_.then({scan->x_mm, scan->y_mm, scan->heading_deg}), *scan);
}

void Application::navigate(Task& task) {
    const auto plan = planOf(task.resource(kMap));
    if (const auto start = startOn(plan, task)) {
        auto fresh = std::make_unique<Localisation>(plan, *start, robot_->state(), std::random_device()());
        const std::lock_guard lock(place_mutex_);
        localisation_ = std::move(fresh);
        odometry_began_anew_ = false;
    }
    const auto here = [this] {
        const std::lock_guard lock(place_mutex_);
        return localisation_->estimate();
    };
    Navigation motion(navigationRequest(task), plan, navigation_rules_, here, clock_->now());
    perform(
        task, motion,
        [&] {
            const auto set = navigationRequest(task);
            motion.reconfigure(set.velocity_mm_s, set.tolerance_mm);
        },
        [&](const RobotState& robot) {
            if (const auto news = motion.takeNews(); !news.empty()) task.feedback(news);
            const auto& pose = motion.estimate().pose;
            task.result("X", std::round(pose.x_mm), "mm");
            task.result("Y", std::round(pose.y_mm), "mm");
            task.result("Heading", std::round(pose.heading_deg * 10) / 10, "deg");
            task.result("Distance", std::round(motion.distanceToGoal_mm()), "mm");
            if (const auto remaining = motion.remaining_mm())
                task.result("Remaining", std::round(*remaining), "mm");
            tellSpeed(task, robot);
        });
}

template <class Motion>
void Application::perform(Task& task, Motion& motion, const std::function<void()>& configure,
                          const std::function<void(const RobotState&)>& report) {
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
        if (std::exchange(resting, false)) motion.resume(clock_->now());
        if (robot.online && robot.sequence == seen) continue;
        seen = robot.sequence;
        configure();
        const auto step = motion.step(robot, clock_->now());
        report(robot);
        task.progress(step.progress);
        if (step.outcome == MotionStep::Outcome::Running) {
            if (step.halt)
                gate_->halt();
            else
                gate_->drive(step.forward_mm_s, step.left_deg_s);
            continue;
        }
        if (step.outcome == MotionStep::Outcome::Done)
            task.succeed();
        else if (robot.online)
            task.fail(step.reason);
        else
            task.robotLost(step.reason);
        return;
    }
}

void Application::onStop() {
    const bool told = gate_->stop();
    grasp_->onStop();
    if (!told) return;  // lost: nothing to tell, and the robot's own watchdog stops it
    // One packet may have been on its way already, two that say "at rest" are about the time after the stop.
    standstill_after_ = robot_->state().sequence + 2;
}

void Application::onRobotOnline(const arcos::RobotIdentity& identity) {
    was_online_ = true;
    last_loss_.clear();
    last_scan_sent_ = 0;
    {
        // The odometry starts at zero again; the robot is taken to stand where it was last seen.
        const std::lock_guard lock(place_mutex_);
        origin_ = pose_;
        odometry_began_anew_ = true;
    }
    robot_->command(Command::SetA, kAcceleration_mm_s2);
    robot_->command(Command::SetA, -kDeceleration_mm_s2);
    robot_->command(Command::SetRa, kTurnAcceleration_deg_s2);
    robot_->command(Command::SetRa, -kTurnAcceleration_deg_s2);
    robot_->command(Command::SetV, static_cast<int>(Driving::kFastest_mm_s));
    robot_->command(Command::SetRv, static_cast<int>(Turning::kFastest_deg_s));
    setServicesActive(true, "");
    watchdog_told_ = false;
    const int baud = robot_->state().baud;
    tell(fmt::format("connected to the robot {} ({}){}", identity.name, identity.subtype,
                     baud != 0 ? fmt::format(" at {} baud", baud) : ""));
}

void Application::onRobotState(const RobotState& robot) {
    auto waiting = standstill_after_.load();
    if (waiting != 0 && robot.sequence >= waiting && !robot.moving &&
        standstill_after_.compare_exchange_strong(waiting, 0)) {
        entity_.standstill();
    }
    if (robot.config && !std::exchange(watchdog_told_, true)) tellWatchdog(*robot.config);
    locate(robot);
    publish(robot);
    grasp_->onRobotState(robot);
}

void Application::tell(const std::string& text) {
    entity_.sendInfoMsg(text);
    fmt::print(stderr, "axon-peoplebot: {}\n", text);
}

void Application::tellWatchdog(const arcos::RobotConfig& config) {
    if (config.watchdog_ms == 0) {
        tell(
            "the robot has no watchdog: when its line is cut, or this program and its guard die together, it "
            "drives on. Fix: set its parameter watchdog in its FLASH");
    } else {
        // No command changes it: it lies in the robot's FLASH.
        tell(fmt::format("the robot's own watchdog stops it {} ms after it last heard this program",
                         config.watchdog_ms));
    }
}

void Application::onLaserOnline(const lms2xx::Setting& setting) {
    last_laser_loss_.clear();
    pollution_told_ = false;
    tell(fmt::format("connected to the laser{}: {} degrees, {}",
                     setting.baud != 0 ? fmt::format(" at {} baud", setting.baud) : "",
                     setting.variant.angle_deg,
                     setting.measuring.millimetres ? "millimetres" : "centimetres"));
}

void Application::onLaserScan(const lms2xx::Scan& scan) {
    if (scan.polluted && !std::exchange(pollution_told_, true))
        tell("the laser's front screen is dirty: clean it");
    robot_->newScan({.taken = scan.taken,
                     .start_deg = scan.start_deg,
                     .step_deg = scan.step_deg,
                     .ranges_mm = scan.ranges_mm});
}

void Application::onLaserLost(const std::string& reason) {
    if (reason == last_laser_loss_) return;  // each attempt to connect is reported; one line tells it
    last_laser_loss_ = reason;
    tell("the laser is lost: " + reason);
}

void Application::locate(const RobotState& robot) {
    const MapPose odometry{robot.x_mm, robot.y_mm, robot.heading_deg};
    const std::lock_guard lock(place_mutex_);
    if (!localisation_) {
        pose_ = origin_.then(odometry);
        return;
    }
    if (std::exchange(odometry_began_anew_, false)) {
        // Somebody may have pushed it meanwhile.
        localisation_ = std::make_unique<Localisation>(
            localisation_->plan(), Localisation::Start{.pose = pose_, .spread_mm = 300, .spread_deg = 10},
            robot, std::random_device()());
    }
    localisation_->update(robot);
    const auto estimate = localisation_->estimate();
    pose_ = estimate.pose;
    if (localisation_stream_.wanted()) localisation_stream_.send(toPose(estimate.pose, "map"));
    if (robot.sequence % 2 != 0) return;
    if (quality_stream_.wanted())
        quality_stream_.send(
            std::vector{estimate.spread_mm / 1000, estimate.spread_deg * kDegree, estimate.fit});
    if (particles_stream_.wanted()) {
        std::vector<double> flat;
        for (const auto& particle : localisation_->particles(kParticlesShown))
            flat.insert(flat.end(), {particle.x_mm / 1000, particle.y_mm / 1000,
                                     std::remainder(particle.heading_deg, 360.0) * kDegree});
        particles_stream_.send(flat);
    }
}

void Application::publish(const RobotState& robot) {
    const auto here = [this] {
        const std::lock_guard lock(place_mutex_);
        return pose_;
    }();
    if (pose_stream_.wanted()) pose_stream_.send(toPose(here, ""));
    if (robot.laser && robot.laser->sequence != last_scan_sent_ && laser_stream_.wanted()) {
        const auto& laser = *robot.laser;
        last_scan_sent_ = laser.sequence;
        Scan scan;
        scan.start_angle = laser.start_deg * kDegree;
        scan.step = laser.step_deg * kDegree;
        scan.max_range = kLaserReach_m;
        for (const auto range_mm : laser.ranges_mm)
            scan.ranges.push_back(
                std::min(static_cast<float>(range_mm) / 1000, static_cast<float>(kLaserReach_m)));
        laser_stream_.send(scan);
    }
    if (sonar_stream_.wanted()) {
        Scan scan;
        scan.max_range = arcos::kNoEcho_mm / 1000.0;
        for (int i = 0; i < kSonarsInScan; ++i) {
            scan.ranges.push_back(static_cast<float>(robot.sonars[static_cast<std::size_t>(i)].range_mm) /
                                  1000);
            scan.angles.push_back(static_cast<float>(*sonarDirection_deg(i) * kDegree));
        }
        sonar_stream_.send(scan);
    }
    if (robot.sequence % kPacketsPerSecond != 1) return;
    battery_stream_.send(robot.battery_v, "V");
    if (!told_position_ ||
        std::hypot(here.x_mm - told_position_->x_mm, here.y_mm - told_position_->y_mm) >= 1) {
        entity_.setPosition(here.x_mm, here.y_mm, 0);
        told_position_ = here;
    }
}

void Application::onRobotLost(const std::string& reason) {
    gate_->lost();
    if (reason == last_loss_) return;  // each attempt to connect is reported; one line tells it
    last_loss_ = reason;
    standstill_after_ = 0;
    setServicesActive(false, "the robot is lost: " + reason);
    entity_.sendInfoMsg("the robot is lost: " + reason);
    fmt::print(stderr, "axon-peoplebot: {}{}\n", reason,
               was_online_ ? "" : "; trying again until it answers");
}

void Application::setServicesActive(bool active, const std::string& reason) {
    for (const auto& [service, objection] : services_) entity_.setServiceActive(service, active, reason);
}

}  // namespace axon::peoplebot
