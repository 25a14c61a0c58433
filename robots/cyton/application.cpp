// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/application.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "robots/common/robot_entity.hpp"
#include "robots/cyton/reach_demo.hpp"
#include "robots/ssc32/protocol.hpp"

namespace axon::cyton {
namespace {

constexpr auto kReachDemo = "Reach Demo";
constexpr auto kControl = "Control";
constexpr auto kGrabAndPlace = "Grab and Place";

constexpr Duration kPeriod = std::chrono::milliseconds{40};
// A little longer than the period: the next posture is there before the servos have come to rest.
constexpr Duration kReachWithin = std::chrono::milliseconds{50};
constexpr Duration kFirstHoming = std::chrono::seconds{5};

constexpr double kDemoSpeed_deg_s = 60;  // the profile's, for a link that does not fill in defaults
constexpr double kControlSpeed_deg_s = 30;
constexpr double kTolerance_deg = 0.01;

/// The part of its highest rate at which the fastest joint turns that fast.
double speedPart(double speed_deg_s) {
    return std::clamp(speed_deg_s / degrees(fastest_rad_s(kChain[0])), 0.001, 1.0);
}

std::vector<Value> anglesOf(const Posture& posture) {
    std::vector<Value> angles;
    for (const double angle : posture.joints) angles.emplace_back(std::round(degrees(angle) * 10) / 10);
    return angles;
}

double pickAndPlaceSpeed(const Task& task) {
    return std::clamp(task.number("Speed", PickAndPlaceRequest{}.speed * 100) / 100, 0.01, 1.0);
}

PickAndPlaceRequest pickAndPlaceRequest(const Task& task) {
    PickAndPlaceRequest request;
    const auto place = [&task](const char* what, const Point& usual) {
        Point at;
        for (std::size_t i = 0; i < 3; ++i)
            at[i] = task.number(fmt::format("{} {}", what, "XYZ"[i]), usual[i] * 1000) / 1000;
        return at;
    };
    request.pick = place("Pick", request.pick);
    request.place = place("Place", request.place);
    if (task.has("Pick Yaw")) request.pick_yaw = radians(task.number("Pick Yaw"));
    if (task.has("Place Yaw")) request.place_yaw = radians(task.number("Place Yaw"));
    request.width = task.number("Object Width", request.width * 1000) / 1000;
    request.height = task.number("Object Height", request.height * 1000) / 1000;
    request.speed = pickAndPlaceSpeed(task);
    return request;
}

std::string controlObjection(const Task& task) {
    bool any = task.has("Gripper");
    for (const auto& joint : kChain) {
        if (!task.has(joint.name)) continue;
        any = true;
        const double angle = task.number(joint.name);
        if (angle < degrees(joint.minimum) - kTolerance_deg ||
            angle > degrees(joint.maximum) + kTolerance_deg)
            return fmt::format("{} turns from {:.1f} to {:.1f} deg, not to {:.1f}", joint.name,
                               degrees(joint.minimum), degrees(joint.maximum), angle);
    }
    return any ? std::string{} : "give the angle of at least one joint, or the opening of the gripper";
}

}  // namespace

Application::Application(const Settings& settings, std::shared_ptr<const Clock> clock)
    : clock_(std::move(clock)),
      entity_(robots::interfacerOptions(settings, clock_)),
      joints_stream_(entity_.stream("joints")),
      gripper_stream_(entity_.stream("gripper")) {
    renamed_profile_ = robots::uploadProfiles(entity_, settings);
    entity_.setPosition(settings.at_mm[0], settings.at_mm[1], settings.at_mm[2]);
    setServicesActive(false, "the arm is not connected yet");

    // The guard ends the arm's move if this process cannot.
    auto open = robots::robotLink(settings, withSpeed(settings.arm), std::string(1, ssc32::kEscape));
    gate_ = std::make_unique<ServoGate>([this](const std::string& lines) { return arm_->send(lines); });
    offerServices();
    std::vector<std::size_t> channels(kChannels);
    std::iota(channels.begin(), channels.end(), std::size_t{0});
    // Two steps: its callbacks use arm_.
    arm_ = std::make_unique<ssc32::Ssc32Client>(
        std::move(open), std::move(channels),
        ssc32::Ssc32Client::Callbacks{
            .on_online = [this](const std::vector<int>& pulses) { onOnline(pulses); },
            .on_pulses = [this](const std::vector<int>& pulses) { gate_->told(pulses, clock_->now()); },
            .on_status = [this](bool moving) { onStatus(moving); },
            .on_lost = [this](const std::string& reason) { onLost(reason); },
        },
        settings.silence_limit, clock_);
    arm_->start();
}

Application::~Application() {
    // Freezes the arm, and ends the handlers, which use it, before it goes.
    entity_.shutdown();
    arm_.reset();
}

void Application::start() {
    entity_.start();
}
void Application::run() {
    entity_.run();
}

void Application::offerServices() {
    entity_.onTask(kReachDemo, [this](Task& task) { reachDemo(task); });
    entity_.onTask(kControl, [this](Task& task) { control(task); });
    entity_.onTask(kGrabAndPlace, [this](Task& task) { grabAndPlace(task); });
    entity_.onTaskRequest([this](const Task& task) { return consider(task); });
    entity_.onStop([this](const StopSignal& /*signal*/) { onStop(); });
}

Decision Application::consider(const Task& task) const {
    if (!arm_->online())
        return Decision::robotLost(
            "the arm's controller is not connected: is it switched on, is its address right?");
    try {
        std::string why;
        if (task.service() == kControl) why = controlObjection(task);
        if (task.service() == kGrabAndPlace) why = objection(pickAndPlaceRequest(task));
        if (task.service() != kControl && may_hold_)
            why =
                "the claws may still hold the object of a task that did not reach its end: bring it down "
                "with "
                "Control, and open them with its Gripper";
        return why.empty() ? Decision::grant() : Decision::deny(why);
    } catch (const std::invalid_argument& error) {
        return Decision::deny(error.what());
    }
}

void Application::reachDemo(Task& task) {
    const auto speedNow = [&task] { return speedPart(task.number("Speed", kDemoSpeed_deg_s)); };
    const double speed = speedNow();
    const auto plan = [speed](const Posture& from) { return cyton::reachDemo(from, speed); };
    const auto tell = [&](std::size_t /*leg*/, const std::string& name) {
        task.feedback(name);
        task.result("Joint", name);
    };
    if (perform(task, plan, tell, [&] { return speedNow() / speed; })) task.succeed();
}

void Application::control(Task& task) {
    const auto speedNow = [&task] { return speedPart(task.number("Speed", kControlSpeed_deg_s)); };
    const double speed = speedNow();
    Posture target;
    const auto plan = [&](const Posture& from) {
        target = from;
        for (std::size_t i = 0; i < kJoints; ++i) {
            if (task.has(kChain[i].name))
                target.joints[i] =
                    std::clamp(radians(task.number(kChain[i].name)), kChain[i].minimum, kChain[i].maximum);
        }
        target.opening_mm =
            std::clamp(task.number("Gripper", from.opening_mm), gripper::kClosed_mm, gripper::kOpen_mm);
        return std::vector<Leg>{{"moving", Trajectory({from, target}, speed), 0.2}};
    };
    const bool done = perform(
        task, plan, [](std::size_t, const std::string&) {}, [&] { return speedNow() / speed; });
    if (const auto present = gate_->present(clock_->now())) task.result("Joints", anglesOf(*present), "deg");
    if (!done) return;
    if (task.has("Gripper")) may_hold_ = false;
    task.succeed();
}

void Application::grabAndPlace(Task& task) {
    const auto request = pickAndPlaceRequest(task);
    std::size_t grasped = 0;
    std::size_t released = 0;
    const auto where = [](const Point& at) {
        return fmt::format("({:.0f}, {:.0f}, {:.0f}) mm", at[0] * 1000, at[1] * 1000, at[2] * 1000);
    };
    const auto plan = [&](const Posture& from) {
        task.feedback("planning");
        Kinematics kinematics;
        auto planned = planPickAndPlace(kinematics, request, from, [&task] { return task.stopRequested(); });
        if (!planned) {
            if (!task.stopRequested()) task.fail(planned.refusal().message);
            return std::vector<Leg>{};
        }
        grasped = planned->grasped;
        released = planned->released;
        task.result("Tilt", std::round(degrees(planned->tilt)), "deg");
        task.result("Grip Height", std::round(planned->grip_height * 1000), "mm");
        return std::move(planned->legs);
    };
    task.result("Done", "nothing was touched");
    const auto tell = [&](std::size_t leg, const std::string& name) {
        task.feedback(name);
        task.result("Step", name);
        if (leg + 1 == grasped) task.result("Done", "the claws closed at " + where(request.pick));
        if (leg + 1 == grasped) may_hold_ = true;
        if (leg == released) may_hold_ = false;
        if (leg == grasped) task.result("Done", "gripped at " + where(request.pick) + ", not put down");
        if (leg == released)
            task.result("Done",
                        fmt::format("picked at {}, placed at {}", where(request.pick), where(request.place)));
    };
    const auto pace = [&] { return pickAndPlaceSpeed(task) / request.speed; };
    if (perform(task, plan, tell, pace)) task.succeed();
}

bool Application::perform(Task& task, const Planning& plan, const OnLeg& on_leg, const Pace& pace) {
    if (!gate_->take([&task] { return task.stopRequested(); })) {
        if (!task.stopRequested()) task.fail("another motion has the arm: stop it first");
        return false;
    }
    // The arm is given back, and stands, however this ends.
    const auto give_back = [this](ServoGate* gate) { gate->giveBack(clock_->now()); };
    const std::unique_ptr<ServoGate, decltype(give_back)> back(gate_.get(), give_back);
    const auto from = findOut(task);
    if (!from) return false;
    auto legs = plan(*from);
    return !legs.empty() && play(task, std::move(legs), on_leg, pace);
}

std::optional<Posture> Application::findOut(Task& task) {
    if (auto present = gate_->present(clock_->now())) return present;
    task.feedback("going home slowly: since the controller was switched on nobody knows where the arm is");
    Posture home;
    home.joints = kHome;
    if (!gate_->command(home, kFirstHoming, clock_->now())) {
        tellLoss(task);
        return std::nullopt;
    }
    while (task.waitFor(kPeriod)) {
        if (auto present = gate_->present(clock_->now())) return present;
        if (!arm_->online()) {
            tellLoss(task);
            return std::nullopt;
        }
    }
    return std::nullopt;
}

bool Application::play(Task& task, std::vector<Leg> legs, const OnLeg& on_leg, const Pace& pace) {
    Playback playback(std::move(legs));
    auto last = clock_->now();
    std::optional<std::size_t> leg;
    for (int i = 0; task.waitFor(kPeriod); ++i) {
        const auto now = clock_->now();
        // A machine that stands still for a while makes the motion longer, never faster.
        const auto passed = std::min<Duration>(now - last, kReachWithin);
        last = now;
        const auto step =
            playback.advance(std::chrono::duration<double>(passed).count(), task.paused(), pace());
        if (leg != step.leg) on_leg(step.leg, playback.legs()[step.leg].name);
        leg = step.leg;
        const bool told = step.resting ? arm_->online() : gate_->command(step.posture, kReachWithin, now);
        if (!told) {
            if (!task.stopRequested()) tellLoss(task);
            return false;
        }
        if (step.done) return true;
        if (i % 5 != 0) continue;
        task.result("Angles", anglesOf(step.posture), "deg");
        task.progress(step.progress);
    }
    return false;
}

void Application::tellLoss(Task& task) {
    if (task.stopRequested()) return;
    task.robotLost("the arm's controller no longer answers: the arm stands where it was last told to be");
}

void Application::onStop() {
    const bool told = gate_->stop(clock_->now());
    // Frozen on a way that began nobody knows where: only the controller can tell where that was.
    if (!gate_->present(clock_->now())) arm_->askPulses();
    if (!told) return;  // lost: nothing to tell, and its last move ends within kReachWithin
    // One status may have been on its way already, the second is about the time after the stop.
    standstill_after_ = statuses_ + 2;
}

void Application::onOnline(const std::vector<int>& pulses_us) {
    was_online_ = true;
    last_loss_.clear();
    gate_->told(pulses_us, clock_->now());
    setServicesActive(true, "");
    entity_.sendInfoMsg(
        gate_->present(clock_->now())
            ? "connected to the arm's controller"
            : "connected to the arm's controller, which was just switched on: the first task goes "
              "home slowly first");
}

void Application::onStatus(bool moving) {
    const auto status = ++statuses_;
    auto waiting = standstill_after_.load();
    if (waiting != 0 && status >= waiting && !moving && standstill_after_.compare_exchange_strong(waiting, 0))
        entity_.standstill();
    const auto present = gate_->present(clock_->now());
    if (!present) return;
    if (joints_stream_.wanted()) {
        std::vector<double> angles(kJoints);
        std::transform(present->joints.begin(), present->joints.end(), angles.begin(), degrees);
        joints_stream_.send(angles, "deg");
    }
    if (gripper_stream_.wanted()) gripper_stream_.send(present->opening_mm, "mm");
}

void Application::onLost(const std::string& reason) {
    gate_->lost();
    if (reason == last_loss_) return;  // each attempt to connect is reported; one line tells it
    last_loss_ = reason;
    standstill_after_ = 0;
    setServicesActive(false, "the arm is lost: " + reason);
    entity_.sendInfoMsg("the arm is lost: " + reason);
    fmt::print(stderr, "axon-cyton: {}{}\n", reason, was_online_ ? "" : "; trying again until it answers");
}

void Application::setServicesActive(bool active, const std::string& reason) {
    for (const auto* service : {kReachDemo, kControl, kGrabAndPlace})
        entity_.setServiceActive(service, active, reason);
}

}  // namespace axon::cyton
