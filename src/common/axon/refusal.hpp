// SPDX-License-Identifier: MIT
#pragma once
#include <string>
#include <string_view>

namespace axon {

/// Why a request was refused. docs/reference/refusals.md has the meaning of each code.
/// axon.proto.RefusalCode, Python, JavaScript and the JSON of the `axon` command use the same names and
/// numbers; refusal_test.cpp compares them.
enum class RefusalCode : int {
    Ok = 0,
    NotHolder = 1,
    AlreadyHeld = 2,
    OlderLease = 3,
    RevokedLease = 4,
    WrongEpoch = 5,
    Expired = 6,
    OldGeneration = 7,
    Latched = 8,
    Reserved = 9,
    HandOverRefused = 10,
    UnknownEntity = 20,
    AmbiguousEntity = 21,
    UnknownService = 22,
    UnknownParameter = 23,
    UnknownResource = 24,
    UnknownTask = 25,
    WrongType = 26,
    WrongUnits = 27,
    OutOfRange = 28,
    MissingDependency = 29,
    InactiveService = 30,
    Blocked = 31,
    QueueFull = 32,
    NotPausable = 33,
    Denied = 34,
    Duplicate = 35,
    BadName = 36,
    HashMismatch = 37,
    TooLarge = 38,
    Malformed = 39,
    NotSupported = 40,
    WrongState = 60,
    Unavailable = 61,
    RobotLost = 62,
    NotConnected = 63,
    TimedOut = 64,
    PermissionDenied = 65,
    Overloaded = 66,
    Failed = 67,
    Stopped = 68,
    Cancelled = 69,
    ClientLost = 70,
    OutcomeUnknown = 71,
    Internal = 72,
};

/// The name of a code as it is written in the contracts: "NOT_HOLDER". Never empty; an unknown number gives
/// "INTERNAL".
std::string_view refusalName(RefusalCode code);

/// Why something was not done. The code is for programs. The message is for people: it says what was expected
/// and how to fix it.
struct Refusal {
    RefusalCode code = RefusalCode::Ok;
    std::string message;
    std::string holder;  ///< name of the present holder, if the entity is refused because of it

    bool ok() const { return code == RefusalCode::Ok; }
};

}  // namespace axon
