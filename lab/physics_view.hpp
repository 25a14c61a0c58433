// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "lab/physics.hpp"

namespace axon::lab {

/// The world for whoever draws it, perhaps in another thread. That thread has a model and data of its own
/// (mj_copyModel(nullptr, model()), mj_makeData); copyTo() brings both up to date and belongs to the thread
/// that steps the physics, or to a moment when nobody does. All geometry groups are to be drawn
/// (mjvOption::geomgroup), range finder rays are not (mjVIS_RANGEFINDER). Good as long as the Physics is.
class PhysicsView {
  public:
    explicit PhysicsView(const Physics& physics) : physics_(physics) {}

    const mjModel* model() const;
    /// Where everything is, how large obstacles are and how far cameras zoom. After it mjv_updateScene can be
    /// called at once.
    void copyTo(mjModel* model, mjData* data) const;

    /// Of a robot, in the model. The camera that sees the whole room is kOverview (description.hpp).
    const std::string& cameraName(std::size_t robot) const;

  private:
    const Physics& physics_;
};

}  // namespace axon::lab
