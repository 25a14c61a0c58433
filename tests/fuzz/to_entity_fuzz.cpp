// SPDX-License-Identifier: GPL-2.0-or-later
// Whatever clients and other entities send an Entity Manager, as an axon.proto.ToEntity under any header:
// nobody but who was granted the robot moves it, and no latch goes without a rearm. The input is messages of
// a byte for who sends and a byte for the header, two for the length, then the message.
#include <axon/messages.pb.h>

#include <cstdint>
#include <string>
#include <vector>

#include "claim.hpp"
#include "tests/support/core_rig.hpp"

namespace {

using namespace axon;
using namespace std::chrono_literals;

const std::vector<std::string> kSenders{"client1", "client2", "admin1", "observer1",
                                        "22222222-1111-4111-8111-111111111111"};
const std::vector<const char*> kTypes{kMsgCheckOut, kMsgTask,   kMsgRearm, kMsgWatch,         kMsgRaw,
                                      kMsgRun,      kMsgStatus, "",        kMsgCollaboration, "no such type"};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    test::CoreRig rig;
    rig.makeIdle();
    rig.take("client1", "r1");
    bool rearmed = !rig.core().latched();
    for (std::size_t at = 0; at + 4 <= size && at < 64 * 1024U;) {
        const auto& sender = kSenders[bytes[at] % kSenders.size()];
        const auto kind = bytes[at + 1];
        const auto length = std::min<std::size_t>(bytes[at + 2] + 256U * bytes[at + 3], size - at - 4);
        const std::string message(reinterpret_cast<const char*>(bytes + at + 4), length);
        at += 4 + length;
        proto::ToEntity read;
        const bool readable = read.ParseFromString(message);
        auto head = readable ? rig.headOf(sender, read) : rig.headOf(sender);
        if (kind % 4 == 0) head.msg_type = kTypes[kind / 4U % kTypes.size()];
        if (kind % 16 == 1) head.held = {1, 1};
        if (kind % 16 == 2) head.stop_generation = 1000;
        const auto before = rig.to_application.size();
        const auto holder = rig.core().status().holder.id;
        const bool latched = rig.core().latched();
        rig.core().onClientMsg(head, message);
        if (latched && !rig.core().latched()) {
            require(readable && read.has_rearm(), "only a rearm takes the latch away");
            rearmed = true;
        }
        for (auto i = before; i < rig.to_application.size(); ++i) {
            if (!rig.to_application[i].has_task()) continue;
            require(rearmed, "no task begins while the robot is latched");
            require(!holder.empty(), "no task begins while nobody holds the robot");
        }
        if (kind % 8 == 5) rig.advance(20ms);
        if (kind % 8 == 6) rig.stopDone(rig.stop_generations.generation());
        if (kind % 32 == 7) {
            rig.stop("client2");
            require(rig.core().latched(), "a stop latches");
        }
    }
    rig.advance(50ms);
    return 0;
}
