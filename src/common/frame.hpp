// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace axon {

/// A frame of the EM-EI link holds at most this much after its length (docs/reference/ei-link.md).
inline constexpr std::size_t kFrameMax = 1024 * 1024;

/// Appends 4 bytes, in network order.
void appendNumber(std::string& out, std::uint32_t number);

/// Appends a length of 4 bytes, in network order, and the payload. False, and nothing appended, when the
/// payload is empty or larger than kFrameMax.
bool appendFrame(std::string& out, std::string_view payload);

/// Cuts a byte stream into frames. I/O-free: bytes in, payloads out. The bytes are fed, or a caller that
/// reads a socket puts them into room() itself, which saves a copy.
///
/// States: reading; failed (a length of 0 or above the limit), which is final: a stream that has lost its
/// frames cannot be trusted again. Memory: at most twice the bytes that have come and are not taken, or the
/// frame that has begun and kReadMax. Threads: the owner's.
class FrameReader {
  public:
    /// What one read may bring at most, besides the rest of a frame that has begun.
    static constexpr std::size_t kReadMax = 256 * 1024;

    explicit FrameReader(std::size_t limit = kFrameMax) : limit_(limit) {}

    /// Frames announced after this call may be as long as `limit`: small before a peer has said who it is.
    void setLimit(std::size_t limit) { limit_ = limit; }
    void feed(std::string_view bytes);
    /// Where the next bytes of the stream may be put; never empty. Large enough for the rest of a frame that
    /// has begun, and more after reads that have filled it.
    std::span<char> room();
    /// So many bytes were put into room().
    void filled(std::size_t count);
    /// The next whole payload; false when there is none yet, or the stream has failed.
    bool next(std::string& payload);
    /// The same without a copy; valid until anything but error() or failed() is called.
    std::optional<std::string_view> nextView();
    bool failed() const { return failed_; }
    /// What was wrong, for a person; empty unless failed().
    const std::string& error() const { return error_; }

  private:
    std::size_t held() const { return end_ - begin_; }
    std::size_t announced() const;
    void makeRoom(std::size_t count);
    void drop();

    std::size_t limit_;
    std::unique_ptr<char[]> buffer_;
    std::size_t capacity_ = 0;
    std::size_t begin_ = 0, end_ = 0;  // of what has come and is not taken
    std::size_t read_ = 16 * 1024;     // what room() offers at least
    bool failed_ = false;
    std::string error_;
};

}  // namespace axon
