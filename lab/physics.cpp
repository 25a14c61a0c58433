// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/physics.hpp"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <numbers>
#include <random>
#include <stdexcept>

#include "lab/peoplebot_geometry.hpp"
#include "lab/physics_view.hpp"
#include "robots/arcos/laser.hpp"

namespace axon::lab {
namespace {

using namespace peoplebot;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kBlockedAfter_s = 0.3;
constexpr double kSlippery = 0.005;  // friction of a tyre that has lost its grip
constexpr double kParked_z = -5;     // where obstacles are that nobody has put anywhere

/// Loads a model from text: MuJoCo reads files only, so it is given a file in memory.
mjModel* loadModel(const std::string& xml) {
    // Its own way to warn is a file in the working directory.
    mju_user_warning = [](const char* text) {
        std::fprintf(stderr, "axon-lab: warning: MuJoCo: %s\n", text);
    };
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

/// A joint and the motor that moves it.
struct Motor {
    int position = 0;  // in qpos
    int velocity = 0;  // in qvel
    int actuator = 0;
    double blocked_s = 0;
};

struct Wheel : Motor {
    double wanted_rad_s = 0;
    double before_rad_s = 0;  // what was wanted in the step before
    double lag_rad = 0;       // behind what was wanted since the robot rested
};

struct Body {
    int base = 0;
    int free_position = 0;  // of the base in qpos
    int free_velocity = 0;
    Wheel left;
    Wheel right;
    std::array<int, 2> wheel_geoms{};
    Motor left_paddle;
    Motor right_paddle;
    std::array<int, 2> paddle_geoms{};
    Motor lift;
    Motor pan;
    Motor tilt;
    int camera = 0;
    GripperSpeeds gripper;
    LaserSettings laser;
    double battery_v = kBatteryFull_v;
    int next_sonar = 0;  // of each array
    double sonar_due_s = 0;
    double laser_due_s = 0;
    std::uint32_t dead_sonars = 0;
    bool gripper_stuck = false;
    std::vector<std::string> touched;
    BodyReadings readings;
};

/// What a geom belongs to.
struct Owner : Scene::Owner {
    bool holds = false;  // gripper of a robot: it touches objects as a matter of course
};

void addOnce(std::vector<std::string>& names, const std::string& name) {
    if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
}

}  // namespace

class Physics::Model {
  public:
    Model(const WorldDescription& world, const Options& options)
        : world_(world),
          options_(options),
          scene_(sceneOf(world)),
          model_(loadModel(scene_.xml), &mj_deleteModel),
          data_(mj_makeData(model_.get()), &mj_deleteData) {
        complete(world_);
        obstacle_names_.resize(kObstacles);
        for (const auto& robot : scene_.robots)
            first_.push_back(bodyOf(partsOf(robot, model_.get(), data_.get())));
        for (std::size_t i = 0; i < world_.devices.size(); ++i)
            devices_.push_back(deviceKind(world_.devices[i].kind)
                                   ->make(partsOf(scene_.devices[i], model_.get(), data_.get())));
        for (const auto& object : scene_.objects) objects_.push_back(id(mjOBJ_BODY, object));
        for (const auto& [body, geom] : scene_.obstacles)
            obstacles_.push_back({model_->body_mocapid[id(mjOBJ_BODY, body)], id(mjOBJ_GEOM, geom)});
        findOwners();
        friction_.assign(model_->geom_friction, model_->geom_friction + 3 * model_->ngeom);
        reset();
    }

    void reset() {
        mj_resetData(model_.get(), data_.get());
        std::copy(friction_.begin(), friction_.end(), model_->geom_friction);
        std::fill(obstacle_names_.begin(), obstacle_names_.end(), std::string());
        bodies_ = first_;
        for (auto& body : bodies_) {
            for (const int wheel : body.wheel_geoms) model_->geom_priority[wheel] = 0;
            model_->cam_fovy[body.camera] = fieldOfView(0);
            for (auto* paddle : {&body.left_paddle, &body.right_paddle}) {
                data_->qpos[paddle->position] = GripperControl::kOpening_mm / 1000;
                data_->ctrl[paddle->actuator] = GripperControl::kOpening_mm / 1000;
            }
        }
        for (const auto& device : devices_) device->reset();
        random_.seed(options_.seed);
        normal_.reset();
        mj_forward(model_.get(), data_.get());
    }

    const BodyReadings& sense(std::size_t index) {
        auto& body = bodies_.at(index);
        auto& r = body.readings;
        r.left_wheel_mm = data_->qpos[body.left.position] * kWheelRadius_mm;
        r.right_wheel_mm = data_->qpos[body.right.position] * kWheelRadius_mm;
        r.left_mm_s = data_->qvel[body.left.velocity] * kWheelRadius_mm;
        r.right_mm_s = data_->qvel[body.right.velocity] * kWheelRadius_mm;
        r.left_blocked = body.left.blocked_s > kBlockedAfter_s;
        r.right_blocked = body.right.blocked_s > kBlockedAfter_s;
        r.battery_v = body.battery_v;
        r.charge = (body.battery_v - kBatteryEmpty_v) / (kBatteryFull_v - kBatteryEmpty_v);
        senseContacts(index, body);
        r.table_left = senseTable(body, kTableSensorY_mm);
        r.table_right = senseTable(body, -kTableSensorY_mm);
        senseBeams(body);
        senseSonars(body);
        senseLaser(body);
        return r;
    }

    void setWheels(std::size_t index, const ArcosServer::WheelSpeeds& speeds) {
        auto& body = bodies_.at(index);
        body.left.wanted_rad_s = speeds.left_mm_s / kWheelRadius_mm;
        body.right.wanted_rad_s = speeds.right_mm_s / kWheelRadius_mm;
    }
    void setGripper(std::size_t index, const GripperSpeeds& speeds) { bodies_.at(index).gripper = speeds; }
    void setCamera(std::size_t index, const CameraPose& pose) {
        const auto& body = bodies_.at(index);
        data_->ctrl[body.pan.actuator] = pose.looks.pan_left_deg * kDegree;
        data_->ctrl[body.tilt.actuator] = pose.looks.tilt_up_deg * kDegree;
        model_->cam_fovy[body.camera] = fieldOfView(pose.zoom);
    }
    void setLaser(std::size_t index, const LaserSettings& settings) {
        auto& body = bodies_.at(index);
        if (settings.on && !body.laser.on) body.laser_due_s = data_->time;
        body.laser = settings;
    }
    Device& device(std::size_t index) const { return *devices_.at(index); }

    void step() {
        const double dt = model_->opt.timestep;
        for (auto& body : bodies_) {
            driveWheels(body, dt);
            moveGripper(body, dt);
        }
        for (const auto& device : devices_) device->step(kPeriod);
        advance();
        for (auto& body : bodies_) {
            for (auto* wheel : {&body.left, &body.right}) {
                const double wanted = std::abs(wheel->wanted_rad_s);
                const bool turning = std::abs(data_->qvel[wheel->velocity]) > 0.2 * wanted;
                updateBlocked(*wheel, kMotorTorque_nm, wanted > 0 && !turning, dt);
            }
            updateBlocked(body.lift, kLiftForce_n, body.gripper.lift_mm_s != 0, dt);
            const double speed = std::abs(body.readings.left_mm_s + body.readings.right_mm_s) / 2 / 750;
            const double used = (kBatteryIdle_v_per_h + kBatteryDriving_v_per_h * speed) * dt / 3600;
            body.battery_v = std::max(kBatteryEmpty_v, body.battery_v - used);
        }
        rememberTouches();
    }

    double time() const { return data_->time; }

    Truth truth(std::size_t index) const {
        const auto& body = bodies_.at(index);
        const mjtNum* position = data_->qpos + body.free_position;
        const mjtNum* velocity = data_->qvel + body.free_velocity;
        const mjtNum* q = position + 3;
        const double theta = std::atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]));
        return {.x_m = position[0],
                .y_m = position[1],
                .theta_deg = theta / kDegree,
                .speed_m_s = velocity[0] * std::cos(theta) + velocity[1] * std::sin(theta),
                .rotation_deg_s = velocity[5] / kDegree,
                .lift_mm = data_->qpos[body.lift.position] * 1000,
                .opening_mm =
                    (data_->qpos[body.left_paddle.position] + data_->qpos[body.right_paddle.position]) * 1000,
                .touched = body.touched};
    }

    std::vector<ObjectTruth> truthOfObjects() const {
        std::vector<ObjectTruth> truths;
        for (std::size_t i = 0; i < objects_.size(); ++i) {
            const auto& object = world_.objects[i];
            const mjtNum* at = data_->xpos + 3 * objects_[i];
            const mjtNum* turned = data_->xmat + 9 * objects_[i];
            const mjtNum* velocity = data_->qvel + model_->jnt_dofadr[model_->body_jntadr[objects_[i]]];
            ObjectTruth truth;
            truth.name = object.name;
            truth.x_m = at[0];
            truth.y_m = at[1];
            truth.z_m = at[2] - std::abs(turned[8]) * object.dz / 2;
            truth.theta_deg = std::atan2(turned[3], turned[0]) / kDegree;
            truth.tilt_deg = std::acos(std::clamp(turned[8], -1.0, 1.0)) / kDegree;
            truth.speed_m_s = mju_norm3(velocity);
            truths.push_back(std::move(truth));
        }
        forEachContact([&](const Owner& one, const Owner& other) {
            if (one.kind == Owner::Kind::Object) addOnce(truths[one.index].on, nameOf(other));
            if (other.kind == Owner::Kind::Object) addOnce(truths[other.index].on, nameOf(one));
        });
        return truths;
    }
    void forgetTouches() {
        for (auto& body : bodies_) body.touched.clear();
    }

    void placeObject(const std::string& name, double x, double y, double z, double theta) {
        const auto found = std::find_if(world_.objects.begin(), world_.objects.end(),
                                        [&name](const Object& object) { return object.name == name; });
        if (found == world_.objects.end()) throw std::invalid_argument("there is no object called " + name);
        const int joint =
            model_->body_jntadr[objects_[static_cast<std::size_t>(found - world_.objects.begin())]];
        put(model_->jnt_qposadr[joint], model_->jnt_dofadr[joint], x, y, z + found->dz / 2, theta);
        mj_forward(model_.get(), data_.get());
    }
    void placeRobot(std::size_t index, double x, double y, double theta) {
        const auto& body = bodies_.at(index);
        put(body.free_position, body.free_velocity, x, y, kWheelRadius_mm / 1000, theta);
        mj_forward(model_.get(), data_.get());
    }

    void addObstacle(const Box& box) {
        if (box.name.empty()) throw std::invalid_argument("an obstacle needs a name");
        auto found = std::find(obstacle_names_.begin(), obstacle_names_.end(), box.name);
        if (found == obstacle_names_.end())
            found = std::find(obstacle_names_.begin(), obstacle_names_.end(), std::string());
        if (found == obstacle_names_.end()) {
            throw std::invalid_argument("there are " + std::to_string(kObstacles) +
                                        " obstacles already: remove one first");
        }
        *found = box.name;
        const auto number = found - obstacle_names_.begin();
        const int geom = obstacles_[static_cast<std::size_t>(number)].geom;
        mjtNum* size = model_->geom_size + 3 * geom;
        size[0] = box.dx / 2;
        size[1] = box.dy / 2;
        size[2] = box.height / 2;
        model_->geom_rbound[geom] = mju_norm3(size);
        standObstacle(static_cast<std::size_t>(number), box.x, box.y, box.z + box.height / 2, box.theta);
    }
    void moveObstacle(const std::string& name, double x, double y, double theta) {
        const auto number = obstacleNamed(name);
        standObstacle(number, x, y, data_->mocap_pos[3 * obstacles_[number].mocap + 2], theta);
    }
    void removeObstacle(const std::string& name) {
        const auto number = obstacleNamed(name);
        standObstacle(number, static_cast<double>(number), 0, kParked_z, 0);
        obstacle_names_[number].clear();
    }

    void setFault(std::size_t index, const Fault& fault, bool broken) {
        auto& body = bodies_.at(index);
        switch (fault.kind) {
            case Fault::Kind::DeadSonar: {
                if (fault.which < 0 || fault.which >= BodyReadings::kSonars)
                    throw std::invalid_argument("sonars are numbered 0 to 23");
                const auto bit = 1U << static_cast<unsigned>(fault.which);
                body.dead_sonars = broken ? body.dead_sonars | bit : body.dead_sonars & ~bit;
                break;
            }
            case Fault::Kind::StuckGripper:
                body.gripper_stuck = broken;
                break;
            case Fault::Kind::SlippingWheel: {
                if (fault.which < 0 || fault.which > 1)
                    throw std::invalid_argument("wheels are 0, left, and 1, right");
                const int geom = body.wheel_geoms[static_cast<std::size_t>(fault.which)];
                // By priority: of two frictions the larger one counts, which is the floor's.
                model_->geom_priority[geom] = broken ? 1 : 0;
                model_->geom_friction[3 * geom] =
                    broken ? kSlippery : friction_[3 * static_cast<std::size_t>(geom)];
                break;
            }
            case Fault::Kind::FlatBattery:
                body.battery_v = broken ? kBatteryEmpty_v : kBatteryFull_v;
                break;
        }
    }

    const mjModel* model() const { return model_.get(); }
    const std::string& cameraName(std::size_t robot) const { return scene_.robots.at(robot).cameras[0]; }

    void copyTo(mjModel* model, mjData* data) const {
        std::copy_n(model_->cam_fovy, model_->ncam, model->cam_fovy);
        for (const auto& [mocap, geom] : obstacles_) {
            std::copy_n(model_->geom_size + 3 * geom, 3, model->geom_size + 3 * geom);
            model->geom_rbound[geom] = model_->geom_rbound[geom];
        }
        data->time = data_->time;
        std::copy_n(data_->qpos, model_->nq, data->qpos);
        std::copy_n(data_->mocap_pos, 3 * model_->nmocap, data->mocap_pos);
        std::copy_n(data_->mocap_quat, 4 * model_->nmocap, data->mocap_quat);
        mj_kinematics(model, data);
        mj_comPos(model, data);
        mj_camlight(model, data);
    }

  private:
    /// MuJoCo 2.2.2 now and then finds a box that stands exactly flat on another one (1e-16 off) to be a
    /// metre deep in it, and flings it away. Such a step is made anew with the objects a millionth of a
    /// radian off.
    void advance() {
        constexpr double kNonsense_m = -0.05;
        constexpr double kOff_rad = 1e-6;
        before_.qpos.assign(data_->qpos, data_->qpos + model_->nq);
        before_.qvel.assign(data_->qvel, data_->qvel + model_->nv);
        before_.act.assign(data_->act, data_->act + model_->na);
        before_.warmstart.assign(data_->qacc_warmstart, data_->qacc_warmstart + model_->nv);
        before_.time = data_->time;
        mj_step(model_.get(), data_.get());
        const bool nonsense =
            std::any_of(data_->contact, data_->contact + data_->ncon,
                        [](const mjContact& contact) { return contact.dist < kNonsense_m; });
        if (!nonsense) return;
        std::copy(before_.qpos.begin(), before_.qpos.end(), data_->qpos);
        std::copy(before_.qvel.begin(), before_.qvel.end(), data_->qvel);
        std::copy(before_.act.begin(), before_.act.end(), data_->act);
        std::copy(before_.warmstart.begin(), before_.warmstart.end(), data_->qacc_warmstart);
        data_->time = before_.time;
        for (const int object : objects_) {
            mjtNum* turn = data_->qpos + model_->jnt_qposadr[model_->body_jntadr[object]] + 3;
            turn[1] += kOff_rad;
            turn[2] += 1.3 * kOff_rad;
        }
        mj_step(model_.get(), data_.get());
    }

    int id(mjtObj type, const std::string& name) const {
        return mj_name2id(model_.get(), type, name.c_str());
    }

    /// In the order of peoplebot::kMotors and kGeoms.
    Body bodyOf(const DeviceParts& parts) const {
        const auto motor = [&](std::size_t number) {
            const int joint = parts.joints[number];
            return Motor{model_->jnt_qposadr[joint], model_->jnt_dofadr[joint], parts.actuators[number]};
        };
        Body body;
        body.base = parts.root;
        const int joint = model_->body_jntadr[body.base];
        body.free_position = model_->jnt_qposadr[joint];
        body.free_velocity = model_->jnt_dofadr[joint];
        body.left = {motor(0)};
        body.right = {motor(1)};
        body.wheel_geoms = {parts.geoms[0], parts.geoms[1]};
        body.left_paddle = motor(2);
        body.right_paddle = motor(3);
        body.paddle_geoms = {parts.geoms[2], parts.geoms[3]};
        body.lift = motor(4);
        body.pan = motor(5);
        body.tilt = motor(6);
        body.camera = parts.cameras[0];
        return body;
    }

    void findOwners() {
        std::map<int, Scene::Owner> bodies;
        for (const auto& [name, owner] : scene_.bodies) bodies[id(mjOBJ_BODY, name)] = owner;
        std::map<int, Scene::Owner> geoms;
        for (const auto& [name, owner] : scene_.geoms) geoms[id(mjOBJ_GEOM, name)] = owner;
        for (int geom = 0; geom < model_->ngeom; ++geom) {
            const int body = model_->geom_bodyid[geom];
            auto found = geoms.find(geom);
            if (found == geoms.end()) {
                found = bodies.find(model_->body_rootid[body]);
                if (found == bodies.end())
                    throw std::logic_error("a geom of this world belongs to nothing that its Scene names");
            }
            Owner owner{found->second};
            if (owner.kind == Owner::Kind::Robot) {
                const int lift = model_->jnt_bodyid[model_->dof_jntid[first_[owner.index].lift.velocity]];
                owner.holds = body == lift || model_->body_parentid[body] == lift;
            }
            owners_.push_back(owner);
        }
    }

    const std::string& nameOf(const Owner& owner) const {
        static const std::string kFloor = "floor";
        switch (owner.kind) {
            case Owner::Kind::Fixed:
                return scene_.fixed[owner.index];
            case Owner::Kind::Obstacle:
                return obstacle_names_[owner.index];
            case Owner::Kind::Object:
                return world_.objects[owner.index].name;
            case Owner::Kind::Robot:
                return world_.robots[owner.index].name;
            case Owner::Kind::Device:
                return world_.devices[owner.index].name;
            default:
                return kFloor;
        }
    }

    const Owner& ownerOf(int geom) const { return owners_[static_cast<std::size_t>(geom)]; }

    /// Of those that bear; the ones that are only near are left out.
    template <class F>
    void forEachContact(F&& visit) const {
        for (int i = 0; i < data_->ncon; ++i) {
            const auto& contact = data_->contact[i];
            if (contact.exclude == 0 && contact.efc_address >= 0)
                visit(ownerOf(contact.geom1), ownerOf(contact.geom2));
        }
    }

    void rememberTouches() {
        forEachContact([this](const Owner& one, const Owner& other) {
            const auto note = [this](const Owner& robot, const Owner& thing) {
                if (robot.kind != Owner::Kind::Robot || thing.kind == Owner::Kind::Floor) return;
                if (thing.kind == Owner::Kind::Robot && thing.index == robot.index) return;
                if (thing.kind == Owner::Kind::Object && robot.holds) return;
                addOnce(bodies_[robot.index].touched, nameOf(thing));
            };
            note(one, other);
            note(other, one);
        });
    }

    void senseContacts(std::size_t index, Body& body) const {
        auto& r = body.readings;
        r.front_bumpers = r.rear_bumpers = 0;
        std::array<double, 2> pressure{};
        for (int i = 0; i < data_->ncon; ++i) {
            const auto& contact = data_->contact[i];
            for (const int geom : {contact.geom1, contact.geom2}) {
                const auto& owner = ownerOf(geom);
                if (owner.kind != Owner::Kind::Robot || owner.index != index) continue;
                r.front_bumpers |= owner.front;
                r.rear_bumpers |= owner.rear;
                for (std::size_t side = 0; side < 2; ++side) {
                    if (geom != body.paddle_geoms[side]) continue;
                    std::array<mjtNum, 6> force{};
                    mj_contactForce(model_.get(), data_.get(), i, force.data());
                    // What presses on its face; not what it stands on.
                    pressure[side] += force[0] * std::abs(alongPaddles(body, contact.frame));
                }
            }
        }
        r.gripper.left_pressed = pressure[0] > kPaddlePressed_n;
        r.gripper.right_pressed = pressure[1] > kPaddlePressed_n;
        r.gripper.left_paddle_mm = data_->qpos[body.left_paddle.position] * 1000;
        r.gripper.right_paddle_mm = data_->qpos[body.right_paddle.position] * 1000;
        r.gripper.lift_mm = data_->qpos[body.lift.position] * 1000;
        r.gripper.lift_blocked = body.lift.blocked_s > kBlockedAfter_s;
    }

    /// The part of a direction that is along the robot's y axis.
    double alongPaddles(const Body& body, const mjtNum* direction) const {
        const mjtNum* rotation = data_->xmat + 9 * body.base;
        return direction[0] * rotation[1] + direction[1] * rotation[4] + direction[2] * rotation[7];
    }

    /// The distance along a ray that starts in the robot's frame, or nothing: 1e9.
    double ray_mm(const Body& body, double x_mm, double y_mm, double height_mm, double yaw_deg,
                  double pitch_deg, bool through_glass = false) const {
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
        // Obstacles, hulls and objects; not the floor, which a flat cone of sound leaves without an echo, and
        // not wheels and grippers.
        const std::array<mjtByte, mjNGROUP> seen{1, 1, 1, 0, 0, static_cast<mjtByte>(through_glass ? 0 : 1)};
        int geom = -1;
        const double distance = mj_ray(model_.get(), data_.get(), from.data(), direction.data(), seen.data(),
                                       1, body.base, &geom);
        // MuJoCo's ray hits planes whatever their group says.
        const bool floor = geom >= 0 && model_->geom_type[geom] == mjGEOM_PLANE;
        return distance < 0 || floor ? 1e9 : distance * 1000;
    }

    bool senseTable(const Body& body, double y_mm) const {
        return ray_mm(body, kTableSensorX_mm, y_mm, kTableSensorHeight_mm, 0, 90) <= kTableSensorRange_mm;
    }

    void senseBeams(Body& body) const {
        const double left = data_->qpos[body.left_paddle.position] * 1000;
        const double right = data_->qpos[body.right_paddle.position] * 1000;
        const double height = kPaddleLowest_mm + data_->qpos[body.lift.position] * 1000;
        // From inside of the one paddle to inside of the other: what is pinched is also between them.
        const auto broken = [&](double x_mm) {
            return ray_mm(body, x_mm, left + kPaddleHalfThickness_mm, height, -90, 0) <
                   left + right + kPaddleHalfThickness_mm;
        };
        body.readings.gripper.inner_beam_broken = broken(kInnerBeam_mm);
        body.readings.gripper.outer_beam_broken = broken(kOuterBeam_mm);
    }

    double noise(double deviation) {
        return options_.noise == 0 ? 0 : normal_(random_) * deviation * options_.noise;
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
            const double off = noise(kSonarNoise_mm);
            if (nearest < kSonarMaximum_mm) nearest = std::min(nearest + off, kSonarMaximum_mm);
            if ((body.dead_sonars & (1U << static_cast<unsigned>(sonar))) != 0) nearest = kSonarMaximum_mm;
            body.readings.sonar_mm[static_cast<std::size_t>(sonar)] =
                static_cast<std::uint16_t>(std::lround(std::max(nearest, kSonarMinimum_mm)));
            body.readings.sonars_fired |= 1U << static_cast<unsigned>(sonar);
        }
        body.next_sonar = (body.next_sonar + 1) % 8;
    }

    void senseLaser(Body& body) {
        auto& r = body.readings;
        r.laser_scanned = false;
        if (!body.laser.on || data_->time < body.laser_due_s) return;
        body.laser_due_s =
            std::max(body.laser_due_s, data_->time - kLaserPeriod_ms / 1000.0) + kLaserPeriod_ms / 1000.0;
        r.laser_scanned = true;
        r.laser_mm.resize(static_cast<std::size_t>(body.laser.readings()));
        for (std::size_t i = 0; i < r.laser_mm.size(); ++i) {
            const double angle = body.laser.start_deg + static_cast<double>(i) * body.laser.resolution_deg;
            const double range =
                ray_mm(body, kLaserX_mm, 0, kLaserHeight_mm, angle, 0, true) + noise(kLaserNoise_mm);
            r.laser_mm[i] = range > kLaserMaximum_mm
                                ? arcos::LaserPacket::kNothing_mm
                                : static_cast<std::uint16_t>(std::lround(std::max(0.0, range)));
        }
    }

    /// The wheel servos. A wheel catches up with what friction has cost it, as by the firmware's PID: without
    /// that a turn, in which the tyres scrub, is 1 to 3 deg/s slower than ordered.
    void driveWheels(Body& body, double dt) {
        // Nothing is held against friction: a robot that was stopped, stalled or switched off pushes no more.
        const bool rests = body.left.wanted_rad_s == 0 && body.right.wanted_rad_s == 0;
        for (auto* wheel : {&body.left, &body.right}) {
            const double error = wheel->wanted_rad_s - data_->qvel[wheel->velocity];
            // Given beforehand, not caught up with: the wheel would overshoot after each ramp.
            const double ramp_nm = kWheelInertia_kg_m2 * (wheel->wanted_rad_s - wheel->before_rad_s) / dt;
            wheel->before_rad_s = wheel->wanted_rad_s;
            const double lag = rests ? 0 : wheel->lag_rad + error * dt;
            const double torque = kWheelDamping_nm_s * error + kWheelStiffness_nm * lag + ramp_nm;
            // A motor that gives all it has falls behind, and does not race to make up for it.
            if (rests || std::abs(torque) < kMotorTorque_nm || torque * error < 0) wheel->lag_rad = lag;
            data_->ctrl[wheel->actuator] =
                wheel->wanted_rad_s + (kWheelStiffness_nm * wheel->lag_rad + ramp_nm) / kWheelDamping_nm_s;
        }
    }

    void moveGripper(Body& body, double dt) {
        const auto speeds = body.gripper_stuck ? GripperSpeeds{} : body.gripper;
        const auto move = [&](const Motor& motor, double speed_mm_s, double most_m, double stiffness,
                              double force) {
            auto& target = data_->ctrl[motor.actuator];
            // No further ahead than the motor's force reaches: otherwise it would not let go at once.
            const double now = data_->qpos[motor.position];
            const double reach = 1.1 * force / stiffness;
            target = std::clamp(target + speed_mm_s / 1000 * dt, now - reach, now + reach);
            target = std::clamp(target, -reach, most_m);
        };
        constexpr double kOpening_m = GripperControl::kOpening_mm / 1000;
        move(body.left_paddle, speeds.paddles_mm_s, kOpening_m, kPaddleStiffness_n_m, kPaddleForce_n);
        move(body.right_paddle, speeds.paddles_mm_s, kOpening_m, kPaddleStiffness_n_m, kPaddleForce_n);
        move(body.lift, speeds.lift_mm_s, GripperControl::kLift_mm / 1000, kLiftStiffness_n_m, kLiftForce_n);
        if (data_->ctrl[body.lift.actuator] < 0) data_->ctrl[body.lift.actuator] = 0;
        // MuJoCo 2.2.2 cannot compensate gravity: the lift would sag.
        data_->qfrc_applied[body.lift.velocity] = data_->qfrc_bias[body.lift.velocity];
    }

    void updateBlocked(Motor& motor, double force, bool wants, double dt) const {
        const bool pushing = std::abs(data_->actuator_force[motor.actuator]) > 0.97 * force;
        motor.blocked_s = pushing && wants ? motor.blocked_s + dt : 0;
    }

    static double fieldOfView(int zoom) {
        return 2 * std::atan(std::tan(arcos::vcc4::viewAt(zoom) / 2 * kDegree) * 0.75) / kDegree;
    }

    void put(int position, int velocity, double x, double y, double z, double theta_deg) {
        mjtNum* q = data_->qpos + position;
        const double half = theta_deg / 2 * kDegree;
        const std::array<mjtNum, 7> pose{x, y, z, std::cos(half), 0, 0, std::sin(half)};
        std::copy(pose.begin(), pose.end(), q);
        std::fill_n(data_->qvel + velocity, 6, 0.0);
    }

    std::size_t obstacleNamed(const std::string& name) const {
        const auto found = std::find(obstacle_names_.begin(), obstacle_names_.end(), name);
        if (name.empty() || found == obstacle_names_.end())
            throw std::invalid_argument("there is no obstacle called " + name);
        return static_cast<std::size_t>(found - obstacle_names_.begin());
    }
    void standObstacle(std::size_t number, double x, double y, double z, double theta_deg) {
        const int mocap = obstacles_[number].mocap;
        const double half = theta_deg / 2 * kDegree;
        const std::array<mjtNum, 3> position{x, y, z};
        const std::array<mjtNum, 4> rotation{std::cos(half), 0, 0, std::sin(half)};
        std::copy(position.begin(), position.end(), data_->mocap_pos + 3 * mocap);
        std::copy(rotation.begin(), rotation.end(), data_->mocap_quat + 4 * mocap);
    }

    WorldDescription world_;
    const Options options_;
    const Scene scene_;
    std::unique_ptr<mjModel, decltype(&mj_deleteModel)> model_;
    std::unique_ptr<mjData, decltype(&mj_deleteData)> data_;
    std::vector<Owner> owners_;                // by geom
    std::vector<std::string> obstacle_names_;  // empty: a spare one
    std::vector<Body> first_;                  // as they are in the beginning
    std::vector<Body> bodies_;
    std::vector<std::unique_ptr<Device>> devices_;
    std::vector<int> objects_;  // bodies
    struct Obstacle {
        int mocap = 0;
        int geom = 0;
    };
    std::vector<Obstacle> obstacles_;
    struct {
        std::vector<mjtNum> qpos, qvel, act, warmstart;
        double time = 0;
    } before_;  // of the step
    std::vector<double> friction_;
    std::mt19937_64 random_;
    std::normal_distribution<double> normal_;
};

Physics::Physics(const WorldDescription& world, const Options& options)
    : model_(std::make_unique<Model>(world, options)) {}
Physics::~Physics() = default;
const BodyReadings& Physics::sense(std::size_t robot) {
    return model_->sense(robot);
}
void Physics::setWheels(std::size_t robot, const ArcosServer::WheelSpeeds& speeds) {
    model_->setWheels(robot, speeds);
}
void Physics::setGripper(std::size_t robot, const GripperSpeeds& speeds) {
    model_->setGripper(robot, speeds);
}
void Physics::setCamera(std::size_t robot, const CameraPose& pose) {
    model_->setCamera(robot, pose);
}
void Physics::setLaser(std::size_t robot, const LaserSettings& settings) {
    model_->setLaser(robot, settings);
}
Device& Physics::device(std::size_t index) {
    return model_->device(index);
}
const Device& Physics::device(std::size_t index) const {
    return model_->device(index);
}
void Physics::step() {
    model_->step();
}
double Physics::time_s() const {
    return model_->time();
}
void Physics::reset() {
    model_->reset();
}
Truth Physics::truth(std::size_t robot) const {
    return model_->truth(robot);
}
std::vector<ObjectTruth> Physics::truthOfObjects() const {
    return model_->truthOfObjects();
}
void Physics::forgetTouches() {
    model_->forgetTouches();
}
void Physics::placeObject(const std::string& name, double x_m, double y_m, double z_m, double theta_deg) {
    model_->placeObject(name, x_m, y_m, z_m, theta_deg);
}
void Physics::placeRobot(std::size_t robot, double x_m, double y_m, double theta_deg) {
    model_->placeRobot(robot, x_m, y_m, theta_deg);
}
void Physics::addObstacle(const Box& box) {
    model_->addObstacle(box);
}
void Physics::moveObstacle(const std::string& name, double x_m, double y_m, double theta_deg) {
    model_->moveObstacle(name, x_m, y_m, theta_deg);
}
void Physics::removeObstacle(const std::string& name) {
    model_->removeObstacle(name);
}
void Physics::setFault(std::size_t robot, const Fault& fault, bool broken) {
    model_->setFault(robot, fault, broken);
}

const std::string& PhysicsView::cameraName(std::size_t robot) const {
    return physics_.model_->cameraName(robot);
}
const mjModel* PhysicsView::model() const {
    return physics_.model_->model();
}
void PhysicsView::copyTo(mjModel* model, mjData* data) const {
    physics_.model_->copyTo(model, data);
}

}  // namespace axon::lab
