// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/cyton/body.hpp"

#include <fmt/format.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <numbers>

namespace axon::lab {
namespace {

using namespace cyton;

constexpr double kDegree = std::numbers::pi / 180;

/// Stiffness, damping and the inertia of motor and gears, by joint; assumed. So stiff that 60 g in the claws
/// move the arm by less than a millimetre, and stable with steps of up to 5 ms.
struct Gains {
    double kp, kv, armature;
};
constexpr std::array<Gains, kJoints> kGains{{
    {100, 3.5, 0.02},
    {150, 5, 0.01},
    {60, 2, 0.012},
    {60, 2, 0.01},
    {20, 0.5, 0.004},
    {30, 0.6, 0.004},
    {20, 0.5, 0.004},
}};
constexpr Gains kClawGains{1500, 20, 0.05};

/// What one sees of a link: its main body, from its joint up to the next, with the arm at zero.
std::string linkGeoms(std::size_t joint) {
    constexpr auto kMetal = R"(rgba="0.75 0.76 0.78 1")";
    constexpr auto kServo = R"(rgba="0.13 0.13 0.15 1")";
    const auto box = [&](double x, double y, double z, double hx, double hy, double hz, const char* colour,
                         double mass) {
        return fmt::format(
            R"(<geom type="box" pos="{} {} {}" size="{} {} {}" {} mass="{}" group="1" contype="1" conaffinity="0"/>)"
            "\n",
            x, y, z, hx, hy, hz, colour, mass);
    };
    const double mass = kChain[joint].mass_kg;
    switch (joint) {
        case 0:
            return box(0, 0, 0.018, 0.035, 0.038, 0.016, kMetal, mass / 2) +
                   box(0, 0.03, 0.035, 0.02, 0.009, 0.02, kServo, mass / 4) +
                   box(0, -0.03, 0.035, 0.02, 0.009, 0.02, kServo, mass / 4);
        case 1:
            return box(0, 0, 0.045, 0.018, 0.02, 0.05, kMetal, mass / 2) +
                   box(0, 0.004, 0.08, 0.027, 0.029, 0.024, kServo, mass / 2);
        case 2:
            return box(0, 0, 0.033, 0.016, 0.024, 0.03, kMetal, mass);
        case 3:
            return box(0, 0, 0.035, 0.014, 0.018, 0.038, kMetal, mass / 2) +
                   box(0, 0.001, 0.065, 0.02, 0.022, 0.02, kServo, mass / 2);
        case 4:
            return box(0, 0, 0.035, 0.012, 0.018, 0.033, kMetal, mass);
        case 5:
            return box(0, -0.006, 0.032, 0.015, 0.014, 0.03, kMetal, mass / 2) +
                   box(0, -0.006, 0.045, 0.019, 0.017, 0.013, kServo, mass / 2);
        default:
            return box(kClaws_m[0], 0, 0.028, 0.03, 0.02, 0.014, kServo, mass / 2) +
                   box(kClaws_m[0], 0, 0.045, 0.034, 0.011, 0.004, kMetal, mass / 2);
    }
}

/// The pads' solimp is near 1 because MuJoCo's friction creeps otherwise: with the default an object sinks by
/// millimetres a second between the claws, with this by 0.05 mm.
std::string clawXml(const std::string& prefix, const char* name, int side) {
    return fmt::format(
        R"(<body pos="{x} {y} {z}"><joint name="{prefix}{name}" type="slide" axis="{side} 0 0" range="0 {travel}" limited="true" armature="{armature}"/>
<geom type="box" pos="{pad} 0 {middle}" size="0.0045 0.010 0.016" rgba="0.20 0.22 0.30 1" mass="{mass}" group="1" contype="1" conaffinity="0" condim="4" friction="2 0.05 0.001" solref="0.01 1" solimp="0.9995 0.9999 0.0005" priority="1"/>
</body>
)",
        fmt::arg("x", kClaws_m[0]), fmt::arg("y", kClaws_m[1]), fmt::arg("z", kClaws_m[2]),
        fmt::arg("prefix", prefix), fmt::arg("name", name), fmt::arg("side", side),
        fmt::arg("travel", kClawTravel_m), fmt::arg("armature", kClawGains.armature),
        fmt::arg("pad", side * (kClawInner_m + 0.0045)), fmt::arg("middle", kGraspPoint_m),
        fmt::arg("mass", kClawMass_kg));
}

}  // namespace

DeviceModel cytonModel(const std::string& prefix, const DevicePlacement& at) {
    DeviceModel arm{.mjcf = {}, .root = prefix + "base"};
    auto& xml = arm.mjcf;
    xml = fmt::format(
        R"(<worldbody>
<body name="{}base" pos="{} {} {}" euler="0 0 {}">
<geom type="cylinder" pos="0 0 0.006" size="0.085 0.006" rgba="0.13 0.13 0.15 1" mass="{}" group="1" contype="1" conaffinity="0"/>
<geom type="cylinder" pos="0 0 0.048" size="0.055 0.0365" rgba="0.75 0.76 0.78 1" mass="{}" group="1" contype="1" conaffinity="0"/>
)",
        prefix, at.x, at.y, at.z.value_or(0), at.theta, kBaseMass_kg / 2, kBaseMass_kg / 2);
    for (std::size_t i = 0; i < kChain.size(); ++i) {
        const auto& joint = kChain[i];
        xml += fmt::format(
            R"(<body{} pos="{} {} {}"><joint name="{}{}" type="hinge" axis="{} {} {}" range="{:.4f} {:.4f}" limited="true" armature="{}" damping="0.02"/>
)",
            i + 1 == kChain.size() ? fmt::format(R"( name="{}hand")", prefix) : "", joint.offset_m[0],
            joint.offset_m[1], joint.offset_m[2], prefix, joint.name, joint.axis[0], joint.axis[1],
            joint.axis[2], -joint.limit_rad / kDegree, joint.limit_rad / kDegree, kGains[i].armature);
        xml += linkGeoms(i);
    }
    xml += fmt::format(R"(<site name="{}tcp" pos="{} {} {}" size="0.003" group="5"/>)"
                       "\n",
                       prefix, kClaws_m[0], kClaws_m[1], kClaws_m[2] + kGraspPoint_m);
    xml += clawXml(prefix, "claw_right", 1) + clawXml(prefix, "claw_left", -1);
    for (std::size_t i = 0; i <= kChain.size(); ++i) xml += "</body>";
    xml += "\n</worldbody>\n<actuator>\n";
    const auto servo = [&](const char* name, const Gains& gains, double force) {
        xml += fmt::format(
            R"(<general name="{0}{1}" joint="{0}{1}" gaintype="fixed" biastype="affine" gainprm="{2}" biasprm="0 -{2} -{3}" forcelimited="true" forcerange="-{4} {4}" ctrllimited="false"/>)"
            "\n",
            prefix, name, gains.kp, gains.kv, force);
    };
    for (std::size_t i = 0; i < kChain.size(); ++i) servo(kChain[i].name, kGains[i], kChain[i].torque_nm);
    servo("claw_right", kClawGains, kClawForce_n);
    // One servo moves both claws, by gears.
    xml += fmt::format(
        R"(</actuator>
<equality><joint joint1="{0}claw_left" joint2="{0}claw_right" polycoef="0 1 0 0 0" solref="0.01 1"/></equality>
)",
        prefix);
    for (const auto& joint : kChain) arm.joints.push_back(prefix + joint.name);
    arm.joints.push_back(prefix + "claw_right");
    arm.actuators = arm.joints;
    arm.joints.push_back(prefix + "claw_left");
    arm.sites = {prefix + "tcp"};
    return arm;
}

CytonBody::CytonBody(const DeviceParts& parts) : parts_(parts) {}

void CytonBody::setTargets(const Positions& targets) {
    const double dt = parts_.model->opt.timestep;
    for (std::size_t i = 0; i < targets.size(); ++i) {
        const bool claw = i == kJoints;
        const double least = claw ? 0 : -kChain[i].limit_rad;
        const double most = claw ? kClawTravel_m : kChain[i].limit_rad;
        const double target = std::clamp(targets[i], least, most);
        // The servo damps the difference to the speed it is to have, not the speed: otherwise it would lag
        // behind by kv / kp seconds. A jump is no speed.
        const double fastest = kServos[i].fastest_us_per_s * std::abs(kServos[i].scale);
        const double speed = moved_before_ ? std::clamp((target - last_[i]) / dt, -fastest, fastest) : 0;
        const auto& gains = claw ? kClawGains : kGains[i];
        parts_.data->ctrl[parts_.actuators[i]] = target + speed * gains.kv / gains.kp;
        last_[i] = target;
    }
    moved_before_ = true;
    for (const int joint : parts_.joints) {
        const int dof = parts_.model->jnt_dofadr[joint];
        parts_.data->qfrc_applied[dof] = parts_.data->qfrc_bias[dof];
    }
}

CytonBody::Positions CytonBody::positions() const {
    Positions now{};
    for (std::size_t i = 0; i < now.size(); ++i)
        now[i] = parts_.data->qpos[parts_.model->jnt_qposadr[parts_.joints[i]]];
    return now;
}

std::array<double, 3> CytonBody::graspPoint() const {
    const mjtNum* at = parts_.data->site_xpos + 3 * parts_.sites[0];
    return {at[0], at[1], at[2]};
}

void CytonBody::place(const Positions& positions) {
    for (std::size_t i = 0; i < parts_.joints.size(); ++i) {
        const double value = positions[std::min<std::size_t>(i, kJoints)];
        parts_.data->qpos[parts_.model->jnt_qposadr[parts_.joints[i]]] = value;
        parts_.data->qvel[parts_.model->jnt_dofadr[parts_.joints[i]]] = 0;
    }
    moved_before_ = false;
    setTargets(positions);
}

CytonBody::Positions CytonBody::home() {
    Positions home{};
    for (std::size_t i = 0; i < home.size(); ++i) home[i] = kServos[i].value(kServos[i].home_us);
    return home;
}

}  // namespace axon::lab
