// SPDX-License-Identifier: GPL-2.0-or-later
#include <Ice/Ice.h>
#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <google/protobuf/util/message_differencer.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "common/frame.hpp"
#include "compatibility/samples.hpp"
#include "direct/lane/frames.hpp"
#include "direct/lane/opening.hpp"
#include "entity_manager/core/collaboration/run_records.hpp"
#include "entity_manager/core/inputs/saved_values.hpp"
#include "entity_manager/core/kept_identity.hpp"
#include "entity_manager/core/stops/latch.hpp"
#include "entity_manager/core/stops/stop_ledger.hpp"
#include "entity_manager/core/turn/lease_book.hpp"
#include "entity_manager/identity.hpp"
#include "entity_manager/storage/file_journal.hpp"
#include "entity_manager/storage/file_storage.hpp"
#include "transport/ice/bound_uuid.hpp"
#include "transport/ice/convert.hpp"

// What release 0.1 wrote is read by today's code, and today's code writes what release 0.1 reads
// (docs/reference/compatibility.md). What was recorded is in the folders beside this file.
namespace axon::compatibility {
namespace {

namespace fs = std::filesystem;
namespace pb = google::protobuf;
namespace em = entity_manager;

const fs::path kRecorded = "tests/compatibility/0.1";
constexpr std::uint32_t kRecordedContract = 3;

struct RecordedMessage {
    std::string type, bytes, text;
};

std::vector<std::string> linesOf(const fs::path& file) {
    std::ifstream in(file);
    std::vector<std::string> lines;
    for (std::string line; std::getline(in, line);) lines.push_back(line);
    EXPECT_FALSE(lines.empty()) << file;
    return lines;
}

std::vector<RecordedMessage> recordedMessages() {
    std::vector<RecordedMessage> found;
    for (const auto& line : linesOf(kRecorded / "messages.txt")) {
        if (line.starts_with("message ")) found.push_back({line.substr(8), {}, {}});
        if (line.starts_with(" bytes ")) found.back().bytes = bytesOf(line.substr(7));
        if (line.starts_with(" text ")) found.back().text = line.substr(6);
    }
    return found;
}

std::map<std::string, std::string> recordedFrames() {
    std::map<std::string, std::string> found;
    for (const auto& line : linesOf(kRecorded / "frames.txt")) {
        const auto space = line.find(' ');
        found[line.substr(0, space)] = bytesOf(line.substr(space + 1));
    }
    return found;
}

bool hasUnknownFields(const pb::Message& message) {
    const auto* reflection = message.GetReflection();
    if (!reflection->GetUnknownFields(message).empty()) return true;
    std::vector<const pb::FieldDescriptor*> fields;
    reflection->ListFields(message, &fields);
    for (const auto* field : fields) {
        if (field->cpp_type() != pb::FieldDescriptor::CPPTYPE_MESSAGE) continue;
        if (!field->is_repeated()) {
            if (hasUnknownFields(reflection->GetMessage(message, field))) return true;
            continue;
        }
        for (int i = 0; i < reflection->FieldSize(message, field); ++i)
            if (hasUnknownFields(reflection->GetRepeatedMessage(message, field, i))) return true;
    }
    return false;
}

TEST(WireFormat, EveryRecordedMessageIsReadAndWrittenAsInItsRelease) {
    std::map<std::string, const pb::Descriptor*> types;
    for (const auto* type : messageTypes()) types[type->full_name()] = type;
    const auto recorded = recordedMessages();
    EXPECT_GT(recorded.size(), 150U) << "the record is not whole";
    for (const auto& one : recorded) {
        ASSERT_TRUE(types.contains(one.type)) << one.type << " was a message of 0.1 and is none today";
        auto* factory = pb::MessageFactory::generated_factory();
        const std::unique_ptr<pb::Message> expected(factory->GetPrototype(types[one.type])->New());
        const std::unique_ptr<pb::Message> read(factory->GetPrototype(types[one.type])->New());
        ASSERT_TRUE(pb::TextFormat::ParseFromString(one.text, expected.get()))
            << one.type << " has lost a field: " << one.text;
        ASSERT_TRUE(read->ParseFromString(one.bytes)) << one.type << ": " << one.text;
        EXPECT_FALSE(hasUnknownFields(*read))
            << one.type << " has a field with another number or type: " << one.text;
        EXPECT_TRUE(pb::util::MessageDifferencer::Equals(*expected, *read))
            << one.type << "\nwas written as " << one.text << "\nand is read as " << read->ShortDebugString();
        EXPECT_EQ(hexOf(expected->SerializeAsString()), hexOf(one.bytes)) << one.type << ": " << one.text;
    }
}

TEST(WireFormat, EveryRecordedNumberOfAnEnumerationMeansTheSame) {
    std::map<std::string, const pb::EnumDescriptor*> types;
    for (const auto* type : enumerations()) types[type->full_name()] = type;
    int values = 0;
    for (const auto& line : linesOf(kRecorded / "messages.txt")) {
        std::istringstream words(line);
        std::string word, name;
        if (!(words >> word >> name) || word != "enum") continue;
        ASSERT_TRUE(types.contains(name)) << name << " was an enumeration of 0.1 and is none today";
        while (words >> word) {
            const auto equals = word.find('=');
            const auto* value = types[name]->FindValueByName(word.substr(0, equals));
            ASSERT_NE(value, nullptr) << name << " has lost " << word;
            EXPECT_EQ(value->number(), std::stoi(word.substr(equals + 1))) << name << ' ' << word;
            ++values;
        }
    }
    EXPECT_GT(values, 100) << "the record is not whole";
}

TEST(WireFormat, FramesOfTheLinkAreCutAsInTheirRelease) {
    FrameReader reader;
    reader.feed(recordedFrames().at("link-frame"));
    std::string payload;
    ASSERT_TRUE(reader.next(payload));
    EXPECT_EQ(payload, "content");
}

TEST(WireFormat, ARecordedStopDatagramStops) {
    const auto bytes = recordedFrames().at("stop-datagram");
    EXPECT_EQ(datagrams::leaseOf(bytes), sampleDatagram().lease);
    const auto read = datagrams::decode(bytes, kKey);
    ASSERT_TRUE(read);
    EXPECT_EQ(*read, sampleDatagram());
}

/// Without its length.
std::string contentOf(const std::string& frame) {
    FrameReader reader;
    reader.feed(frame);
    std::string payload;
    EXPECT_TRUE(reader.next(payload));
    return payload;
}

TEST(WireFormat, ARecordedClaimOfADirectPathIsUnderstood) {
    direct::lane::ManagerOpening manager(sampleClaim().nonce);
    const auto answer = manager.onFrame(contentOf(recordedFrames().at("direct-claim")));
    if (direct::lane::kContract != kRecordedContract) {
        ASSERT_TRUE(std::holds_alternative<Refusal>(answer));
        EXPECT_EQ(std::get<Refusal>(answer).code, RefusalCode::NotSupported);
        EXPECT_THAT(std::get<Refusal>(answer).message, testing::HasSubstr("upgrade the other side"));
        return;
    }
    ASSERT_TRUE(std::holds_alternative<direct::lane::ManagerOpening::Claimed>(answer));
    const auto& claimed = std::get<direct::lane::ManagerOpening::Claimed>(answer);
    EXPECT_EQ(claimed.claim.lease, sampleClaim().lease);
    EXPECT_EQ(claimed.claim.client, sampleClaim().client);
    EXPECT_EQ(claimed.claim.path, sampleClaim().path);
    EXPECT_TRUE(direct::proves(claimed.proof, sampleClaim(), direct::Prover::Client, kKey));
}

TEST(WireFormat, ARecordedEntityManagerOpensADirectPathForTodaysClient) {
    const auto frames = recordedFrames();
    direct::lane::ClientOpening client(
        sampleClaim(), [](const Id128&) { return std::string(32, 'p'); },
        [](std::string_view proof) {
            return direct::proves(proof, sampleClaim(), direct::Prover::EntityManager, kKey);
        });
    const auto claim = client.onFrame(contentOf(frames.at("direct-nonce")));
    if (direct::lane::kContract != kRecordedContract) {
        ASSERT_TRUE(std::holds_alternative<Refusal>(claim));
        EXPECT_EQ(std::get<Refusal>(claim).code, RefusalCode::NotSupported);
        return;
    }
    ASSERT_TRUE(std::holds_alternative<std::string>(claim));
    const auto over = client.onFrame(contentOf(frames.at("direct-proof")));
    EXPECT_TRUE(std::holds_alternative<std::string>(over));
    EXPECT_EQ(client.state(), direct::lane::ClientOpening::State::Open);
}

TEST(WireFormat, ARecordedRefusalOfADirectPathIsShown) {
    direct::lane::ClientOpening client(
        sampleClaim(), [](const Id128&) { return std::string(32, 'p'); },
        [](std::string_view) { return true; });
    const auto answer = client.onFrame(contentOf(recordedFrames().at("direct-refusal")));
    ASSERT_TRUE(std::holds_alternative<Refusal>(answer));
    EXPECT_EQ(std::get<Refusal>(answer).code, RefusalCode::NotHolder);
    EXPECT_THAT(std::get<Refusal>(answer).message, testing::HasSubstr("not the holder"));
}

TEST(WireFormat, RecordedMessagesOfADirectPathKeepTheirHead) {
    const auto expected = sampleHeader();
    for (const auto* name : {"direct-message", "direct-droppable"}) {
        const auto frame = contentOf(recordedFrames().at(name));
        const auto read = direct::lane::messageIn(frame);
        ASSERT_TRUE(read) << name;
        EXPECT_EQ(read->keeping, std::string_view(name) == "direct-message" ? direct::Keeping::Kept
                                                                            : direct::Keeping::Droppable);
        EXPECT_EQ(read->held, expected.held);
        EXPECT_EQ(read->stop_generation, expected.stop_generation);
        EXPECT_EQ(read->sequence, expected.sequence);
        EXPECT_EQ(read->sent_at_us, expected.sent_at_us);
        EXPECT_EQ(read->msg_type, expected.msg_type);
        EXPECT_EQ(read->content, "content");
    }
}

TEST(WireFormat, WhatIceCarriesIsReadAsInItsRelease) {
    const auto frames = recordedFrames();
    const Ice::CommunicatorHolder communicator(Ice::initialize());
    const auto read = [&](const char* name, auto value) {
        const auto& text = frames.at(name);
        const std::vector<Ice::Byte> bytes(text.begin(), text.end());
        Ice::InputStream in(communicator.communicator(), bytes);
        in.read(value);
        EXPECT_EQ(in.pos(), bytes.size()) << name;
        return transport::fromIce(std::move(value));
    };
    const auto head = read("slice-header", transport::ice::Header{});
    EXPECT_EQ(head.sender, sampleHeader().sender);
    EXPECT_EQ(head.entity, sampleHeader().entity);
    EXPECT_EQ(head.msg_type, sampleHeader().msg_type);
    EXPECT_EQ(head.held, sampleHeader().held);
    EXPECT_EQ(head.stop_generation, sampleHeader().stop_generation);
    EXPECT_EQ(head.sequence, sampleHeader().sequence);
    EXPECT_EQ(head.sent_at_us, sampleHeader().sent_at_us);
    EXPECT_EQ(read("slice-registration", transport::ice::Registration{}), sampleRegistration());
    EXPECT_EQ(read("slice-status", transport::ice::EntityStatus{}), sampleStatus());
    EXPECT_EQ(read("slice-announcement", transport::ice::ServerAnnouncement{}), sampleAnnouncement());
}

TEST(WireFormat, TodaysCodeWritesTheRecordedBytes) {
    const auto recorded = recordedFrames();
    const auto now = encodedNow();
    EXPECT_EQ(now.size(), recorded.size());
    for (const auto& [name, bytes] : now) {
        if (direct::lane::kContract != kRecordedContract &&
            (name == "direct-nonce" || name == "direct-claim"))
            continue;  // it names the contract
        ASSERT_TRUE(recorded.contains(name)) << name;
        EXPECT_EQ(hexOf(bytes), hexOf(recorded.at(name))) << name;
    }
}

struct RecordedState : testing::Test {
    RecordedState() {
        std::string name = (fs::temp_directory_path() / "axon-state-XXXXXX").string();
        folder = ::mkdtemp(name.data());
        fs::copy(kRecorded / "state", folder);
    }
    ~RecordedState() override { fs::remove_all(folder); }
    fs::path folder;
    SeededRandom random{7};
};

TEST_F(RecordedState, IsTheSameEntityAndCountsOn) {
    em::FileStorage storage(folder);
    EXPECT_FALSE(em::partsAreLost(storage));
    const auto identity = em::identityIn(storage, random);
    EXPECT_TRUE(transport::mayRegister(identity.uuid, identity.secret));
    EXPECT_EQ(em::loadUuid(storage, random, {}), identity.uuid);
    EXPECT_EQ(em::LeaseBook(storage, random).last(), (LeaseNumber{2, 0})) << "0.1 had epoch 1";
    EXPECT_EQ(storage.load(em::kGenerationKey), "1005");
    EXPECT_FALSE(em::Latch(storage, false).isSet()) << "it was rearmed and released";
}

TEST_F(RecordedState, KeepsItsValuesAndRuns) {
    em::FileStorage storage(folder);
    EXPECT_TRUE(em::SavedValues(storage).findings().empty());
    proto::ServiceParams values;
    ASSERT_TRUE(values.ParseFromString(storage.load("values").value()));
    ASSERT_EQ(values.params_size(), 1);
    EXPECT_EQ(values.params(0).service(), "Driving");
    EXPECT_EQ(values.params(0).param().name(), "Range Threshold");
    EXPECT_EQ(values.params(0).param().values(0).int_(), 500);
    const auto history = em::RunRecords(storage).history(nullptr, 0);
    ASSERT_EQ(history.runs_size(), 1);
    EXPECT_EQ(history.runs(0).by(), "client1@lab");
    EXPECT_EQ(history.runs(0).state(), proto::RUN_SUCCEEDED);
}

TEST_F(RecordedState, HasAJournalThatIsReadWhole) {
    em::FileJournal journal(folder);
    std::vector<em::JournalRecord> read;
    journal.replay([&](const em::JournalRecord& record) { read.push_back(record); });
    EXPECT_THAT(journal.findings(), testing::IsEmpty());
    EXPECT_THAT(read, testing::UnorderedElementsAreArray(sampleJournal()));
}

}  // namespace
}  // namespace axon::compatibility
