// SPDX-License-Identifier: MIT
#include "common/refusal.hpp"

namespace axon {

std::string_view refusalName(RefusalCode code) {
    switch (code) {
        case RefusalCode::Ok:
            return "OK";
        case RefusalCode::NotHolder:
            return "NOT_HOLDER";
        case RefusalCode::AlreadyHeld:
            return "ALREADY_HELD";
        case RefusalCode::OlderLease:
            return "OLDER_LEASE";
        case RefusalCode::RevokedLease:
            return "REVOKED_LEASE";
        case RefusalCode::WrongEpoch:
            return "WRONG_EPOCH";
        case RefusalCode::Expired:
            return "EXPIRED";
        case RefusalCode::OldGeneration:
            return "OLD_GENERATION";
        case RefusalCode::Latched:
            return "LATCHED";
        case RefusalCode::Reserved:
            return "RESERVED";
        case RefusalCode::HandOverRefused:
            return "HAND_OVER_REFUSED";
        case RefusalCode::UnknownEntity:
            return "UNKNOWN_ENTITY";
        case RefusalCode::AmbiguousEntity:
            return "AMBIGUOUS_ENTITY";
        case RefusalCode::UnknownService:
            return "UNKNOWN_SERVICE";
        case RefusalCode::UnknownParameter:
            return "UNKNOWN_PARAMETER";
        case RefusalCode::UnknownResource:
            return "UNKNOWN_RESOURCE";
        case RefusalCode::UnknownTask:
            return "UNKNOWN_TASK";
        case RefusalCode::WrongType:
            return "WRONG_TYPE";
        case RefusalCode::WrongUnits:
            return "WRONG_UNITS";
        case RefusalCode::OutOfRange:
            return "OUT_OF_RANGE";
        case RefusalCode::MissingDependency:
            return "MISSING_DEPENDENCY";
        case RefusalCode::InactiveService:
            return "INACTIVE_SERVICE";
        case RefusalCode::Blocked:
            return "BLOCKED";
        case RefusalCode::QueueFull:
            return "QUEUE_FULL";
        case RefusalCode::NotPausable:
            return "NOT_PAUSABLE";
        case RefusalCode::Denied:
            return "DENIED";
        case RefusalCode::Duplicate:
            return "DUPLICATE";
        case RefusalCode::BadName:
            return "BAD_NAME";
        case RefusalCode::HashMismatch:
            return "HASH_MISMATCH";
        case RefusalCode::TooLarge:
            return "TOO_LARGE";
        case RefusalCode::Malformed:
            return "MALFORMED";
        case RefusalCode::NotSupported:
            return "NOT_SUPPORTED";
        case RefusalCode::WrongState:
            return "WRONG_STATE";
        case RefusalCode::Unavailable:
            return "UNAVAILABLE";
        case RefusalCode::RobotLost:
            return "ROBOT_LOST";
        case RefusalCode::NotConnected:
            return "NOT_CONNECTED";
        case RefusalCode::TimedOut:
            return "TIMED_OUT";
        case RefusalCode::PermissionDenied:
            return "PERMISSION_DENIED";
        case RefusalCode::Overloaded:
            return "OVERLOADED";
        case RefusalCode::Failed:
            return "FAILED";
        case RefusalCode::Stopped:
            return "STOPPED";
        case RefusalCode::Cancelled:
            return "CANCELLED";
        case RefusalCode::ClientLost:
            return "CLIENT_LOST";
        case RefusalCode::OutcomeUnknown:
            return "OUTCOME_UNKNOWN";
        case RefusalCode::Internal:
            return "INTERNAL";
    }
    return "INTERNAL";
}

}  // namespace axon
