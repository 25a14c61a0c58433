// SPDX-License-Identifier: MIT
#include "common/routed.hpp"

namespace axon {

const char* toString(EntityState state) {
    switch (state) {
        case EntityState::UNAV:
            return "UNAV";
        case EntityState::INIT:
            return "INIT";
        case EntityState::ENVCONN:
            return "ENVCONN";
        case EntityState::IDLE:
            return "IDLE";
        case EntityState::REG:
            return "REG";
        case EntityState::COLLAB:
            return "COLLAB";
        case EntityState::SLAVE:
            return "SLAVE";
        case EntityState::BUSY:
            return "BUSY";
        case EntityState::ERR:
            return "ERR";
    }
    return "?";
}

const char* toString(StopCause cause) {
    switch (cause) {
        case StopCause::Unspecified:
            return "unspecified";
        case StopCause::Requested:
            return "requested";
        case StopCause::ClientLost:
            return "client lost";
        case StopCause::Released:
            return "released";
        case StopCause::Improper:
            return "improper client";
        case StopCause::ServerLost:
            return "server lost";
        case StopCause::LinkLost:
            return "link lost";
        case StopCause::Reset:
            return "reset";
        case StopCause::Clear:
            return "clear";
        case StopCause::Cancel:
            return "cancel";
        case StopCause::Shutdown:
            return "shutdown";
        case StopCause::Fault:
            return "fault";
        case StopCause::Drill:
            return "drill";
    }
    return "?";
}

const char* toString(Role role) {
    switch (role) {
        case Role::Observer:
            return "observer";
        case Role::Operator:
            return "operator";
        case Role::Admin:
            return "admin";
    }
    return "?";
}

}  // namespace axon
