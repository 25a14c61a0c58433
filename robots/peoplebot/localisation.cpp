// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/localisation.hpp"

#include <mrpt/bayes/CParticleFilter.h>
#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/obs/CActionCollection.h>
#include <mrpt/obs/CActionRobotMovement2D.h>
#include <mrpt/obs/CObservation2DRangeScan.h>
#include <mrpt/obs/CSensoryFrame.h>
#include <mrpt/random.h>
#include <mrpt/slam/CMonteCarloLocalization2D.h>

#include <cmath>
#include <numbers>

#include "robots/peoplebot/body.hpp"

namespace axon::peoplebot {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kMetre = 1000;
constexpr double kReach_mm = 15900;  // an LMS-200 that counts millimetres sees 8 or 16 m
constexpr double kAtWall_mm = 150;
// Scans are taken in after so much motion, and the first ones wherever the robot stands.
constexpr double kStep_mm = 60;
constexpr double kStep_deg = 3;
constexpr int kFirstScans = 3;
// How likely a reading is that ends at a wall of the map, and how likely one that does not. The second is
// large enough that much furniture before a wall does not outweigh what is seen of the wall. At a quarter of
// it, a bookcase 0.5 m before a wall is taken for the wall.
constexpr float kHitsWall = 0.85F;
constexpr float kEndsElsewhere = 0.2F;

}  // namespace

double fitOf(const FloorPlan& plan, const arcos::LaserScan& scan, const MapPose& pose) {
    const auto laser = pose.then({body::kLaserX_mm, 0, 0});
    int seen = 0;
    int explained = 0;
    for (std::size_t i = 0; i < scan.ranges_mm.size(); ++i) {
        const double range = scan.ranges_mm[i];
        if (!(range > 0 && range < kReach_mm)) continue;
        const double a =
            (laser.heading_deg + scan.start_deg + static_cast<double>(i) * scan.step_deg) * kDegree;
        const mapper3::Point end{laser.x_mm + range * std::cos(a), laser.y_mm + range * std::sin(a)};
        ++seen;
        explained += plan.contains(end) && plan.wallDistance_mm(end) <= kAtWall_mm ? 1 : 0;
    }
    return seen == 0 ? 0 : static_cast<double>(explained) / seen;
}

/// What is MRPT's.
struct Localisation::Filter {
    mrpt::maps::COccupancyGridMap2D::Ptr grid;
    mrpt::slam::CMonteCarloLocalization2D particles{kParticles};
    mrpt::bayes::CParticleFilter algorithm;
    // The grid has a frame of its own, with the origin in its corner: MRPT rounds a grid's edges to whole
    // cells.
    double left_mm = 0;
    double bottom_mm = 0;

    mrpt::math::TPose2D inGrid(const MapPose& pose) const {
        return {(pose.x_mm - left_mm) / kMetre, (pose.y_mm - bottom_mm) / kMetre, pose.heading_deg * kDegree};
    }
    MapPose onMap(double x, double y, double phi) const {
        return {left_mm + x * kMetre, bottom_mm + y * kMetre, phi / kDegree};
    }
};

Localisation::Localisation(std::shared_ptr<const FloorPlan> plan, const Start& start,
                           const arcos::RobotState& robot, unsigned seed)
    : plan_(std::move(plan)), filter_(std::make_unique<Filter>()) {
    filter_->left_mm = plan_->left_mm();
    filter_->bottom_mm = plan_->bottom_mm();
    const double cell = FloorPlan::kCell_mm / kMetre;
    filter_->grid = mrpt::maps::COccupancyGridMap2D::Create(0.0F, static_cast<float>(plan_->width() * cell),
                                                            0.0F, static_cast<float>(plan_->height() * cell),
                                                            static_cast<float>(cell));
    auto& grid = *filter_->grid;
    const auto columns = static_cast<std::size_t>(plan_->width());
    for (std::size_t i = 0; i < plan_->walls().size(); ++i)
        grid.setCell(static_cast<int>(i % columns), static_cast<int>(i / columns),
                     plan_->walls()[i] != 0 ? 0.02F : 0.98F);
    auto& likelihood = grid.likelihoodOptions;
    likelihood.likelihoodMethod = mrpt::maps::COccupancyGridMap2D::lmLikelihoodField_Thrun;
    likelihood.LF_decimation = 3;
    likelihood.LF_stdHit = 0.12F;
    likelihood.LF_maxCorrsDistance = 0.5F;
    likelihood.LF_maxRange = static_cast<float>(kReach_mm / kMetre);
    likelihood.LF_zHit = kHitsWall;
    likelihood.LF_zRandom = kEndsElsewhere * likelihood.LF_maxRange;  // MRPT divides by it
    filter_->particles.options.metricMap = filter_->grid;
    auto& options = filter_->algorithm.m_options;
    options.PF_algorithm = mrpt::bayes::CParticleFilter::pfStandardProposal;
    options.resamplingMethod = mrpt::bayes::CParticleFilter::prSystematic;
    options.adaptiveSampleSize = false;
    options.sampleSize = kParticles;
    options.BETA = 0.5;
    // Beams next to each other see the same wall: sixty of them are not sixty witnesses.
    options.powFactor = 0.3;

    auto& random = mrpt::random::getRandomGenerator();
    random.randomize(seed);
    for (auto& particle : filter_->particles.m_particles) {
        particle.d = filter_->inGrid({random.drawGaussian1D(start.pose.x_mm, start.spread_mm),
                                      random.drawGaussian1D(start.pose.y_mm, start.spread_mm),
                                      random.drawGaussian1D(start.pose.heading_deg, start.spread_deg)});
        particle.log_w = 0;
    }
    odometry_ = filter_odometry_ = {robot.x_mm, robot.y_mm, robot.heading_deg};
    estimate_ = {.pose = start.pose, .spread_mm = start.spread_mm, .spread_deg = start.spread_deg};
    if (robot.laser) last_scan_ = robot.laser->sequence;
}

Localisation::~Localisation() = default;

void Localisation::update(const arcos::RobotState& robot) {
    odometry_ = {robot.x_mm, robot.y_mm, robot.heading_deg};
    if (!robot.laser || robot.laser->sequence == last_scan_ || robot.laser->ranges_mm.size() < 2) return;
    const auto& scan = *robot.laser;
    last_scan_ = scan.sequence;
    const double way = std::hypot(scan.x_mm - filter_odometry_.x_mm, scan.y_mm - filter_odometry_.y_mm);
    const double turn = std::abs(scan.heading_deg - filter_odometry_.heading_deg);
    estimate_.scan_taken = scan.taken;
    if (way < kStep_mm && turn < kStep_deg && estimate_.scans >= kFirstScans) return;
    weigh(scan);
}

void Localisation::weigh(const arcos::LaserScan& scan) {
    const MapPose now{scan.x_mm, scan.y_mm, scan.heading_deg};
    const auto step = filter_odometry_.between(now);
    filter_odometry_ = now;

    mrpt::obs::CActionRobotMovement2D movement;
    mrpt::obs::CActionRobotMovement2D::TMotionModelOptions model;
    // Not Thrun's model: it splits a turn on the spot, in which the axle moves a millimetre, into two large
    // turns towards that millimetre, and makes far too much noise of them.
    model.modelSelection = mrpt::obs::CActionRobotMovement2D::mmGaussian;
    model.gaussianModel.a1 = 0.05;
    model.gaussianModel.a2 = 0.03;
    model.gaussianModel.a3 = 3 * kDegree;
    model.gaussianModel.a4 = 0.08;
    model.gaussianModel.minStdXY = 0.008;
    model.gaussianModel.minStdPHI = 0.4 * kDegree;
    movement.computeFromOdometry(
        mrpt::poses::CPose2D(step.x_mm / kMetre, step.y_mm / kMetre, step.heading_deg * kDegree), model);
    mrpt::obs::CActionCollection action;
    action.insert(movement);

    auto observation = mrpt::obs::CObservation2DRangeScan::Create();
    const auto beams = scan.ranges_mm.size();
    const double width_deg = scan.step_deg * static_cast<double>(beams - 1);
    observation->aperture = static_cast<float>(width_deg * kDegree);
    observation->rightToLeft = true;
    observation->maxRange = static_cast<float>(kReach_mm / kMetre);
    observation->sensorPose = mrpt::poses::CPose3D(body::kLaserX_mm / kMetre, 0, 0,
                                                   (scan.start_deg + width_deg / 2) * kDegree, 0, 0);
    observation->resizeScan(beams);
    for (std::size_t i = 0; i < beams; ++i) {
        const bool valid = scan.ranges_mm[i] > 0 && scan.ranges_mm[i] < kReach_mm;
        observation->setScanRange(i, static_cast<float>(scan.ranges_mm[i] / kMetre));
        observation->setScanRangeValidity(i, valid);
    }
    mrpt::obs::CSensoryFrame frame;
    frame.insert(observation);
    filter_->algorithm.executeOn(filter_->particles, &action, &frame);

    const auto [covariance, mean] = filter_->particles.getCovarianceAndMean();
    estimate_.pose = filter_->onMap(mean.x(), mean.y(), mean.phi());
    estimate_.spread_mm = std::sqrt(covariance(0, 0) + covariance(1, 1)) * kMetre;
    estimate_.spread_deg = std::sqrt(covariance(2, 2)) / kDegree;
    ++estimate_.scans;
    estimate_.fit = fitOf(*plan_, scan, estimate_.pose);
}

Estimate Localisation::estimate() const {
    auto estimate = estimate_;
    estimate.pose = estimate_.pose.then(filter_odometry_.between(odometry_));
    estimate.pose.heading_deg = std::remainder(estimate.pose.heading_deg, 360.0);
    return estimate;
}

std::vector<MapPose> Localisation::particles(std::size_t most) const {
    const auto& all = filter_->particles.m_particles;
    const auto since = filter_odometry_.between(odometry_);
    const std::size_t every = std::max<std::size_t>(1, all.size() / std::max<std::size_t>(1, most));
    std::vector<MapPose> some;
    for (std::size_t i = 0; i < all.size() && some.size() < most; i += every)
        some.push_back(filter_->onMap(all[i].d.x, all[i].d.y, all[i].d.phi).then(since));
    return some;
}

}  // namespace axon::peoplebot
