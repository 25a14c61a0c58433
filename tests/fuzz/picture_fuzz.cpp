// SPDX-License-Identifier: GPL-2.0-or-later
// A camera's stream of PPM pictures: however it is cut, the same last picture comes out or the same refusal,
// and a picture has the bytes that its size says.
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <span>

#include "robots/peoplebot/camera_picture.hpp"

namespace {

using namespace axon::peoplebot;

struct Seen {
    std::uint64_t count = 0;
    std::vector<std::uint8_t> last;
    bool refused = false;
    bool operator==(const Seen&) const = default;
};

Seen read(std::span<const std::uint8_t> stream, std::size_t piece) {
    PictureReader reader;
    Seen seen;
    try {
        for (std::size_t at = 0; at < stream.size(); at += piece) {
            reader.feed(stream.subspan(at, std::min(piece, stream.size() - at)), axon::TimePoint{});
            const auto picture = reader.take();
            if (!picture) continue;
            if (picture->rgb.size() != std::size_t{3} * picture->width * picture->height) std::abort();
            seen.count = picture->sequence;
            seen.last = picture->rgb;
        }
    } catch (const BadPicture&) {
        seen.refused = true;
    }
    return seen;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    if (size == 0) return 0;
    const std::span<const std::uint8_t> stream(bytes + 1, size - 1);
    const auto whole = read(stream, stream.size() + 1), pieces = read(stream, 1 + std::size_t{bytes[0]});
    // What was whole before the refusal may have been taken, or not.
    if (whole.refused != pieces.refused || (!whole.refused && whole != pieces)) std::abort();
    return 0;
}
