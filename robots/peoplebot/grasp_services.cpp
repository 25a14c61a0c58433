// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/grasp_services.hpp"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

namespace axon::peoplebot {
namespace {

using arcos::Command;
using arcos::GripperOrder;
using arcos::RobotState;
using Outcome = MotionStep::Outcome;
namespace vcc4 = arcos::vcc4;

constexpr auto kGripper = "Operate Gripper";
constexpr auto kTracking = "Table Object Tracking and Grabbing";
constexpr Duration kControlPeriod = std::chrono::milliseconds{10};
constexpr Duration kThumbnailPeriod = std::chrono::milliseconds{200};
constexpr int kThumbnailWidth = 160;
constexpr int kThumbnailHeight = 120;

GripperOperation::Request gripperRequest(const Task& task) {
    const auto word = task.text("Direction", "none");
    const auto direction = GripperOperation::parseDirection(word);
    if (!direction)
        throw std::invalid_argument(fmt::format("Direction is \"{}\": give up, down or none", word));
    GripperOperation::Request request{.direction = *direction};
    if (task.has("Open/Close")) request.open = task.flag("Open/Close");
    return request;
}

Tracking::Request trackingRequest(const Task& task) {
    const auto word = task.text("Color");
    const auto colour = parseColour(word);
    if (!colour) throw std::invalid_argument(fmt::format("Color is \"{}\": give {}", word, knownColours()));
    Tracking::Request request{.colour = *colour};
    request.table_height_mm = task.number("Table Height", request.table_height_mm);
    request.back_off_mm = task.number("Back Off", request.back_off_mm);
    request.velocity_mm_s = task.number("Velocity", request.velocity_mm_s);
    request.range_threshold_mm = task.number("Range Threshold", request.range_threshold_mm);
    return request;
}

/// Runs what undoes something at the end of its scope.
class Finally {
  public:
    explicit Finally(std::function<void()> undo) : undo_(std::move(undo)) {}
    ~Finally() { undo_(); }
    Finally(const Finally&) = delete;
    Finally& operator=(const Finally&) = delete;

  private:
    std::function<void()> undo_;
};

}  // namespace

GraspServices::GraspServices(Parts parts, const std::string& camera)
    : parts_(std::move(parts)),
      thumbnails_(parts_.entity.stream("camera")),
      gripper_([this] { parts_.robot().gripper(GripperOrder::Halt); }),
      head_([this] { parts_.robot().command(Command::Tty2, vcc4::stop()); }) {
    if (camera.empty()) return;
    camera_ =
        std::make_unique<CameraClient>(camera,
                                       CameraClient::Callbacks{
                                           .on_picture =
                                               [this](const std::shared_ptr<const CameraPicture>& picture) {
                                                   camera_trouble_.clear();
                                                   sendThumbnail(*picture);
                                               },
                                           .on_lost =
                                               [this](const std::string& reason) {
                                                   if (std::exchange(camera_trouble_, reason) == reason)
                                                       return;  // told once
                                                   parts_.entity.sendInfoMsg("no camera: " + reason);
                                               },
                                       },
                                       false, parts_.clock);
}

void GraspServices::offer(const std::function<void(const std::string&, Objection, Handler)>& offer) {
    offer(
        kGripper,
        [this](const Task& task) {
            return GripperOperation::objection(gripperRequest(task), parts_.robot().state());
        },
        [this](Task& task) { operate(task); });
    offer(
        kTracking,
        [this](const Task& task) -> std::string {
            auto objection = Tracking::objection(trackingRequest(task), {}, parts_.robot().state());
            if (objection.empty() && !camera_)
                objection = "this robot was started without a camera: give --camera";
            return objection;
        },
        [this](Task& task) { track(task); });
}

void GraspServices::onStop() {
    gripper_.stop();
    head_.stop();
}

void GraspServices::onRobotState(const RobotState& robot) {
    // The camera does nothing before these three; it wants 300 ms for each.
    if (robot.sequence == 2) parts_.robot().command(Command::Tty2, vcc4::power(true));
    if (robot.sequence == 6) parts_.robot().command(Command::Tty2, vcc4::control());
    if (robot.sequence == 10) parts_.robot().command(Command::Tty2, vcc4::fullTiltRange());
    if (robot.sequence == 14)
        parts_.robot().command(Command::Tty2, vcc4::panRate(vcc4::kMaximumPanRate_deg_s));
    if (robot.sequence == 18)
        parts_.robot().command(Command::Tty2, vcc4::tiltRate(vcc4::kMaximumTiltRate_deg_s));
    if (camera_) camera_->want(watching_ > 0 || thumbnails_.wanted());
}

void GraspServices::sendThumbnail(const CameraPicture& picture) {
    if (!thumbnails_.wanted() || picture.taken < next_thumbnail_) return;
    // A little early rather than every third picture of a camera that gives ten a second.
    next_thumbnail_ = picture.taken + kThumbnailPeriod - std::chrono::milliseconds{20};
    const auto small = scaled(picture, kThumbnailWidth, kThumbnailHeight);
    Image image;
    image.width = static_cast<std::uint32_t>(small.width);
    image.height = static_cast<std::uint32_t>(small.height);
    image.encoding = "jpeg";
    image.pixels = toJpeg(small);
    thumbnails_.send(image);
}

bool GraspServices::tell(const GripperCommand& command) {
    return gripper_.order([&] {
        auto& robot = parts_.robot();
        if (!robot.gripper(command.order)) return false;
        return !command.value || robot.command(Command::GripperValue, *command.value);
    });
}

void GraspServices::operate(Task& task) {
    if (!gripper_.take([&task] { return task.stopRequested(); })) {
        if (!task.stopRequested()) task.fail("another task uses the gripper: stop it first");
        return;
    }
    // A task that is cancelled leaves nothing moving.
    const Finally back([&] {
        if (task.stopRequested()) gripper_.stop();
        gripper_.giveBack();
    });
    GripperOperation operation(gripperRequest(task));
    std::uint64_t seen = 0;
    while (task.waitFor(seen == 0 ? Duration::zero() : kControlPeriod)) {
        const auto robot = parts_.robot().state();
        if (robot.online && robot.sequence == seen) continue;
        seen = robot.sequence;
        const auto step = operation.step(robot, parts_.clock->now());
        for (const auto& command : step.commands) tell(command);
        task.progress(step.progress);
        if (step.outcome == Outcome::Running) continue;
        task.result("Holding", GripperOperation::holding(robot.gripper));
        if (step.outcome == Outcome::Done) {
            task.succeed();
        } else if (robot.online) {
            task.fail(step.reason);
        } else {
            task.robotLost(step.reason);
        }
        return;
    }
}

void GraspServices::track(Task& task) {
    const auto stopped = [&task] { return task.stopRequested(); };
    if (!parts_.drive.take(stopped)) {
        if (!task.stopRequested()) task.fail("another motion has the drive: stop it first");
        return;
    }
    const Finally drive_back([&] { parts_.drive.giveBack(); });  // halts the robot as well
    if (!gripper_.take(stopped)) {
        if (!task.stopRequested()) task.fail("another task uses the gripper: stop it first");
        return;
    }
    const Finally gripper_back([&] {
        if (task.stopRequested()) gripper_.stop();
        gripper_.giveBack();
    });
    if (!head_.take(stopped)) return;
    const Finally head_back([&] {
        if (task.stopRequested()) head_.stop();
        head_.giveBack();
    });
    ++watching_;
    camera_->want(true);
    const Finally watching_back([&] { --watching_; });

    const auto request = trackingRequest(task);
    Tracking tracking(request, {}, parts_.clock->now());
    parts_.robot().command(Command::Enable, 1);
    CameraView view;
    std::uint64_t seen = 0;
    std::optional<Tracking::Phase> told;
    while (task.waitFor(seen == 0 ? Duration::zero() : kControlPeriod)) {
        const auto robot = parts_.robot().state();
        const auto picture = camera_->newest();
        const bool new_picture = picture && picture->sequence != view.sequence;
        if (robot.online && robot.sequence == seen && !new_picture) continue;
        seen = robot.sequence;
        if (new_picture)
            view = {picture->sequence, picture->taken, picture->width, picture->height,
                    findBlobs(*picture, request.colour)};
        const auto set = trackingRequest(task);
        tracking.reconfigure(set.velocity_mm_s, set.range_threshold_mm, set.back_off_mm);
        const auto step = tracking.step(robot, view.sequence != 0 ? &view : nullptr, parts_.clock->now());
        for (const auto& command : step.gripper) tell(command);
        if (step.look)
            head_.order([&] { return parts_.robot().command(Command::Tty2, vcc4::panTilt(*step.look)); });
        if (told != tracking.phase()) {
            told = tracking.phase();
            task.feedback(Tracking::toString(*told));
        }
        task.result("Speed", std::round(robot.speed_mm_s()), "mm/s");
        task.progress(step.progress);
        if (step.outcome == Outcome::Running) {
            parts_.drive.drive(step.forward_mm_s, step.left_deg_s);
            continue;
        }
        if (step.outcome == Outcome::Done) {
            task.succeed();
        } else if (robot.online) {
            task.fail(step.reason);
        } else {
            task.robotLost(step.reason);
        }
        return;
    }
}

}  // namespace axon::peoplebot
