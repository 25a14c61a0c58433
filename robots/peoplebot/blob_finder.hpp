// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "robots/peoplebot/camera_picture.hpp"

namespace axon::peoplebot {

enum class Colour { Red, Orange, Yellow, Green, Blue };

/// "red" and so on, in any case, or the number of the colour's ACTS channel, by which figure A.1 of the
/// thesis calls it: 1 red, 2 green, 3 blue, 4 yellow, 5 orange. Nothing for other words.
std::optional<Colour> parseColour(std::string_view text);
const char* toString(Colour colour);
/// For messages: the names, and what channels they have.
std::string knownColours();

/// A connected patch of one colour, in pixels from the top left.
struct Blob {
    int area = 0;
    double x = 0;  ///< centroid
    double y = 0;
    int left = 0;
    int top = 0;
    int right = 0;  ///< inclusive, as bottom
    int bottom = 0;

    int width() const { return right - left + 1; }
    int height() const { return bottom - top + 1; }
};

/// The smallest patch that counts as an object, in a picture of 320 x 240: 28 x 80 mm at 2.5 m have 50
/// pixels.
inline constexpr int kSignificantArea = 40;

/// The patches of a colour that have at least this area, the largest first. Hue decides, whatever the light;
/// too dark (below a sixth of full brightness) and too pale pixels have none. Single pixels and lines one
/// pixel wide are noise.
std::vector<Blob> findBlobs(const CameraPicture& picture, Colour colour, int least_area = kSignificantArea);

}  // namespace axon::peoplebot
