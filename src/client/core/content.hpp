// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/collaboration.pb.h>
#include <axon/lease.pb.h>
#include <axon/profile.pb.h>
#include <axon/status.pb.h>
#include <axon/stream.pb.h>
#include <axon/task.pb.h>

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "axon/global.hpp"
#include "axon/types.hpp"
#include "collaboration/bindings.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

// Between the messages and the types of the public header. Pure functions: any thread.
namespace axon::client {

/// False for bytes that are no such message.
bool parse(google::protobuf::MessageLite& message, std::string_view bytes);

LeaseNumber fromProto(const proto::Lease& lease);
proto::HandOverPolicy toProto(const HandOverPolicy& policy);
Value fromProto(const proto::Value& value);
proto::Value toProto(const Value& value);
Service fromProto(const proto::Service& service);
/// Nothing for STATE_UNSPECIFIED and numbers this version does not know.
std::optional<EntityState> stateFromProto(proto::EntityState state);
std::optional<TaskState> taskStateFromProto(proto::TaskState state);

std::optional<RunState> runStateFromProto(proto::RunState state);
GlobalService fromProto(const proto::GlobalService& service);
proto::GlobalService toProto(const GlobalService& service);
GlobalServices fromProto(const proto::GlobalServices& services);
StepReport fromProto(const proto::StepStatus& status);
RunProblem fromProto(const proto::Problem& problem);
RunRecord fromProto(const proto::RunRecord& record);

/// What the roles of a service ask of their players, those of its compensation too.
std::vector<collaboration::Role> rolesOf(const GlobalService& service);

/// What was found for those roles, as the program sees it.
Proposal toPublic(collaboration::Proposal found);

/// Arguments as the service's profile declares its parameters, checked by the rules that the Entity Manager
/// has: UNKNOWN_PARAMETER, WRONG_TYPE, WRONG_UNITS, OUT_OF_RANGE.
Result<std::vector<proto::Param>> toParams(const proto::Service& service,
                                           const std::vector<Argument>& arguments);

/// A serialized axon.proto.ToEntity with one block of raw data: the bytes that protobuf would write, copied
/// once.
std::string rawMessage(std::string_view bytes);

}  // namespace axon::client
