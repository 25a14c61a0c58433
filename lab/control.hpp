// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <future>
#include <optional>
#include <string>
#include <string_view>

#include "lab/laboratory.hpp"

namespace axon::lab {

/// What an experimenter does with the laboratory, as a protocol: one JSON object a line, answered by one JSON
/// object a line: {"ok":true, ...}, or {"ok":false,"error":"what was expected"}. For tests, judges and
/// pictures, never for robot applications. Metres and degrees; "name" is a robot's, a device's, an object's
/// or an obstacle's.
///
/// | "do" | further members | |
/// |---|---|---|
/// | "pause", "resume" | | time stands still; sessions and pictures go on |
/// | "speed" | "factor" | from 0.01 to 100 |
/// | "step" | "ms" | while paused: so much time passes as fast as it can; answered when it has passed |
/// | "reset" | | the world as it was in the beginning |
/// | "move" | "name", "x", "y", "z" (objects: of the underside), "theta" | what is left out stays |
/// | "block" | "name", "x", "y", "z", "dx", "dy", "height", "theta" | puts an obstacle into the way |
/// | "unblock" | "name" | |
/// | "fault", "mend" | "name", "kind", "which" | a robot's "dead-sonar", "stuck-gripper", "slipping-wheel"
/// (0 left, 1 right), "flat-battery"; an arm's "stuck-servo", "stuck-gripper" |
/// | "truth" | | where everything is and what it touches |
/// | "forget-touches" | | what the robots touched until now does not count |
/// | "picture" | "file" | the room from above, as PNG; answered when the file is written |
/// | "path" | "file" | the same with the ways that the robots went |
///
/// No I/O but the pictures' files; threads: none, belongs to the one that steps the laboratory.
class Control {
  public:
    /// What the owner of time and cameras does.
    class Operator {
      public:
        virtual ~Operator() = default;
        virtual void pause(bool paused) = 0;
        virtual bool paused() const = 0;
        virtual void setSpeed(double factor) = 0;
        virtual double speed() const = 0;
        virtual void reset() = 0;
        /// The world goes on meanwhile. The future is ready when the file is written; it throws
        /// std::runtime_error where that fails.
        virtual std::future<void> writePicture(const std::string& file, bool tracks) = 0;
    };

    /// `world` is completed, with the names of everything. All must outlive this.
    Control(Laboratory& laboratory, const WorldDescription& world, Operator& op)
        : laboratory_(laboratory), world_(world), operator_(op) {}

    struct Reply {
        std::string line;               ///< without the line's end
        std::optional<Duration> until;  ///< the laboratory's age at which it is to be sent; none: now
        std::future<void> work;         ///< where valid: it is to be sent when this is ready
    };
    Reply handle(std::string_view line);
    /// The answer in the place of a Reply's `line` whose `work` has thrown this.
    static std::string failed(const std::exception& error);
    /// The answer of "truth", also for --truth files.
    std::string truth() const;

  private:
    Laboratory& laboratory_;
    const WorldDescription& world_;
    Operator& operator_;
};

}  // namespace axon::lab
