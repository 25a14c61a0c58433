// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/physics.hpp"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numbers>

#include "lab/peoplebot_geometry.hpp"

namespace axon::lab {
namespace {

using namespace peoplebot;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kBlockedAfter_s = 0.3;

/// Loads a model from text: MuJoCo reads files only, so it is given a file in memory.
mjModel* loadModel(const std::string& xml) {
    const auto files = std::make_unique<mjVFS>();
    mj_defaultVFS(files.get());
    if (mj_makeEmptyFileVFS(files.get(), "lab.xml", static_cast<int>(xml.size())) != 0) {
        throw BadDescription("the world's description is too large for MuJoCo");
    }
    const int at = mj_findFileVFS(files.get(), "lab.xml");
    std::memcpy(files->filedata[at], xml.data(), xml.size());
    std::array<char, 1000> error{};
    auto* model = mj_loadXML("lab.xml", files.get(), error.data(), static_cast<int>(error.size()));
    mj_deleteVFS(files.get());
    if (model == nullptr)
        throw BadDescription(std::string("MuJoCo cannot build this world: ") + error.data());
    return model;
}

struct Body {
    int base = 0;
    int free_position = 0;  // of the base in qpos
    int free_velocity = 0;
    struct Wheel {
        int position = 0;
        int velocity = 0;
        int actuator = 0;
        double blocked_s = 0;
    };
    Wheel left;
    Wheel right;
    double battery_v = kBatteryFull_v;
    int next_sonar = 0;  // of each array
    double sonar_due_s = 0;
    BodyReadings readings;
};

}  // namespace

class Physics::Model {
  public:
    explicit Model(const WorldDescription& world)
        : model_(loadModel(mjcf(world)), &mj_deleteModel), data_(mj_makeData(model_.get()), &mj_deleteData) {
        bumper_of_geom_.resize(static_cast<std::size_t>(model_->ngeom));
        for (std::size_t i = 0; i < world.robots.size(); ++i) bodies_.push_back(find(i));
        mj_forward(model_.get(), data_.get());
    }

    const BodyReadings& sense(std::size_t index) {
        auto& body = bodies_[index];
        auto& r = body.readings;
        r.left_wheel_mm = data_->qpos[body.left.position] * kWheelRadius_mm;
        r.right_wheel_mm = data_->qpos[body.right.position] * kWheelRadius_mm;
        r.left_mm_s = data_->qvel[body.left.velocity] * kWheelRadius_mm;
        r.right_mm_s = data_->qvel[body.right.velocity] * kWheelRadius_mm;
        r.left_blocked = body.left.blocked_s > kBlockedAfter_s;
        r.right_blocked = body.right.blocked_s > kBlockedAfter_s;
        r.battery_v = body.battery_v;
        senseBumpers(index, r);
        r.table_left = senseTable(body, kTableSensorY_mm);
        r.table_right = senseTable(body, -kTableSensorY_mm);
        senseSonars(body);
        return r;
    }

    void setWheels(std::size_t index, const ArcosServer::WheelSpeeds& speeds) {
        data_->ctrl[bodies_[index].left.actuator] = speeds.left_mm_s / kWheelRadius_mm;
        data_->ctrl[bodies_[index].right.actuator] = speeds.right_mm_s / kWheelRadius_mm;
    }

    void step() {
        mj_step(model_.get(), data_.get());
        const double dt = model_->opt.timestep;
        for (auto& body : bodies_) {
            updateBlocked(body.left, dt);
            updateBlocked(body.right, dt);
            const double speed = std::abs(body.readings.left_mm_s + body.readings.right_mm_s) / 2 / 750;
            const double used = (kBatteryIdle_v_per_h + kBatteryDriving_v_per_h * speed) * dt / 3600;
            body.battery_v = std::max(kBatteryEmpty_v, body.battery_v - used);
        }
    }

    Truth truth(std::size_t index) const {
        const auto& body = bodies_[index];
        const mjtNum* position = data_->qpos + body.free_position;
        const mjtNum* velocity = data_->qvel + body.free_velocity;
        const mjtNum* q = position + 3;
        const double theta = std::atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]));
        return {position[0], position[1], theta / kDegree,
                velocity[0] * std::cos(theta) + velocity[1] * std::sin(theta), velocity[5] / kDegree};
    }

  private:
    Body find(std::size_t index) {
        const std::string r = "r" + std::to_string(index) + "_";
        const auto id = [this](mjtObj type, const std::string& name) {
            return mj_name2id(model_.get(), type, name.c_str());
        };
        const auto wheel = [&](const char* side) {
            const int joint = id(mjOBJ_JOINT, r + side);
            return Body::Wheel{model_->jnt_qposadr[joint], model_->jnt_dofadr[joint],
                               id(mjOBJ_ACTUATOR, r + side)};
        };
        Body body;
        body.base = id(mjOBJ_BODY, r + "base");
        const int joint = model_->body_jntadr[body.base];
        body.free_position = model_->jnt_qposadr[joint];
        body.free_velocity = model_->jnt_dofadr[joint];
        body.left = wheel("left");
        body.right = wheel("right");
        for (int segment = 0; segment < kBumperSegments; ++segment) {
            const auto number = std::to_string(segment + 1);
            const auto front = static_cast<std::size_t>(id(mjOBJ_GEOM, r + "frontbumper" + number));
            const auto rear = static_cast<std::size_t>(id(mjOBJ_GEOM, r + "rearbumper" + number));
            bumper_of_geom_[front] = {static_cast<int>(index), 1U << static_cast<unsigned>(segment), 0};
            bumper_of_geom_[rear] = {static_cast<int>(index), 0, 1U << static_cast<unsigned>(segment)};
        }
        return body;
    }

    void senseBumpers(std::size_t index, BodyReadings& readings) const {
        readings.front_bumpers = readings.rear_bumpers = 0;
        for (int i = 0; i < data_->ncon; ++i) {
            const auto& contact = data_->contact[i];
            for (const int geom : {contact.geom1, contact.geom2}) {
                const auto& bumper = bumper_of_geom_[static_cast<std::size_t>(geom)];
                if (bumper.robot != static_cast<int>(index)) continue;
                readings.front_bumpers |= bumper.front;
                readings.rear_bumpers |= bumper.rear;
            }
        }
    }

    /// The distance along a ray that starts in the robot's frame, or nothing within the range:
    /// kSonarMaximum_mm or more.
    double ray_mm(const Body& body, double x_mm, double y_mm, double height_mm, double yaw_deg,
                  double pitch_deg) const {
        const std::array<mjtNum, 3> point{x_mm / 1000, y_mm / 1000, (height_mm - kWheelRadius_mm) / 1000};
        const std::array<mjtNum, 3> along{std::cos(pitch_deg * kDegree) * std::cos(yaw_deg * kDegree),
                                          std::cos(pitch_deg * kDegree) * std::sin(yaw_deg * kDegree),
                                          std::sin(pitch_deg * kDegree)};
        std::array<mjtNum, 3> from{};
        std::array<mjtNum, 3> direction{};
        const mjtNum* rotation = data_->xmat + 9 * body.base;
        mju_rotVecMat(from.data(), point.data(), rotation);
        mju_rotVecMat(direction.data(), along.data(), rotation);
        mju_addTo3(from.data(), data_->xpos + 3 * body.base);
        // Obstacles and hulls; not the floor, which a flat cone of sound leaves without an echo, and not
        // wheels.
        static constexpr std::array<mjtByte, mjNGROUP> kSeen{1, 1, 0, 0, 0, 0};
        int geom = -1;
        const double distance = mj_ray(model_.get(), data_.get(), from.data(), direction.data(), kSeen.data(),
                                       1, body.base, &geom);
        // MuJoCo's ray hits planes whatever their group says.
        const bool floor = geom >= 0 && model_->geom_type[geom] == mjGEOM_PLANE;
        return distance < 0 || floor ? 1e9 : distance * 1000;
    }

    bool senseTable(const Body& body, double y_mm) const {
        return ray_mm(body, kTableSensorX_mm, y_mm, kTableSensorHeight_mm, 0, 90) <= kTableSensorRange_mm;
    }

    void senseSonars(Body& body) {
        body.readings.sonars_fired = 0;
        if (data_->time < body.sonar_due_s) return;
        body.sonar_due_s += kSonarPeriod_ms / 1000.0;
        for (int array = 0; array < 3; ++array) {
            const int sonar = 8 * array + body.next_sonar;
            const auto& pose = kSonars[static_cast<std::size_t>(sonar)];
            const double height = array == 2 ? kTopSonarHeight_mm : kBaseSonarHeight_mm;
            double nearest = kSonarMaximum_mm;
            // Seven rays: the axis, four more in the plane, one above and one below.
            static constexpr std::array<std::array<double, 2>, 7> kCone{
                {{0, 0}, {-1, 0}, {-0.5, 0}, {0.5, 0}, {1, 0}, {0, 0.5}, {0, -0.5}}};
            for (const auto& ray : kCone) {
                nearest = std::min(nearest, ray_mm(body, pose.x_mm, pose.y_mm, height,
                                                   pose.direction_deg + ray[0] * kSonarHalfCone_deg,
                                                   ray[1] * kSonarHalfCone_deg));
            }
            body.readings.sonar_mm[static_cast<std::size_t>(sonar)] =
                static_cast<std::uint16_t>(std::lround(std::max(nearest, kSonarMinimum_mm)));
            body.readings.sonars_fired |= 1U << static_cast<unsigned>(sonar);
        }
        body.next_sonar = (body.next_sonar + 1) % 8;
    }

    void updateBlocked(Body::Wheel& wheel, double dt) const {
        const double wanted = std::abs(data_->ctrl[wheel.actuator]);
        const bool pushing = std::abs(data_->actuator_force[wheel.actuator]) > 0.97 * kMotorTorque_nm;
        const bool turning = std::abs(data_->qvel[wheel.velocity]) > 0.2 * wanted;
        wheel.blocked_s = pushing && !turning && wanted > 0 ? wheel.blocked_s + dt : 0;
    }

    struct Bumper {
        int robot = -1;
        unsigned front = 0;
        unsigned rear = 0;
    };

    std::unique_ptr<mjModel, decltype(&mj_deleteModel)> model_;
    std::unique_ptr<mjData, decltype(&mj_deleteData)> data_;
    std::vector<Bumper> bumper_of_geom_;
    std::vector<Body> bodies_;
};

Physics::Physics(const WorldDescription& world) : model_(std::make_unique<Model>(world)) {}
Physics::~Physics() = default;
const BodyReadings& Physics::sense(std::size_t robot) {
    return model_->sense(robot);
}
void Physics::setWheels(std::size_t robot, const ArcosServer::WheelSpeeds& speeds) {
    model_->setWheels(robot, speeds);
}
void Physics::step() {
    model_->step();
}
Truth Physics::truth(std::size_t robot) const {
    return model_->truth(robot);
}

}  // namespace axon::lab
