// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "common/descriptor.hpp"
#include "common/result.hpp"
#include "direct/lane/lane_outbox.hpp"

namespace axon::direct::lane {

/// Sets a connection's options: no delay; over when the other end's kernel answers nothing for 30 s, or takes
/// no byte of what waits for it. A firewall may forget this connection while the signal lane lives on.
void prepare(int socket);
/// As Wire::write.
std::optional<std::size_t> writeTo(int socket, std::span<const std::string_view> pieces);

/// The socket of a data lane: TCP, never waits. Threads: any. Failure: told by what the functions return.
class LaneSocket final : public Wire {
  public:
    /// Takes it over, and prepares it.
    explicit LaneSocket(Descriptor socket);
    /// Begins to connect to "a.b.c.d:port" or "[a::b]:port" without waiting; it is connected or has failed
    /// when it is writable, and a failed one is Lost when it is read.
    static Result<Descriptor> connectTo(const std::string& endpoint);

    std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
        return writeTo(socket_.get(), pieces);
    }
    struct Read {
        enum class End : std::uint8_t { No, Closed, Lost };
        std::size_t bytes = 0;
        bool more = false;  ///< there may be more to read now
        End end = End::No;
        int error = 0;  ///< where it is Lost
    };
    Read read(std::span<char> room);
    /// No byte comes or goes from now on; who waits for one hears that.
    void shut();
    int descriptor() const { return socket_.get(); }

  private:
    const Descriptor socket_;
};

}  // namespace axon::direct::lane
