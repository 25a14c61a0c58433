// SPDX-License-Identifier: GPL-2.0-or-later
// A data lane of a direct path, at either end: however the stream is cut, the same frames come out; no claim
// opens it but one with the right proof for this connection's nonce, and no Entity Manager but one that
// knows the key; what is read as a message is written as it came. The input is a byte for the size of the
// pieces, a byte for the end (its second bit: an honest frame of the opening comes first), and the stream.
#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "claim.hpp"
#include "common/frame.hpp"
#include "common/ids.hpp"
#include "direct/lane/frames.hpp"
#include "direct/lane/opening.hpp"

namespace {

using namespace axon;
using namespace axon::direct;
using namespace axon::direct::lane;
using axon::Refusal;

const std::string kKey = "0123456789abcdef";

struct Heard {
    std::vector<std::string> frames;
    bool failed = false;
    bool operator==(const Heard&) const = default;
};

/// Through a reader whose room is filled, as those of both ends are.
Heard hear(std::string_view stream, std::size_t piece, std::size_t limit) {
    FrameReader reader(limit);
    Heard heard;
    while (!stream.empty() && !reader.failed()) {
        const auto room = reader.room();
        require(room.size() <= kMessageFrameMax + 2 * FrameReader::kReadMax,
                "no stranger is given much memory");
        const auto count = std::min({piece, room.size(), stream.size()});
        stream.copy(room.data(), count);
        stream.remove_prefix(count);
        reader.filled(count);
        while (const auto frame = reader.nextView()) {
            require(!frame->empty() && frame->size() <= limit, "no frame is longer than may be");
            heard.frames.emplace_back(*frame);
        }
    }
    heard.failed = reader.failed();
    return heard;
}

void checkMessage(const std::string& frame) {
    const auto message = messageIn(frame);
    if (!message) return;
    Header head;
    message->into(head);
    const auto bytes = headOf(message->keeping, head, message->content.size());
    require(bytes.has_value(), "what was read can be written");
    require(std::string(bytes->view().substr(4)) + std::string(message->content) == frame,
            "a message is written as it came");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    if (size < 2) return 0;
    const std::size_t piece = 1 + bytes[0];
    const bool manager = bytes[1] % 2 == 0, honest = bytes[1] / 2 % 2 == 1;
    const std::string_view stream(reinterpret_cast<const char*>(bytes) + 2, size - 2);
    for (const auto limit : {kClaimMax, kOpeningMax, kMessageFrameMax})
        require(hear(stream, piece, limit) == hear(stream, stream.size() + 1, limit),
                "the same frames come out, however it is cut");

    SeededRandom random(1);
    Claim claim{Lane::Data, {3, 7}, Id128::random(random), Id128::random(random), Id128::random(random)};
    auto said = hear(stream, piece, kOpeningMax).frames;
    for (const auto& frame : said) checkMessage(frame);
    ManagerOpening hears(claim.nonce);
    ClientOpening asks(
        claim,
        [&](const Id128& nonce) {
            claim.nonce = nonce;
            return proofOf(claim, Prover::Client, kKey);
        },
        [&](std::string_view proof) { return proves(proof, claim, Prover::EntityManager, kKey); });
    if (manager) {
        if (honest)
            said.insert(said.begin(), std::get<0>(asks.onFrame(hears.greeting().substr(4))).substr(4));
        bool first = true;
        for (const auto& frame : said) {
            const auto heard = hears.onFrame(frame);
            if (const auto* claimed = std::get_if<ManagerOpening::Claimed>(&heard)) {
                require(first, "one claim is heard");
                require(claimed->claim.nonce == claim.nonce || honest, "the nonce is the connection's");
                const bool right = proves(claimed->proof, claimed->claim, Prover::Client, kKey);
                require(right == honest, "only a right claim is proved");
            }
            first = false;
        }
    } else {
        if (honest) said.insert(said.begin(), hears.greeting().substr(4));
        for (const auto& frame : said) {
            const bool over = asks.state() == ClientOpening::State::Over;
            const auto answer = asks.onFrame(frame);
            require(!over || answer.index() == 1, "what is over stays over");
        }
        require(asks.state() != ClientOpening::State::Open, "who does not know the key is not trusted");
    }
    return 0;
}
