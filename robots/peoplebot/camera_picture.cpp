// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/camera_picture.hpp"

#include <jpeglib.h>
#include <cstdio>  // jpeglib.h needs it first

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdlib>
#include <string_view>
#include <utility>

namespace axon::peoplebot {
namespace {

constexpr std::size_t kLongestHead = 8192;
constexpr std::size_t kLongestPpmHead = 200;

struct PpmHead {
    int width = 0;
    int height = 0;
    std::size_t bytes = 0;  // of the head
};

/// Nothing as long as the head is not complete.
std::optional<PpmHead> parsePpmHead(std::span<const std::uint8_t> bytes) {
    const auto bad = [](const char* why) {
        return BadPicture(std::string("the camera sends no PPM: ") + why);
    };
    std::array<int, 3> numbers{};
    std::size_t at = 0;
    for (const char expected : {'P', '6'}) {
        if (at >= bytes.size()) return std::nullopt;
        if (bytes[at++] != expected) throw bad("it does not begin with P6");
    }
    for (auto& number : numbers) {
        bool digits = false;
        while (true) {
            if (at >= kLongestPpmHead) throw bad("its head does not end");
            if (at >= bytes.size()) return std::nullopt;
            const int c = bytes[at];
            if (std::isdigit(c) != 0) {
                digits = true;
                number = std::min(number * 10 + (c - '0'), 1000000);
            } else if (c == '#' && !digits) {
                while (at < bytes.size() && bytes[at] != '\n' && at < kLongestPpmHead) ++at;
                continue;
            } else if (std::isspace(c) != 0) {
                if (digits) break;
            } else {
                throw bad("its head is not of numbers");
            }
            ++at;
        }
    }
    if (numbers[0] < 1 || numbers[1] < 1 || numbers[0] > PictureReader::kLargestSide ||
        numbers[1] > PictureReader::kLargestSide)
        throw bad("its size is out of range");
    if (numbers[2] != 255) throw bad("expected 255 as the largest value");
    return PpmHead{numbers[0], numbers[1], at + 1};
}

}  // namespace

void PictureReader::reset() {
    buffer_.clear();
    head_read_ = false;
}

void PictureReader::feed(std::span<const std::uint8_t> bytes, TimePoint now) {
    buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
    if (!head_read_ && !readHead()) return;
    while (readPicture(now)) {
    }
}

bool PictureReader::readHead() {
    static constexpr std::string_view kEnd = "\r\n\r\n";
    const auto end = std::search(buffer_.begin(), buffer_.end(), kEnd.begin(), kEnd.end());
    const auto line_end = std::find(buffer_.begin(), buffer_.end(), '\r');
    const std::string status(buffer_.begin(), line_end);
    if (end == buffer_.end()) {
        if (buffer_.size() > kLongestHead) throw BadPicture("the camera answers with no HTTP");
        return false;
    }
    if (!status.starts_with("HTTP/1.") ||
        status.substr(std::min<std::size_t>(8, status.size()), 5) != " 200 ")
        throw BadPicture("the camera answers \"" + status.substr(0, 80) + "\": expected 200 to GET /raw");
    buffer_.erase(buffer_.begin(), end + kEnd.size());
    head_read_ = true;
    return true;
}

bool PictureReader::readPicture(TimePoint now) {
    const auto head = parsePpmHead(buffer_);
    if (!head) return false;
    const auto size = static_cast<std::size_t>(head->width) * static_cast<std::size_t>(head->height) * 3;
    if (buffer_.size() < head->bytes + size) return false;
    const auto begin = buffer_.begin() + static_cast<std::ptrdiff_t>(head->bytes);
    newest_ = CameraPicture{
        ++count_, now, head->width, head->height, {begin, begin + static_cast<std::ptrdiff_t>(size)}};
    buffer_.erase(buffer_.begin(), begin + static_cast<std::ptrdiff_t>(size));
    return true;
}

std::optional<CameraPicture> PictureReader::take() {
    return std::exchange(newest_, std::nullopt);
}

CameraPicture scaled(const CameraPicture& picture, int most_width, int most_height) {
    const int factor = std::max(
        {1, (picture.width + most_width - 1) / most_width, (picture.height + most_height - 1) / most_height});
    CameraPicture small{picture.sequence,
                        picture.taken,
                        std::max(1, picture.width / factor),
                        std::max(1, picture.height / factor),
                        {}};
    small.rgb.reserve(static_cast<std::size_t>(small.width) * static_cast<std::size_t>(small.height) * 3);
    for (int y = 0; y < small.height; ++y) {
        for (int x = 0; x < small.width; ++x) {
            for (int channel = 0; channel < 3; ++channel) {
                int sum = 0;
                for (int dy = 0; dy < factor; ++dy) {
                    for (int dx = 0; dx < factor; ++dx) {
                        const int at = ((y * factor + dy) * picture.width + x * factor + dx) * 3 + channel;
                        sum += picture.rgb[static_cast<std::size_t>(at)];
                    }
                }
                small.rgb.push_back(static_cast<std::uint8_t>(sum / (factor * factor)));
            }
        }
    }
    return small;
}

std::string toJpeg(const CameraPicture& picture, int quality) {
    if (picture.width < 1 || picture.height < 1 ||
        picture.rgb.size() <
            static_cast<std::size_t>(picture.width) * static_cast<std::size_t>(picture.height) * 3)
        throw BadPicture("a picture without pixels");
    jpeg_compress_struct jpeg{};
    jpeg_error_mgr
        errors{};  // its default ends the process, only on errors of the caller that are excluded above
    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_compress(&jpeg);
    unsigned char* bytes = nullptr;
    unsigned long size = 0;
    jpeg_mem_dest(&jpeg, &bytes, &size);
    jpeg.image_width = static_cast<JDIMENSION>(picture.width);
    jpeg.image_height = static_cast<JDIMENSION>(picture.height);
    jpeg.input_components = 3;
    jpeg.in_color_space = JCS_RGB;
    jpeg_set_defaults(&jpeg);
    jpeg_set_quality(&jpeg, std::clamp(quality, 1, 100), TRUE);
    jpeg_start_compress(&jpeg, TRUE);
    while (jpeg.next_scanline < jpeg.image_height) {
        // libjpeg does not write through it.
        auto* row =
            const_cast<JSAMPLE*>(picture.rgb.data() + std::size_t{jpeg.next_scanline} *
                                                          static_cast<std::size_t>(picture.width) * 3);
        jpeg_write_scanlines(&jpeg, &row, 1);
    }
    jpeg_finish_compress(&jpeg);
    jpeg_destroy_compress(&jpeg);
    std::string result(reinterpret_cast<char*>(bytes), size);
    std::free(bytes);
    return result;
}

}  // namespace axon::peoplebot
