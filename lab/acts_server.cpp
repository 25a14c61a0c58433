// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/acts_server.hpp"

#include <algorithm>
#include <opencv2/imgproc.hpp>

namespace axon::lab {
namespace acts {
namespace {

constexpr int kLeastArea = 4;
constexpr int kLeastSaturation = 110;  // of 255
constexpr int kLeastBrightness = 45;

/// Channels' hues in OpenCV's halves of degrees, from `from` up to but without `to`.
struct Hues {
    int from, to;
};
constexpr std::array<Hues, kColours.size()> kHues{{
    Hues{172, 6},    // red, through 0
    Hues{38, 83},    // green
    Hues{100, 128},  // blue
    Hues{20, 38},    // yellow
    Hues{6, 20},     // orange
    Hues{128, 155},  // purple
    Hues{83, 100},   // cyan
    Hues{155, 172},  // magenta
}};

void push(std::vector<std::uint8_t>& to, int value, int digits) {
    for (int i = digits - 1; i >= 0; --i)
        to.push_back(static_cast<std::uint8_t>(((value >> (6 * i)) & 0x3F) + 1));
}

}  // namespace

Blobs findBlobs(const Picture& picture) {
    const cv::Mat full(picture.height, picture.width, CV_8UC3, const_cast<std::uint8_t*>(picture.rgb.data()));
    cv::Mat small;
    cv::resize(full, small, cv::Size(kWidth, kHeight), 0, 0, cv::INTER_AREA);
    cv::Mat hsv;
    cv::cvtColor(small, hsv, cv::COLOR_RGB2HSV);
    Blobs blobs;
    for (std::size_t channel = 0; channel < kHues.size(); ++channel) {
        const auto& hues = kHues[channel];
        const auto within = [&hsv](int from, int to) {
            cv::Mat mask;
            cv::inRange(hsv, cv::Scalar(from, kLeastSaturation, kLeastBrightness),
                        cv::Scalar(to - 1, 255, 255), mask);
            return mask;
        };
        cv::Mat mask = hues.from < hues.to ? within(hues.from, hues.to)
                                           : cv::Mat(within(hues.from, 180) | within(0, hues.to));
        if (cv::countNonZero(mask) < kLeastArea) continue;
        cv::Mat labels;
        cv::Mat stats;
        cv::Mat centres;
        const int count = cv::connectedComponentsWithStats(mask, labels, stats, centres, 8);
        for (int i = 1; i < count; ++i) {
            const int area = stats.at<int>(i, cv::CC_STAT_AREA);
            if (area < kLeastArea) continue;
            const int left = stats.at<int>(i, cv::CC_STAT_LEFT);
            const int top = stats.at<int>(i, cv::CC_STAT_TOP);
            blobs[channel].push_back({area, static_cast<int>(centres.at<double>(i, 0) + 0.5),
                                      static_cast<int>(centres.at<double>(i, 1) + 0.5), left,
                                      left + stats.at<int>(i, cv::CC_STAT_WIDTH) - 1, top,
                                      top + stats.at<int>(i, cv::CC_STAT_HEIGHT) - 1});
        }
        std::stable_sort(blobs[channel].begin(), blobs[channel].end(),
                         [](const Blob& a, const Blob& b) { return a.area > b.area; });
        if (blobs[channel].size() > kMostBlobs) blobs[channel].resize(kMostBlobs);
    }
    return blobs;
}

std::vector<std::uint8_t> encode(const Blobs& blobs) {
    std::vector<std::uint8_t> bytes;
    int index = 0;
    for (const auto& channel : blobs) {
        const int count = static_cast<int>(std::min(channel.size(), kMostBlobs));
        push(bytes, index, 2);
        push(bytes, count, 2);
        index += count;
    }
    for (const auto& channel : blobs) {
        for (std::size_t i = 0; i < std::min(channel.size(), kMostBlobs); ++i) {
            const auto& blob = channel[i];
            push(bytes, blob.area, 4);
            for (const int value : {blob.x, blob.y, blob.left, blob.right, blob.top, blob.bottom})
                push(bytes, value, 2);
        }
    }
    return bytes;
}

}  // namespace acts

std::vector<std::uint8_t> ActsServer::receive(std::span<const std::uint8_t> bytes) {
    for (const auto byte : bytes) {
        if (byte == '0') asked_ = std::min<std::size_t>(asked_ + 1, 16);
        if (byte == '1') quit_ = true;
    }
    return answers();
}

std::vector<std::uint8_t> ActsServer::newPicture(SharedPicture picture) {
    picture_ = std::move(picture);
    encoded_.clear();
    return answers();
}

std::vector<std::uint8_t> ActsServer::answers() {
    std::vector<std::uint8_t> result;
    if (!picture_ || asked_ == 0) return result;
    if (encoded_.empty()) encoded_ = acts::encode(acts::findBlobs(*picture_));
    for (; asked_ > 0; --asked_) result.insert(result.end(), encoded_.begin(), encoded_.end());
    return result;
}

}  // namespace axon::lab
