// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/blob_finder.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace axon::peoplebot {
namespace {

struct HueRange {
    Colour colour;
    const char* name;
    char channel;
    int from;  // OpenCV's hue: 0 to 179, two degrees each; from > to goes over the end
    int to;
};
constexpr std::array<HueRange, 5> kHues{{{Colour::Red, "red", '1', 172, 7},
                                         {Colour::Orange, "orange", '5', 8, 19},
                                         {Colour::Yellow, "yellow", '4', 20, 35},
                                         {Colour::Green, "green", '2', 38, 88},
                                         {Colour::Blue, "blue", '3', 95, 132}}};
constexpr int kLeastSaturation = 130;  // walls, skin and most wood are paler
constexpr int kLeastBrightness = 40;

const HueRange& hueOf(Colour colour) {
    return *std::find_if(kHues.begin(), kHues.end(), [&](const auto& hue) { return hue.colour == colour; });
}

}  // namespace

std::optional<Colour> parseColour(std::string_view text) {
    std::string lower(text);
    std::transform(lower.begin(), lower.end(), lower.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    for (const auto& hue : kHues) {
        if (lower == hue.name || lower == std::string_view(&hue.channel, 1)) return hue.colour;
    }
    return std::nullopt;
}

const char* toString(Colour colour) {
    return hueOf(colour).name;
}

std::string knownColours() {
    std::string names;
    for (const auto& hue : kHues)
        names += std::string(names.empty() ? "" : hue.colour == Colour::Blue ? " or " : ", ") + hue.name;
    auto hues = kHues;
    std::sort(hues.begin(), hues.end(),
              [](const auto& one, const auto& other) { return one.channel < other.channel; });
    names += " (or their channels";
    for (const auto& hue : hues) names += std::string(", ") + hue.channel + ' ' + hue.name;
    return names + ')';
}

std::vector<Blob> findBlobs(const CameraPicture& picture, Colour colour, int least_area) {
    // OpenCV's constructor wants a pointer to non-const; nothing here writes through it.
    const cv::Mat rgb(picture.height, picture.width, CV_8UC3, const_cast<std::uint8_t*>(picture.rgb.data()));
    cv::Mat hsv;
    cv::cvtColor(rgb, hsv, cv::COLOR_RGB2HSV);
    const auto within = [&hsv](int from, int to) {
        cv::Mat mask;
        cv::inRange(hsv, cv::Scalar(from, kLeastSaturation, kLeastBrightness), cv::Scalar(to, 255, 255),
                    mask);
        return mask;
    };
    const auto& hue = hueOf(colour);
    cv::Mat mask = hue.from <= hue.to ? within(hue.from, hue.to) : within(hue.from, 179) | within(0, hue.to);
    // Opening takes single pixels away; closing first would let noise grow together.
    cv::morphologyEx(mask, mask, cv::MORPH_OPEN, cv::getStructuringElement(cv::MORPH_CROSS, {3, 3}));
    cv::Mat labels;
    cv::Mat stats;
    cv::Mat centroids;
    const int count = cv::connectedComponentsWithStats(mask, labels, stats, centroids, 8, CV_32S);
    std::vector<Blob> blobs;
    for (int i = 1; i < count; ++i) {  // 0 is the background
        const int area = stats.at<int>(i, cv::CC_STAT_AREA);
        if (area < least_area) continue;
        const int left = stats.at<int>(i, cv::CC_STAT_LEFT);
        const int top = stats.at<int>(i, cv::CC_STAT_TOP);
        blobs.push_back({area, centroids.at<double>(i, 0), centroids.at<double>(i, 1), left, top,
                         left + stats.at<int>(i, cv::CC_STAT_WIDTH) - 1,
                         top + stats.at<int>(i, cv::CC_STAT_HEIGHT) - 1});
    }
    std::sort(blobs.begin(), blobs.end(), [](const Blob& a, const Blob& b) { return a.area > b.area; });
    return blobs;
}

}  // namespace axon::peoplebot
