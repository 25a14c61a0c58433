// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "lab/physics.hpp"

namespace axon::lab {

/// Red, green and blue bytes, the top row first.
struct Picture {
    int width = 0;
    int height = 0;
    std::vector<std::uint8_t> rgb;
};
using SharedPicture = std::shared_ptr<const Picture>;

/// A way that something went, drawn on the floor of a picture. Metres.
struct Track {
    std::array<float, 3> colour{1, 0.5F, 0};
    std::vector<std::array<double, 2>> points;
};

/// The cameras of a laboratory: every robot's own, and one that sees the whole room. Draws in software
/// (OSMesa, loaded when the first picture is wanted; no display needed), and only what somebody watches.
///
/// Between the physics and whoever shows pictures. The thread that steps the physics calls offer() after each
/// step; when a watched view is due, it copies the world's state and goes on, while a thread of this class,
/// the only one with a graphics context, draws it.
///
/// Threads: watch() and wantOne() from any thread; offer() and take() from the one that steps the physics;
/// on_picture runs on the drawing thread and must not block. The physics must outlive this. Failure: without
/// OSMesa there are no pictures; failure() tells why, and so does the future of take().
class Cameras {
  public:
    static constexpr int kWidth = 320;
    static constexpr int kHeight = 240;
    static constexpr Duration kPeriod = std::chrono::milliseconds{100};  // of the laboratory's time

    using OnPicture = std::function<void(std::size_t view, SharedPicture picture, Duration age)>;

    /// Views 0 to robots - 1 are the robots' cameras, view `robots` is the overview.
    Cameras(const Physics& physics, std::size_t robots, OnPicture on_picture);
    ~Cameras();
    Cameras(const Cameras&) = delete;
    Cameras& operator=(const Cameras&) = delete;

    std::size_t views() const { return robots_ + 1; }
    std::size_t overview() const { return robots_; }

    /// One more, or one less, wants each picture of a view: one per kPeriod.
    void watch(std::size_t view, bool more);
    /// The next one, also when the world is paused.
    void wantOne(std::size_t view);

    /// `keep_up` false: pictures that the drawing thread has no time for are left out. True: it is waited
    /// for, so that none is missing however fast the laboratory's time goes.
    void offer(Duration age, bool keep_up);
    using Use = std::function<void(Picture picture)>;
    /// One picture, 1280 x 960 for the overview, of the world as it is now, or at the first offer() after the
    /// drawing thread has become free. `use` gets it on the drawing thread and may take its time. The future
    /// is ready when `use` has returned; it throws std::runtime_error where there is no picture, and whatever
    /// `use` has thrown.
    std::future<void> take(std::size_t view, std::vector<Track> tracks, Use use);

    std::optional<std::string> failure() const;
    std::uint64_t drawn() const;
    std::uint64_t leftOut() const;

  private:
    class Studio;
    const std::size_t robots_;
    std::unique_ptr<Studio> studio_;
};

/// What files and links carry.
std::vector<std::uint8_t> encodeJpeg(const Picture& picture, int quality = 80);
std::vector<std::uint8_t> encodePng(const Picture& picture);
/// "P6", the size, and the bytes.
std::vector<std::uint8_t> encodePpm(const Picture& picture);
/// Throws std::runtime_error with the file's name.
void writePng(const std::string& path, const Picture& picture);

}  // namespace axon::lab
