// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "common/frame.hpp"
#include "direct/lane/lane_outbox.hpp"

namespace axon::direct::lane {

/// What stands between the bytes of a data lane's socket and its frames: nothing (PlainChannel), or TLS
/// (TlsChannel). It does no I/O of its own: its owner reads the socket into room(), and it writes to the wire
/// of the socket.
///
///     Opening ── what the other side says is in order ──► Open ──► Over
///        └───────────────── or not ─────────────────────────────────┘
///
/// Threads: filled() on one at a time; write(), once it is Open, on any. Failure: it is Over, and why() says
/// why.
class Channel : public Wire {
  public:
    enum class State : std::uint8_t { Opening, Open, Over };

    /// Where the next bytes of the socket are to be put; never empty. Valid until anything else is called.
    virtual std::span<char> room(FrameReader& frames) = 0;
    /// That many were put there; the frames have what they say. 0 begins an opening that this side begins.
    virtual State filled(FrameReader& frames, std::size_t count) = 0;
    /// For a person; empty unless it is Over.
    virtual std::string why() const = 0;
};

/// The bytes of the socket are the frames.
class PlainChannel final : public Channel {
  public:
    explicit PlainChannel(Wire& socket) : socket_(socket) {}

    std::span<char> room(FrameReader& frames) override { return frames.room(); }
    State filled(FrameReader& frames, std::size_t count) override {
        if (count > 0) frames.filled(count);
        return State::Open;
    }
    std::string why() const override { return {}; }
    std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
        return socket_.write(pieces);
    }

  private:
    Wire& socket_;
};

}  // namespace axon::direct::lane
