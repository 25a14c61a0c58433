// SPDX-License-Identifier: GPL-2.0-or-later
// The table of common/rights.hpp against what the Entity Manager does, and against the contracts and the
// page.
#include "common/rights.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <vector>

#include "common/refusal.hpp"
#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

/// The refusal of any kind of answer; none: OK.
int codeOf(const proto::ToClient& answer) {
    switch (answer.body_case()) {
        case proto::ToClient::kCheckOut:
            return answer.check_out().refusal().code();
        case proto::ToClient::kReply:
            return answer.reply().refusal().code();
        case proto::ToClient::kTask:
            return answer.task().reason().code();
        case proto::ToClient::kResourceDone:
            return answer.resource_done().refusal().code();
        default:
            return 0;
    }
}

/// The message of this right with nothing in it, but for what makes it a request at all.
proto::ToEntity messageOf(const Right& right) {
    proto::ToEntity message;
    const auto* field = proto::ToEntity::descriptor()->FindFieldByNumber(right.number);
    message.GetReflection()->MutableMessage(&message, field);
    if (message.has_task_control()) message.mutable_task_control()->set_action(proto::CANCEL);
    if (message.has_check_out()) message.mutable_check_out()->set_request_id(std::string(16, 'r'));
    return message;
}

/// What `client` is answered while client1 holds the robot: PERMISSION_DENIED and NOT_HOLDER, or 0 where it
/// may.
std::string deniedTo(const std::string& client, const proto::ToEntity& message) {
    test::CoreRig rig;
    rig.makeIdle();
    rig.take("client1", "r1");
    static_cast<void>(rig.headOf(client));
    rig.to_clients.clear();
    rig.send(client, message);
    for (const auto& record : rig.to_clients) {
        if (record.head.sender.id != client) continue;
        const auto code = static_cast<RefusalCode>(codeOf(record.message));
        if (code == RefusalCode::PermissionDenied || code == RefusalCode::NotHolder)
            return std::string(refusalName(code));
    }
    return {};
}

std::string deniedAs(bool may, RefusalCode otherwise) {
    return may ? "" : std::string(refusalName(otherwise));
}

TEST(Rights, TheEntityManagerGoesByTheTable) {
    for (const auto& right : rights()) {
        if (right.number == 0 || right.who == Who::Nobody) continue;
        const auto message = messageOf(right);
        const bool anyone = right.who == Who::Anyone, operators = right.who == Who::Operator;
        const auto otherwise = operators ? RefusalCode::PermissionDenied : RefusalCode::NotHolder;
        EXPECT_EQ(deniedTo("observer", message), deniedAs(anyone, otherwise)) << right.body;
        EXPECT_EQ(deniedTo("client2", message), deniedAs(anyone || operators, otherwise)) << right.body;
        EXPECT_EQ(deniedTo("admin", message),
                  deniedAs(anyone || operators || right.who == Who::HolderOrAdmin, otherwise))
            << right.body;
        EXPECT_EQ(deniedTo("client1", message), "") << right.body;
    }
}

TEST(Rights, StopIsAnybodysResetAndClearAreTheHolders) {
    for (const auto* client : {"observer", "client2", "admin", "client1"}) {
        test::CoreRig stopped;
        stopped.makeIdle();
        stopped.take("client1", "r1");
        stopped.stop(client);
        EXPECT_TRUE(stopped.core().latched()) << client;
        for (const bool clears : {false, true}) {
            test::CoreRig rig;
            rig.makeIdle();
            rig.take("client1", "r1");
            rig.to_clients.clear();
            if (clears)
                rig.clear(client);
            else
                rig.reset(client);
            const bool refused =
                codeOf(rig.to_clients.at(0).message) == static_cast<int>(RefusalCode::NotHolder);
            EXPECT_EQ(refused, client != std::string("client1")) << client << clears;
        }
    }
    EXPECT_EQ(rightOfSignal(kResetOperation).who, Who::Holder);
    EXPECT_EQ(rightOfSignal(kClearOperation).who, Who::Holder);
    EXPECT_EQ(rightOfSignal(kStopOperation).who, Who::Anyone);
}

TEST(Rights, EachFieldOfTheContractHasOneRowUnderItsNumber) {
    const auto& body = *proto::ToEntity::descriptor()->FindOneofByName("body");
    int fields = 0;
    for (const auto& right : rights()) fields += right.number != 0 ? 1 : 0;
    EXPECT_EQ(fields, body.field_count());
    for (int i = 0; i < body.field_count(); ++i) {
        const auto* right = rightOf(body.field(i)->number());
        ASSERT_NE(right, nullptr) << body.field(i)->name();
        EXPECT_EQ(right->body, body.field(i)->name());
    }
    EXPECT_EQ(rightOf(0), nullptr);
    EXPECT_EQ(rightOf(1000), nullptr);
}

TEST(Rights, AMessageIsWhatItsHeaderSays) {
    for (const auto& right : rights()) {
        if (right.number == 0) continue;
        for (const auto& other : rights()) {
            if (other.number == 0 || other.msg_type == right.msg_type) continue;
            test::CoreRig rig;
            rig.makeIdle();
            rig.take("client1", "r1");
            auto head = rig.headOf("client1");
            head.msg_type = other.msg_type;
            rig.to_clients.clear();
            rig.core().onClientMsg(head, messageOf(right).SerializeAsString());
            ASSERT_FALSE(rig.to_clients.empty()) << right.body << " as " << other.msg_type;
            EXPECT_EQ(codeOf(rig.to_clients[0].message), static_cast<int>(RefusalCode::Malformed))
                << right.body << " as " << other.msg_type << ": "
                << rig.to_clients[0].message.ShortDebugString();
            EXPECT_EQ(rig.core().counters().malformed, 1U);
        }
    }
}

TEST(Rights, AKnownMessageUnderAnUnknownNameIsRefused) {
    test::CoreRig rig;
    rig.makeIdle();
    rig.take("client1", "r1");
    auto head = rig.headOf("client1");
    head.msg_type = "WEATHER";
    proto::ToEntity text;
    text.mutable_text()->set_text("go");
    rig.to_clients.clear();
    rig.core().onClientMsg(head, text.SerializeAsString());
    EXPECT_EQ(codeOf(rig.to_clients.at(0).message), static_cast<int>(RefusalCode::Malformed));
    rig.core().onClientMsg(head, "");  // a field that this edition does not know reads as none
    EXPECT_EQ(codeOf(rig.to_clients.at(1).message), static_cast<int>(RefusalCode::NotSupported));
}

TEST(Rights, ServersPassOnWhatTheTableDoesNotKnowForClientsOnly) {
    EXPECT_TRUE(clientsMaySend("WEATHER"));
    EXPECT_FALSE(entitiesMaySend("WEATHER"));
    EXPECT_FALSE(clientsMaySend("COLLABORATION"));
    EXPECT_FALSE(clientsMaySend("GLOBAL_SERVICES"));
    EXPECT_TRUE(entitiesMaySend("COLLABORATION"));
    EXPECT_TRUE(entitiesMaySend("RAW"));
    EXPECT_FALSE(entitiesMaySend("sendStopSignal"));
}

TEST(Rights, EachMessageThatAClientMaySendHasARowInTheReference) {
    std::vector<std::string> lines;
    std::ifstream page("docs/reference/messages.md");
    for (std::string line; std::getline(page, line);) lines.push_back(line);
    for (const auto& right : rights()) {
        if (right.number == 0 || right.who == Who::Nobody) continue;
        const auto* field = proto::ToEntity::descriptor()->FindFieldByNumber(right.number);
        const auto row = "| `" + std::string(right.msg_type) + "` |";
        const auto message = '`' + field->message_type()->name() + '`';
        EXPECT_TRUE(std::any_of(lines.begin(), lines.end(),
                                [&](const std::string& line) {
                                    return line.starts_with(row) && line.find(message) != std::string::npos;
                                }))
            << "docs/reference/messages.md has no row of " << right.msg_type << " with " << message;
    }
}

TEST(Rights, ThePageInTheDocumentationIsFresh) {
    const char* path = "docs/reference/rights.md";
    if (std::getenv("AXON_RERECORD") != nullptr) std::ofstream(path, std::ios::binary) << rightsPage();
    std::stringstream page;
    page << std::ifstream(path, std::ios::binary).rdbuf();
    EXPECT_EQ(page.str(), rightsPage()) << path << " is stale: run this test with AXON_RERECORD=1";
}

}  // namespace
}  // namespace axon::entity_manager
