// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/directcomm.h>

#include <utility>

#include "common/routed.hpp"
#include "transport/ice/convert.hpp"

// The head of messages on a direct path, and the header of which it is a part. Sender and entity are the
// connection's two ends and are filled in by whoever holds it.
namespace axon::transport {

inline ::Axon::DirectComm::Head toDirectHead(const Header& head) {
    return {head.msg_type,
            {head.held.epoch, head.held.number},
            head.stop_generation,
            static_cast<double>(head.sequence),
            static_cast<double>(head.sent_at_us)};
}

inline Header fromDirectHead(::Axon::DirectComm::Head&& head) {
    Header its;
    its.msg_type = std::move(head.msgType);
    its.held = {head.held.epoch, head.held.number};
    its.stop_generation = head.stopGeneration;
    its.sequence = whole(head.seq);
    its.sent_at_us = whole(head.sentAt);
    return its;
}

}  // namespace axon::transport
