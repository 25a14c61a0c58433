// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "transport/ice/convert.hpp"

namespace axon::transport {

/// Ice's form of a head that is given to Ice at once, which copies it into the message. It keeps its memory
/// from message to message. Threads: one at a time; valid until the next call.
class HeaderScratch {
  public:
    const ice::Header& of(const Header& head) {
        its_.sender.id = head.sender.id;
        its_.sender.name = head.sender.name;
        its_.sender.role = static_cast<ice::Role>(head.sender.role);
        its_.entity = head.entity;
        its_.msgType = head.msg_type;
        its_.held = {head.held.epoch, head.held.number};
        its_.stopGeneration = head.stop_generation;
        its_.seq = static_cast<double>(head.sequence);
        its_.sentAt = static_cast<double>(head.sent_at_us);
        return its_;
    }
    /// That of the calling thread.
    static HeaderScratch& ofThread() {
        thread_local HeaderScratch scratch;
        return scratch;
    }

  private:
    ice::Header its_;
};

}  // namespace axon::transport
