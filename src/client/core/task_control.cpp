// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/task_control.hpp"

#include <axon/messages.pb.h>

namespace axon::client {

std::int64_t sendControl(CoreContext& context, Id128 id, const Held& under, proto::TaskAction action) {
    proto::ToEntity body;
    body.mutable_task_control()->set_task_id(id.bytes());
    body.mutable_task_control()->set_action(action);
    return context.send(under.entity, kMsgTaskControl, under.lease, body);
}

}  // namespace axon::client
