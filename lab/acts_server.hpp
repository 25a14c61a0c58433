// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "lab/camera.hpp"

namespace axon::lab {

/// The wire of ACTS, the colour tracker of the Pioneer robots, as its clients (ArACTS) read it. Pictures have
/// 160 x 120 points. A client sends '0' for the blobs of the latest picture, '1' to say goodbye. An answer is
/// 32 times the number of the channel's first blob and how many it has, and then 16 bytes per blob; numbers
/// are cut into 6 bits, highest first, and every byte is sent as its value plus one.
namespace acts {

inline constexpr int kChannels = 32;
inline constexpr std::size_t kMostBlobs = 10;  // of a channel
inline constexpr int kWidth = 160;
inline constexpr int kHeight = 120;

struct Blob {
    int area = 0;  ///< points
    int x = 0, y = 0;
    int left = 0, right = 0, top = 0, bottom = 0;
};
/// Each channel's blobs, the largest first.
using Blobs = std::array<std::vector<Blob>, kChannels>;

/// What the channels are trained for, from channel 1 on; the others see nothing.
inline constexpr std::array<std::string_view, 8> kColours{"red",    "green",  "blue", "yellow",
                                                          "orange", "purple", "cyan", "magenta"};

/// Connected areas of a channel's colour, of at least 4 points.
Blobs findBlobs(const Picture& picture);
std::vector<std::uint8_t> encode(const Blobs& blobs);

}  // namespace acts

/// One client's half of an ACTS server, without I/O. Threads: none.
class ActsServer {
  public:
    /// The bytes that answer all that was asked; nothing while there was no picture yet: they come from
    /// newPicture().
    std::vector<std::uint8_t> receive(std::span<const std::uint8_t> bytes);
    std::vector<std::uint8_t> newPicture(SharedPicture picture);
    bool quit() const { return quit_; }

  private:
    std::vector<std::uint8_t> answers();

    SharedPicture picture_;
    std::vector<std::uint8_t> encoded_;  // of picture_; empty: not yet looked for
    std::size_t asked_ = 0;
    bool quit_ = false;
};

}  // namespace axon::lab
