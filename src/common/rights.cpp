// SPDX-License-Identifier: MIT
#include "common/rights.hpp"

#include <algorithm>
#include <array>

#include "common/refusal.hpp"
#include "common/routed.hpp"

namespace axon {

namespace {

constexpr std::array kRights{
    Right{kStopOperation, "", 0, Who::Anyone, Peers::No, std::nullopt},
    Right{kResetOperation, "", 0, Who::Holder, Peers::No},
    Right{kClearOperation, "", 0, Who::Holder, Peers::No},
    Right{kMsgCheckOut, "check_out", 1, Who::Operator, Peers::No, EntityRight::CheckOut},
    Right{kMsgRelease, "release", 2, Who::Holder, Peers::No},
    Right{kMsgParam, "set_param", 3, Who::Holder, Peers::No},
    Right{kMsgTask, "task", 4, Who::Holder, Peers::No},
    Right{kMsgTaskControl, "task_control", 5, Who::Holder, Peers::No},
    Right{kMsgResource, "resource_offer", 6, Who::Holder, Peers::No},
    Right{kMsgResource, "resource_chunk", 7, Who::Holder, Peers::No},
    Right{kMsgText, "text", 8, Who::Holder, Peers::No},
    Right{kMsgRaw, "raw", 9, Who::Holder, Peers::OfRun},
    Right{kMsgRearm, "rearm", 10, Who::HolderOrAdmin, Peers::No, EntityRight::Rearm},
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

/// The rights that a client needs of the lists.
std::string listed(const Right& right) {
    if (right.who == Who::Nobody) return "";
    if (!right.needs) return "none";
    if (*right.needs == EntityRight::See) return toString(EntityRight::See);
    return std::string(toString(EntityRight::See)) + ", " + toString(*right.needs);
}

}  // namespace

const char* toString(EntityRight right) {
    switch (right) {
        case EntityRight::See:
            return "see";
        case EntityRight::CheckOut:
            return "checkout";
        case EntityRight::Force:
            return "force";
        case EntityRight::Rearm:
            return "rearm";
    }
    return "?";
}

std::optional<EntityRight> entityRight(std::string_view text) {
    for (const auto right : kEntityRights)
        if (text == toString(right)) return right;
    return std::nullopt;
}

EntityRight neededFor(std::string_view msg_type) {
    for (const auto& right : kRights)
        if (right.number != 0 && right.msg_type == msg_type && right.needs) return *right.needs;
    return EntityRight::See;
}

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
        "This page is for everybody who writes a client or an Entity Manager, and for everybody whose "
        "message was refused.\n"
        "It lists every message to an entity and who may send it.\n"
        "\n"
        "Servers and Entity Managers consult one table, `src/common/rights.cpp`, and this page is made "
        "from it.\n"
        "Servers see only the `msgType` of the header.\n"
        "The Entity Manager also checks that the message is the one that its `msgType` names; otherwise "
        "it refuses the message (`MALFORMED`).\n"
        "Tests try every kind of sender: `src/entity_manager/core/rights_test.cpp`, and `tests/hostile` "
        "with real sessions.\n"
        "\n"
        "| column | who sends |\n"
        "|---|---|\n"
        "| observer, operator, administrator | a client of this "
        "[role](server_configuration.md#who-may-log-in-userscfg) that does not hold the entity |\n"
        "| holder | an operator that holds the entity |\n"
        "| entity | the Entity Manager of another robot |\n"
        "\n"
        "| cell | meaning |\n"
        "|---|---|\n"
        "| yes | permitted, if the header has [what the message must "
        "show](messages.md#what-a-message-must-show) |\n"
        "| a code | refused with this code |\n"
        "| of a run | the server passes it on; the Entity Manager accepts it only from a participant of "
        "the same run, or as an invitation to a run with the client's seal |\n"
        "\n"
        "The codes are those of an entity that somebody holds.\n"
        "If nobody holds it, the refusal has the code of the entity's state instead.\n"
        "A client that once held the entity gets, instead of `NOT_HOLDER`, the code that says how it "
        "lost its lease ([refusals](refusals.md#what-a-header-lacks)).\n"
        "\n"
        "The column *list* is for the [lists of an entity](server_configuration.md#lists-of-an-entity), "
        "which a "
        "front-end server asks for every client before it passes a message on.\n"
        "It names the right that the client needs, and *none* where no list is asked: a stop is never kept "
        "back.\n"
        "Without the right to see, a message is refused with `UNKNOWN_ENTITY`, as if there were no such "
        "entity; without the other one, with `PERMISSION_DENIED`.\n"
        "A `CHECKOUT` by force needs the right *force* as well; without it the Entity Manager refuses the "
        "force, as an operator's.\n"
        "\n"
        "| msgType, or the operation of a signal | `ToEntity` | observer | operator | administrator | holder "
        "| entity | list |\n"
        "|---|---|---|---|---|---|---|---|\n";
    for (const auto& right : kRights) {
        page += "| `" + std::string(right.msg_type) + "` | " +
                (right.body.empty() ? "" : "`" + std::string(right.body) + '`') + " | " +
                cell(right.who, false, false, false) + " | " + cell(right.who, true, false, false) + " | " +
                cell(right.who, true, true, false) + " | " + cell(right.who, true, false, true) + " | " +
                (right.number == 0             ? "no such operation"
                 : right.peers == Peers::OfRun ? "of a run"
                                               : std::string(refusalName(RefusalCode::PermissionDenied))) +
                " | " + listed(right) + " |\n";
    }
    page +=
        "\n"
        "`GLOBAL_SERVICES` is for the front-end server itself, which gets it by `sendRequest`.\n"
        "\n"
        "A server passes on a client's message whose `msgType` the table does not have, so that a new "
        "kind of message needs no new servers.\n"
        "The Entity Manager refuses it: with `MALFORMED` if it knows the message itself, otherwise with "
        "`NOT_SUPPORTED`.\n"
        "Between entities, the server refuses such a message with `PERMISSION_DENIED`.\n"
        "\n"
        "Only the holder sends over the [direct path](direct.md).\n"
        "Its `CHECKOUT` and `REARM` go through the servers all the same.\n";
    return page;
}

}  // namespace axon
