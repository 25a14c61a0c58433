// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <string>
#include <string_view>

namespace axon {

/// A frame of the EM-EI link holds at most this much after its length (docs/reference/ei-link.md).
inline constexpr std::size_t kFrameMax = 1024 * 1024;

/// Appends a 4-byte big-endian length and the payload. False, and nothing appended, when the payload is empty
/// or larger than kFrameMax.
bool appendFrame(std::string& out, std::string_view payload);

/// Cuts a byte stream into frames. I/O-free: bytes in, payloads out.
///
/// States: reading; failed (a length of 0 or above the limit), which is final: a stream that has lost its
/// frames cannot be trusted again. Memory: never more than the bytes fed, and those of one feed beyond a
/// frame. Threads: the owner's.
class FrameReader {
  public:
    explicit FrameReader(std::size_t limit = kFrameMax) : limit_(limit) {}

    /// Frames announced after this call may be as long as `limit`: small before a peer has said who it is.
    void setLimit(std::size_t limit) { limit_ = limit; }
    void feed(std::string_view bytes);
    /// The next whole payload; false when there is none yet, or the stream has failed.
    bool next(std::string& payload);
    bool failed() const { return failed_; }
    /// What was wrong, for a person; empty unless failed().
    const std::string& error() const { return error_; }

  private:
    std::size_t limit_;
    std::string buffer_;
    std::size_t begin_ = 0;  // consumed part of buffer_
    bool failed_ = false;
    std::string error_;
};

}  // namespace axon
