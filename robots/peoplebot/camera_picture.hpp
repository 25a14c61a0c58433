// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/clock.hpp"

namespace axon::peoplebot {

/// One frame of the robot's camera. A value type.
struct CameraPicture {
    std::uint64_t sequence = 0;  ///< counts the frames that this program received, from 1
    TimePoint taken{};           ///< when its last byte arrived
    int width = 0;
    int height = 0;
    std::vector<std::uint8_t> rgb;  ///< row by row from the top left, three bytes a pixel
};

/// What the camera sends cannot be read; the connection is of no further use.
class BadPicture : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// Reads the body of the camera's GET /raw: binary PPM images (P6, 255), one after the other, without end;
/// the head of the HTTP response comes first. Keeps at most the newest whole picture: whoever is slow sees
/// fewer frames, never old ones. I/O-free, not thread-safe.
class PictureReader {
  public:
    static constexpr int kLargestSide = 2048;

    /// Throws BadPicture: another status than 200, or what is no PPM.
    void feed(std::span<const std::uint8_t> bytes, TimePoint now);
    /// The newest picture that was completed since the last call.
    std::optional<CameraPicture> take();
    /// For a new connection. The count of pictures goes on.
    void reset();

  private:
    bool readHead();
    bool readPicture(TimePoint now);

    std::vector<std::uint8_t> buffer_;
    bool head_read_ = false;
    std::uint64_t count_ = 0;
    std::optional<CameraPicture> newest_;
};

/// The picture made smaller, to at most the given size at its own proportions, by averaging. Never larger.
CameraPicture scaled(const CameraPicture& picture, int most_width, int most_height);
/// As JPEG. Quality 1 to 100. Throws BadPicture for a picture without pixels.
std::string toJpeg(const CameraPicture& picture, int quality = 75);

}  // namespace axon::peoplebot
