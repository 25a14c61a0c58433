// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/cyton/body.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <mujoco/mujoco.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <numbers>
#include <optional>
#include <random>

#include "lab/cyton/ssc32_server.hpp"

namespace axon::lab {
namespace {

using Positions = CytonBody::Positions;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kTable = 0.66;
constexpr double kPlatform = 0.10;  // above the table
constexpr double kHalfHeight = 0.04;

struct Model {
    explicit Model(const std::string& xml) {
        const auto files = std::make_unique<mjVFS>();
        mj_defaultVFS(files.get());
        mj_makeEmptyFileVFS(files.get(), "test.xml", static_cast<int>(xml.size()));
        std::memcpy(files->filedata[mj_findFileVFS(files.get(), "test.xml")], xml.data(), xml.size());
        std::array<char, 1000> error{};
        model.reset(mj_loadXML("test.xml", files.get(), error.data(), static_cast<int>(error.size())));
        mj_deleteVFS(files.get());
        if (!model) throw std::runtime_error(error.data());
        data.reset(mj_makeData(model.get()));
    }
    struct Free {
        void operator()(mjModel* m) const { mj_deleteModel(m); }
        void operator()(mjData* d) const { mj_deleteData(d); }
    };
    std::unique_ptr<mjModel, Free> model;
    std::unique_ptr<mjData, Free> data;
};

DeviceModel arm(const std::string& prefix) {
    return cytonModel(prefix, {.kind = "cyton", .x = 1, .y = 1, .z = kTable, .theta = 90});
}

std::string world(double object_x, double object_y) {
    return fmt::format(
               R"(<mujoco><compiler angle="degree" eulerseq="xyz"/><option timestep="0.004"/>
<worldbody><geom type="plane" size="0 0 1"/>
<geom type="box" pos="1 1 {}" size="0.5 0.4 0.015"/>
<geom type="box" pos="{} {} {}" size="0.05 0.05 {}"/>
<body name="object" pos="{} {} {}"><freejoint/><geom type="box" size="0.014 0.014 0.04" mass="0.06"/></body>
</worldbody>)",
               kTable - 0.015, object_x, object_y, kTable + kPlatform / 2, kPlatform / 2, object_x, object_y,
               kTable + kPlatform + kHalfHeight) +
           arm("a_").mjcf + "</mujoco>";
}

class CytonTest : public ::testing::Test {
  protected:
    // In front of an arm that looks along y, a little to its right, 0.378 m from it.
    static constexpr std::array<double, 2> kObject{1.1, 1.365};

    CytonTest() {
        arm_.place(CytonBody::home());
        mj_forward(world_.model.get(), world_.data.get());
    }

    void pass(double seconds) {
        for (double t = 0; t < seconds; t += 0.004) {
            board_.step(std::chrono::milliseconds{4});
            arm_.setTargets(board_.targets());
            mj_step(world_.model.get(), world_.data.get());
        }
    }
    std::string tell(const std::string& text) {
        const auto answers = board_.receive(std::vector<std::uint8_t>(text.begin(), text.end()));
        return {answers.begin(), answers.end()};
    }
    /// Moves by bytes alone and waits as a client does, by Q.
    void moveTo(const Positions& joints, double claw_m, int time_ms) {
        std::string line;
        for (std::size_t i = 0; i < cyton::kServos.size(); ++i) {
            const double value = i == 7 ? claw_m : joints[i];
            line += fmt::format("#{}P{}", i, std::lround(cyton::kServos[i].pulse_us(value)));
        }
        tell(line + fmt::format("T{}\r", time_ms));
        do {
            pass(0.02);
        } while (tell("Q\r") == "+");
        pass(0.3);
    }
    std::array<double, 3> object() const {
        const int id = mj_name2id(world_.model.get(), mjOBJ_BODY, "object");
        const mjtNum* at = world_.data->xpos + 3 * id;
        return {at[0], at[1], at[2]};
    }
    double uprightness() const {
        return world_.data->xmat[9 * mj_name2id(world_.model.get(), mjOBJ_BODY, "object") + 8];
    }

    /// Angles that bring the middle of the claws to a place, pointing outwards from the arm and `down_deg`
    /// below the horizon, the claws closing sideways: damped least squares on MuJoCo's Jacobian, from random
    /// starts, until within limits.
    static std::optional<Positions> reach(double x, double y, double z, double down_deg) {
        Model scratch(world(0.0, 0.0));
        auto* m = scratch.model.get();
        auto* d = scratch.data.get();
        const auto parts = partsOf(arm("a_"), m, d);
        CytonBody body(parts);
        const int site = parts.sites[0];
        const double out = std::hypot(x - 1, y - 1);
        const double ox = (x - 1) / out;
        const double oy = (y - 1) / out;
        const double c = std::cos(down_deg * kDegree);
        const double s = std::sin(down_deg * kDegree);
        // Columns: x sideways, z where the claws point, y their cross product.
        const std::array<mjtNum, 9> wanted{oy, -ox * s, ox * c, -ox, -oy * s, oy * c, 0, -c, -s};
        std::mt19937 random(1);
        for (int attempt = 0; attempt < 60; ++attempt) {
            Positions q{0, 0.6, 0, 1.2, 0, 1.0, 0, 0};
            for (int i = 0; attempt > 0 && i < cyton::kJoints; ++i)
                q[static_cast<std::size_t>(i)] += std::uniform_real_distribution(-0.8, 0.8)(random);
            for (int step = 0; step < 200; ++step) {
                body.place(q);
                mj_kinematics(m, d);
                mj_comPos(m, d);
                const mjtNum* at = d->site_xpos + 3 * site;
                const mjtNum* r = d->site_xmat + 9 * site;
                std::array<double, 6> error{x - at[0], y - at[1], z - at[2], 0, 0, 0};
                for (int axis = 0; axis < 3; ++axis) {
                    const std::array<mjtNum, 3> now{r[axis], r[3 + axis], r[6 + axis]};
                    const std::array<mjtNum, 3> then{wanted[static_cast<std::size_t>(axis)],
                                                     wanted[static_cast<std::size_t>(3 + axis)],
                                                     wanted[static_cast<std::size_t>(6 + axis)]};
                    std::array<mjtNum, 3> turn{};
                    mju_cross(turn.data(), now.data(), then.data());
                    for (std::size_t k = 0; k < 3; ++k) error[3 + k] += turn[k] / 2;
                }
                if (std::hypot(error[0], error[1], error[2]) < 2e-4 &&
                    std::hypot(error[3], error[4], error[5]) < 2e-3)
                    return q;
                std::vector<mjtNum> jacobian(static_cast<std::size_t>(6 * m->nv));
                mj_jacSite(m, d, jacobian.data(), jacobian.data() + 3 * m->nv, site);
                // J^T (J J^T + damping)^-1 e, by Cholesky.
                std::array<int, cyton::kJoints> dof{};
                for (std::size_t i = 0; i < dof.size(); ++i) dof[i] = m->jnt_dofadr[parts.joints[i]];
                std::array<mjtNum, 36> square{};
                for (int a = 0; a < 6; ++a)
                    for (int b = 0; b < 6; ++b) {
                        for (const int k : dof)
                            square[static_cast<std::size_t>(6 * a + b)] +=
                                jacobian[static_cast<std::size_t>(a * m->nv + k)] *
                                jacobian[static_cast<std::size_t>(b * m->nv + k)];
                        if (a == b) square[static_cast<std::size_t>(6 * a + b)] += 1e-4;
                    }
                mju_cholFactor(square.data(), 6, 1e-12);
                std::array<mjtNum, 6> solved{};
                mju_cholSolve(solved.data(), square.data(), error.data(), 6);
                for (std::size_t i = 0; i < dof.size(); ++i) {
                    double change = 0;
                    for (int a = 0; a < 6; ++a)
                        change += jacobian[static_cast<std::size_t>(a * m->nv + dof[i])] *
                                  solved[static_cast<std::size_t>(a)];
                    q[i] = std::clamp(q[i] + std::clamp(change, -0.3, 0.3), -cyton::kChain[i].limit_rad,
                                      cyton::kChain[i].limit_rad);
                }
            }
        }
        return std::nullopt;
    }

    Model world_{world(kObject[0], kObject[1])};
    Ssc32Server board_;
    CytonBody arm_{partsOf(arm("a_"), world_.model.get(), world_.data.get())};
};

TEST_F(CytonTest, AtZeroItPointsStraightUpWithTheLengthsOfTheUrdf) {
    arm_.place(Positions{});
    mj_forward(world_.model.get(), world_.data.get());
    const auto tip = arm_.graspPoint();
    EXPECT_NEAR(tip[2] - kTable, 0.518 + 0.0555 + 0.0095, 0.001);
    EXPECT_NEAR(std::hypot(tip[0] - 1, tip[1] - 1), 0.0093, 0.001);
}

TEST_F(CytonTest, APositivePitchLeansForwardsAndAPositiveRollTurnsClockwise) {
    arm_.place(Positions{0, 0.5, 0, 0.5, 0, 0, 0, 0});
    mj_forward(world_.model.get(), world_.data.get());
    EXPECT_GT(arm_.graspPoint()[1], 1.2);  // theta is 90: forwards is y
    arm_.place(Positions{1.5, 0.5, 0, 0.5, 0, 0, 0, 0});
    mj_forward(world_.model.get(), world_.data.get());
    EXPECT_GT(arm_.graspPoint()[0], 1.2);
}

TEST_F(CytonTest, HoldsItsHomeAgainstGravity) {
    const auto before = CytonBody::home();
    pass(3);
    const auto after = arm_.positions();
    for (std::size_t i = 0; i < before.size(); ++i) EXPECT_NEAR(after[i], before[i], 0.0015) << i;
}

TEST_F(CytonTest, AnArmThatIsNotThereIsRefused) {
    EXPECT_THROW(partsOf(arm("b_"), world_.model.get(), world_.data.get()), std::invalid_argument);
}

TEST_F(CytonTest, ByBytesAloneItLiftsAnObjectFromAPlatformAndStandsItOnTheTable) {
    pass(0.3);
    const double open = 0.0165;
    const double grip = kTable + kPlatform + 0.055;  // where it is held, above the middle
    const auto above = reach(kObject[0], kObject[1], grip + 0.07, 40);
    const auto at = reach(kObject[0], kObject[1], grip, 40);
    const double place_x = 1 - 0.17;
    const double place_y = 1 + std::sqrt(0.38 * 0.38 - 0.17 * 0.17);
    const auto over = reach(place_x, place_y, grip + 0.07, 40);
    const auto down = reach(place_x, place_y, grip - kPlatform + 0.001, 40);
    ASSERT_TRUE(above && at && over && down);

    moveTo(*above, open, 2000);
    moveTo(*at, open, 1000);
    EXPECT_NEAR(object()[2], kTable + kPlatform + kHalfHeight, 0.002);
    moveTo(*at, 0.010, 800);
    moveTo(*above, 0.010, 1000);
    EXPECT_GT(object()[2], kTable + kPlatform + kHalfHeight + 0.06) << "it was not lifted";
    pass(3);
    EXPECT_GT(object()[2], kTable + kPlatform + kHalfHeight + 0.06) << "it slipped";
    moveTo(*over, 0.010, 1500);
    moveTo(*down, 0.010, 1500);
    moveTo(*down, open, 800);
    moveTo(*over, open, 1000);
    pass(1);
    EXPECT_NEAR(object()[0], place_x, 0.01);
    EXPECT_NEAR(object()[1], place_y, 0.01);
    EXPECT_NEAR(object()[2], kTable + kHalfHeight, 0.002);
    EXPECT_GT(uprightness(), 0.999);
}

TEST_F(CytonTest, HowFarItReachesDependsOnHowSteepTheClawsPoint) {
    const double z = kTable + 0.055;
    EXPECT_TRUE(reach(1, 1.38, z, 40));
    EXPECT_FALSE(reach(1, 1.26, z, 40));
    EXPECT_TRUE(reach(1, 1.32, z, 90));
    EXPECT_FALSE(reach(1, 1.40, z, 90));
    EXPECT_FALSE(reach(1, 1.32, z + 0.13, 90)) << "not straight down from above";
}

}  // namespace
}  // namespace axon::lab
