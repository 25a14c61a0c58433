// SPDX-License-Identifier: MIT
#include "common/rights.hpp"

#include <algorithm>
#include <array>

#include "common/refusal.hpp"
#include "common/routed.hpp"

namespace axon {

namespace {

constexpr std::array kRights{
    Right{kStopOperation, "", 0, Who::Anyone, Peers::No},
    Right{kResetOperation, "", 0, Who::Holder, Peers::No},
    Right{kClearOperation, "", 0, Who::Holder, Peers::No},
    Right{kMsgCheckOut, "check_out", 1, Who::Operator, Peers::No},
    Right{kMsgRelease, "release", 2, Who::Holder, Peers::No},
    Right{kMsgParam, "set_param", 3, Who::Holder, Peers::No},
    Right{kMsgTask, "task", 4, Who::Holder, Peers::No},
    Right{kMsgTaskControl, "task_control", 5, Who::Holder, Peers::No},
    Right{kMsgResource, "resource_offer", 6, Who::Holder, Peers::No},
    Right{kMsgResource, "resource_chunk", 7, Who::Holder, Peers::No},
    Right{kMsgText, "text", 8, Who::Holder, Peers::No},
    Right{kMsgRaw, "raw", 9, Who::Holder, Peers::OfRun},
    Right{kMsgRearm, "rearm", 10, Who::HolderOrAdmin, Peers::No},
    Right{kMsgStatus, "status_request", 11, Who::Anyone, Peers::No},
    Right{kMsgWatch, "watch", 12, Who::Anyone, Peers::No},
    Right{kMsgHandOver, "hand_over_answer", 13, Who::Holder, Peers::No},
    Right{kMsgHandOver, "hand_over_policy", 14, Who::Holder, Peers::No},
    Right{kMsgRun, "collaboration", 15, Who::Holder, Peers::No},
    Right{kMsgCollaboration, "from_master", 16, Who::Nobody, Peers::OfRun},
    Right{kMsgCollaboration, "from_slave", 17, Who::Nobody, Peers::OfRun},
    Right{kMsgRun, "run_history", 18, Who::Anyone, Peers::No},
    Right{kMsgGlobalServices, "global_services", 19, Who::Nobody, Peers::No},
    Right{kMsgWay, "way", 20, Who::Holder, Peers::No},
};

/// The cell of one kind of client.
std::string cell(Who who, bool operates, bool administers, bool holds) {
    const auto denied = [](RefusalCode code) { return std::string(refusalName(code)); };
    switch (who) {
        case Who::Anyone:
            return "yes";
        case Who::Operator:
            return operates ? "yes" : denied(RefusalCode::PermissionDenied);
        case Who::HolderOrAdmin:
            if (administers) return "yes";
            [[fallthrough]];
        case Who::Holder:
            return holds ? "yes" : denied(RefusalCode::NotHolder);
        case Who::Nobody:
            break;
    }
    return denied(RefusalCode::PermissionDenied);
}

}  // namespace

std::span<const Right> rights() {
    return kRights;
}

const Right* rightOf(int body) {
    const auto found = std::find_if(kRights.begin(), kRights.end(),
                                    [body](const Right& right) { return right.number == body; });
    return body == 0 || found == kRights.end() ? nullptr : &*found;
}

const Right& rightOfSignal(std::string_view operation) {
    return *std::find_if(kRights.begin(), kRights.end(),
                         [operation](const Right& right) { return right.msg_type == operation; });
}

bool clientsMaySend(std::string_view msg_type) {
    bool known = false;
    for (const auto& right : kRights) {
        if (right.number == 0 || right.msg_type != msg_type) continue;
        if (right.who != Who::Nobody) return true;
        known = true;
    }
    return !known;
}

bool entitiesMaySend(std::string_view msg_type) {
    return std::any_of(kRights.begin(), kRights.end(), [msg_type](const Right& right) {
        return right.number != 0 && right.msg_type == msg_type && right.peers == Peers::OfRun;
    });
}

std::string rightsPage() {
    std::string page =
        "<!-- Made by rights_test from src/common/rights.cpp (AXON_RERECORD=1); do not edit. -->\n"
        "# Who may send an entity what\n"
        "Servers and Entity Managers consult one table (`src/common/rights.cpp`). Servers see only the "
        "`msgType` of the header; the\n"
        "Entity Manager sees that the message is the one that its `msgType` names, and refuses it otherwise "
        "(`MALFORMED`). This page is\n"
        "made from the table, and it is tested with all kinds of senders: in "
        "`src/entity_manager/core/rights_test.cpp`, and in `tests/hostile`\n"
        "with real sessions.\n\n"
        "An observer, an operator and an administrator are clients that do not hold the entity; a holder is "
        "an operator that does. An\n"
        "entity is another robot's Entity Manager: *of a run* means that the server passes the message on, "
        "and the Entity Manager takes it\n"
        "from who takes part in the same run, or invites to one with the client's seal. Where a client may "
        "(*yes*), more is looked at\n"
        "([what a message must show](messages.md#what-a-message-must-show)). The codes are those of an "
        "entity that is held: of one that is\n"
        "not, the state is refused first, and in place of `NOT_HOLDER` whoever once held it is told how it "
        "lost its lease\n"
        "([refusals](refusals.md#what-a-header-lacks)).\n\n"
        "| msgType, or the operation of a signal | `ToEntity` | observer | operator | administrator | holder "
        "| entity |\n"
        "|---|---|---|---|---|---|---|\n";
    for (const auto& right : kRights) {
        page += "| `" + std::string(right.msg_type) + "` | " +
                (right.body.empty() ? "" : "`" + std::string(right.body) + '`') + " | " +
                cell(right.who, false, false, false) + " | " + cell(right.who, true, false, false) + " | " +
                cell(right.who, true, true, false) + " | " + cell(right.who, true, false, true) + " | " +
                (right.number == 0             ? "no such operation"
                 : right.peers == Peers::OfRun ? "of a run"
                                               : std::string(refusalName(RefusalCode::PermissionDenied))) +
                " |\n";
    }
    page +=
        "\n`GLOBAL_SERVICES` is for the front-end server itself, by `sendRequest`. A `msgType` that the "
        "table does not have is passed on for a\n"
        "client, so that servers need not change for a new one, and refused by the Entity Manager: "
        "`NOT_SUPPORTED` where it does not know\n"
        "the message either, otherwise `MALFORMED`. Between entities it is `PERMISSION_DENIED`.\n"
        "By the [direct path](direct.md) only the holder sends, and of these `CHECKOUT` and `REARM` go by "
        "the servers.\n";
    return page;
}

}  // namespace axon
