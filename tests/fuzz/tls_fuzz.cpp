// SPDX-License-Identifier: GPL-2.0-or-later
// A data lane of a direct path over TLS, at either end, and a peer that does not have the laboratory's
// certificates: whatever it says, and however that is cut, nothing opens, no frame is heard, and little is
// said to it. The input is a byte for the end, a byte for the size of the pieces, and the stream.
#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>

#include "certificates/certificate.hpp"
#include "claim.hpp"
#include "common/frame.hpp"
#include "direct/lane/tls_channel.hpp"

namespace {

using namespace axon;
using namespace axon::direct::lane;

constexpr certificates::WallTime kNow{std::chrono::sys_days{std::chrono::year{2026} / 11 / 26}};
constexpr std::size_t kSaidMax = 64 * 1024;

struct Socket final : Wire {
    std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
        std::size_t count = 0;
        for (const auto piece : pieces) count += piece.size();
        said += count;
        return count;
    }
    std::size_t said = 0;
};

std::shared_ptr<const Tls> robot() {
    const auto authority = certificates::makeAuthority(kNow);
    const auto issued = certificates::issue(authority, {certificates::Kind::Entity, {"robot"}}, kNow);
    certificates::Credentials its;
    its.authorities = authority.certificate;
    its.certificate = issued.certificate;
    its.key = issued.key;
    its.tls_1_2 = true;
    return Tls::of(its, [] { return kNow; });
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    static const auto tls = robot();
    if (size < 2) return 0;
    const std::size_t piece = 1 + 16 * std::size_t{bytes[1]};
    std::string_view stream(reinterpret_cast<const char*>(bytes) + 2, size - 2);
    Socket socket;
    const auto channel = bytes[0] % 2 == 0 ? tls->fromCaller(socket) : tls->toEntity("robot", socket);
    FrameReader frames(kMessageFrameMax);
    auto state = channel->filled(frames, 0);
    while (!stream.empty()) {
        const auto room = channel->room(frames);
        require(!room.empty(), "there is always room");
        const auto count = std::min({piece, room.size(), stream.size()});
        stream.copy(room.data(), count);
        stream.remove_prefix(count);
        const auto before = state;
        state = channel->filled(frames, count);
        require(state != Channel::State::Open, "nothing opens without a certificate");
        require(before != Channel::State::Over || state == Channel::State::Over, "what is over stays over");
        require((state == Channel::State::Over) == !channel->why().empty(), "an end has a reason");
    }
    require(!frames.nextView(), "nothing is heard before it is open");
    require(socket.said < kSaidMax, "a stranger is told little");
    const std::string_view message("message");
    require(!channel->write({&message, 1}), "nothing is written before it is open");
    return 0;
}
