// SPDX-License-Identifier: GPL-2.0-or-later
// The frame reader of the EM-EI link and what follows it on either end: however a stream is cut into pieces,
// the same frames come out, none is longer than the limit, and a failed stream stays failed.
#include <axon/link.pb.h>

#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#include "common/frame.hpp"

namespace {

struct Cut {
    std::vector<std::string> frames;
    bool failed = false;
};

Cut framesOf(std::string_view stream, std::size_t piece, std::size_t limit) {
    axon::FrameReader reader(limit);
    Cut cut;
    for (std::size_t at = 0; at < stream.size(); at += piece) {
        reader.feed(stream.substr(at, piece));
        for (std::string payload; reader.next(payload);) cut.frames.push_back(payload);
    }
    cut.failed = reader.failed();
    return cut;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    if (size == 0) return 0;
    const std::size_t piece = 1 + bytes[0];
    const std::string_view stream(reinterpret_cast<const char*>(bytes) + 1, size - 1);
    const auto whole = framesOf(stream, stream.size() + 1, 4096);
    const auto pieces = framesOf(stream, piece, 4096);
    if (whole.frames != pieces.frames || whole.failed != pieces.failed) std::abort();
    std::string again;
    for (const auto& frame : whole.frames) {
        if (frame.empty() || frame.size() > 4096 || !axon::appendFrame(again, frame)) std::abort();
        axon::proto::EmToEi to_interfacer;
        (void)to_interfacer.ParseFromString(frame);
        axon::proto::EiToEm to_manager;
        (void)to_manager.ParseFromString(frame);
    }
    if (stream.substr(0, again.size()) != again) std::abort();
    return 0;
}
