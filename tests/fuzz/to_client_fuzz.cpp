// SPDX-License-Identifier: GPL-2.0-or-later
// Whatever an entity sends a client, as an axon.proto.ToClient, a profile or a record of a service: the
// client neither ends nor believes that it holds what it has not asked for. The input is messages of a byte
// for the kind and for the entity, two for the length, then the message.
#include <axon/messages.pb.h>

#include <cstdint>
#include <string>

#include "claim.hpp"
#include "client/testing/test_environment.hpp"

namespace {

using namespace axon;
using namespace axon::client::test;

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    CoreWorld world;
    world.connect();
    // One it has asked for, and that may answer what it likes.
    world.core.checkOuts().checkOut({"Cyton"}, [](const auto&) {});
    for (std::size_t at = 0; at + 4 <= size && at < 64 * 1024U;) {
        const auto kind = bytes[at];
        const int number = 1 + bytes[at + 1] % 4;
        const auto length = std::min<std::size_t>(bytes[at + 2] + 256U * bytes[at + 3], size - at - 4);
        const std::string message(reinterpret_cast<const char*>(bytes + at + 4), length);
        at += 4 + length;
        Header head;
        head.entity = uuid(number);
        head.msg_type = kMsgReply;
        head.sender = kMe;
        head.stop_generation = kind;
        switch (kind % 8) {
            case 0:
                world.core.onProfile(Presence::Changed, {uuid(number), "Robot", "ROBOT", "MOBILE"}, message);
                break;
            case 2:
                world.clock.advance(std::chrono::milliseconds{kind});
                world.core.onTimer();
                break;
            case 3:
                world.status(number, static_cast<EntityState>(kind / 8 % 9), kMe, {1, kind}, kind);
                break;
            default:
                world.core.onEntityMsg(head, message);
        }
    }
    for (const auto& held : world.core.leases().held())
        require(held.entity == uuid(3), "it holds only what it asked for");
    return 0;
}
