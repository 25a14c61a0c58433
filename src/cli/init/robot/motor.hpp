// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <cmath>

/// A simulated motor: replace it by the driver of your robot. One thread at a time.
class Motor {
  public:
    void moveTo(double target_mm, double speed_mm_per_s) {
        target_ = target_mm;
        speed_ = speed_mm_per_s;
    }
    /// Stands still at once.
    void stop() { target_ = position_; }
    /// Moves as far as it comes in this time, and not beyond the target.
    void advance(double seconds) {
        const double step = std::abs(speed_) * seconds;
        position_ += std::clamp(target_ - position_, -step, step);
    }
    double position() const { return position_; }
    bool arrived() const { return position_ == target_; }

  private:
    double position_ = 0, target_ = 0, speed_ = 0;
};
