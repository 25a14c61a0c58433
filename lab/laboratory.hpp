// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <vector>

#include "lab/lms_server.hpp"
#include "lab/physics.hpp"

namespace axon::lab {

/// A whole virtual laboratory without sockets and clocks: the physics with its devices, and for each
/// robot its controller. Bytes of clients come in, bytes of robots go out, and time passes only in step().
/// The same laboratory runs behind TCP in real time (LabServer) and in tests as fast as it can. Threads:
/// none, not thread-safe.
class Laboratory {
  public:
    /// What robot number k tells its client. Must not call back into the laboratory.
    using Send = std::function<void(std::size_t robot, const arcos::Bytes& bytes)>;
    using Options = Physics::Options;
    /// The robots' lasers on lines of their own, as LMS-200s.
    struct LaserLines {
        Send send;            ///< the scans of robot k's laser; none: lasers speak through their robots
        bool serial = false;  ///< and the lines have speeds
    };

    /// Throws BadDescription.
    Laboratory(const WorldDescription& world, Send send) : Laboratory(world, std::move(send), Options()) {}
    Laboratory(const WorldDescription& world, Send send, const Options& options)
        : Laboratory(world, std::move(send), options, LaserLines()) {}
    Laboratory(const WorldDescription& world, Send send, const Options& options, const LaserLines& lasers);
    ~Laboratory();
    Laboratory(const Laboratory&) = delete;
    Laboratory& operator=(const Laboratory&) = delete;

    /// Advances the world by Physics::kPeriod.
    void step();
    /// The laboratory's own time, which began at the construction.
    TimePoint now() const { return now_; }
    Duration age() const { return now_ - TimePoint{}; }

    std::size_t robots() const { return controllers_.size(); }
    /// A robot's line. It answers through Send, at once or within a later step().
    ClientLine& robot(std::size_t index);
    const ArcosServer& controller(std::size_t robot) const;
    /// With LaserLines only: the line of a robot's laser. An answer to a change of speed still has the old
    /// one; scans come through LaserLines::send.
    ClientLine& laser(std::size_t robot);
    Truth truth(std::size_t robot) const { return physics_.truth(robot); }

    /// Of the world's devices, in its order.
    Device& device(std::size_t index) { return physics_.device(index); }
    const Device& device(std::size_t index) const { return physics_.device(index); }

    /// Ground truth, obstacles, faults, placing: for experimenters and judges. Between steps only.
    Physics& physics() { return physics_; }
    const Physics& physics() const { return physics_; }
    /// The world as it was in the beginning. Sessions, motions and now() go on, as when robots are carried
    /// back; devices are switched off and on.
    void reset();

  private:
    struct Controller;
    Physics physics_;
    TimePoint now_{};
    std::vector<std::unique_ptr<Controller>> controllers_;
};

}  // namespace axon::lab
