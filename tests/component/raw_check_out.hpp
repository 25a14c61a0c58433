// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>
#include <gtest/gtest.h>

#include <string>

#include "common/ids.hpp"
#include "component/raw_peers.hpp"
#include "support/loopback.hpp"

namespace axon::test {

/// What a client without our library is granted when it checks the entity out, the key of the lease included.
inline proto::CheckOutReply checkOut(RawClient& client, const std::string& entity, RandomSource& random) {
    proto::ToEntity body;
    body.mutable_check_out()->set_request_id(Id128::random(random).bytes());
    body.mutable_check_out()->set_phase(proto::TAKE);
    auto head = client.headTo(entity);
    head.msg_type = kMsgCheckOut;
    const auto bytes = body.SerializeAsString();
    client.data()->sendToEntity(transport::toIce(head), transport::toRange(bytes));
    const auto beginning = "data msg " + entity + " ";
    proto::ToClient message;
    EXPECT_TRUE(waitUntil([&] {
        for (const auto& line : client.log.lines())
            if (line.starts_with(beginning) && message.ParseFromString(line.substr(beginning.size())) &&
                message.has_check_out() && message.check_out().has_lease())
                return true;
        return false;
    }));
    return message.check_out();
}

}  // namespace axon::test
