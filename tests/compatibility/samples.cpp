// SPDX-License-Identifier: GPL-2.0-or-later
#include "compatibility/samples.hpp"

#include <Ice/Ice.h>
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <algorithm>
#include <map>
#include <set>
#include <stdexcept>

#include "common/frame.hpp"
#include "direct/lane/frames.hpp"
#include "direct/lane/opening.hpp"
#include "transport/ice/convert.hpp"

namespace axon::compatibility {

namespace pb = google::protobuf;
using entity_manager::JournalRecord;
using entity_manager::kJournalKinds;

namespace {

const std::string kClient = "11111111-1111-4111-8111-111111111111";
const std::string kEntity = "44444444-4444-4444-8444-444444444444";

void collect(const pb::FileDescriptor* file, std::set<const pb::FileDescriptor*>& seen) {
    if (!seen.insert(file).second) return;
    for (int i = 0; i < file->dependency_count(); ++i) collect(file->dependency(i), seen);
}

std::set<const pb::FileDescriptor*> files() {
    std::set<const pb::FileDescriptor*> seen;
    collect(proto::ToEntity::descriptor()->file(), seen);
    collect(proto::EmToEi::descriptor()->file(), seen);
    return seen;
}

void collect(const pb::Descriptor* type, std::map<std::string, const pb::Descriptor*>& types,
             std::map<std::string, const pb::EnumDescriptor*>& enums) {
    types[type->full_name()] = type;
    for (int i = 0; i < type->nested_type_count(); ++i) collect(type->nested_type(i), types, enums);
    for (int i = 0; i < type->enum_type_count(); ++i)
        enums[type->enum_type(i)->full_name()] = type->enum_type(i);
}

std::pair<std::map<std::string, const pb::Descriptor*>, std::map<std::string, const pb::EnumDescriptor*>>
all() {
    std::pair<std::map<std::string, const pb::Descriptor*>, std::map<std::string, const pb::EnumDescriptor*>>
        found;
    for (const auto* file : files()) {
        for (int i = 0; i < file->message_type_count(); ++i)
            collect(file->message_type(i), found.first, found.second);
        for (int i = 0; i < file->enum_type_count(); ++i)
            found.second[file->enum_type(i)->full_name()] = file->enum_type(i);
    }
    return found;
}

/// The value tells the field by its number, so that two fields that change places are noticed.
void fillScalar(pb::Message& message, const pb::FieldDescriptor* field) {
    const auto* reflection = message.GetReflection();
    const auto number = field->number();
    const auto set = [&](auto add, auto put, auto value) {
        if (field->is_repeated()) {
            (reflection->*add)(&message, field, value);
        } else {
            (reflection->*put)(&message, field, value);
        }
    };
    using R = pb::Reflection;
    switch (field->cpp_type()) {
        case pb::FieldDescriptor::CPPTYPE_INT32:
            return set(&R::AddInt32, &R::SetInt32, std::int32_t{-1000} - number);
        case pb::FieldDescriptor::CPPTYPE_INT64:
            return set(&R::AddInt64, &R::SetInt64, std::int64_t{-5'000'000'000} - number);
        case pb::FieldDescriptor::CPPTYPE_UINT32:
            return set(&R::AddUInt32, &R::SetUInt32, 1000U + static_cast<std::uint32_t>(number));
        case pb::FieldDescriptor::CPPTYPE_UINT64:
            return set(&R::AddUInt64, &R::SetUInt64, 5'000'000'000U + static_cast<std::uint64_t>(number));
        case pb::FieldDescriptor::CPPTYPE_DOUBLE:
            return set(&R::AddDouble, &R::SetDouble, number + 0.5);
        case pb::FieldDescriptor::CPPTYPE_FLOAT:
            return set(&R::AddFloat, &R::SetFloat, static_cast<float>(number) + 0.25F);
        case pb::FieldDescriptor::CPPTYPE_BOOL:
            return set(&R::AddBool, &R::SetBool, true);
        case pb::FieldDescriptor::CPPTYPE_STRING: {
            const auto text = field->name() + " \xC3\xA4";  // a letter outside of ASCII
            if (field->is_repeated()) return reflection->AddString(&message, field, text);
            return reflection->SetString(&message, field, text);
        }
        case pb::FieldDescriptor::CPPTYPE_ENUM: {
            const auto* type = field->enum_type();
            const auto* last = type->value(type->value_count() - 1);
            if (field->is_repeated()) return reflection->AddEnum(&message, field, last);
            return reflection->SetEnum(&message, field, last);
        }
        case pb::FieldDescriptor::CPPTYPE_MESSAGE:
            return;
    }
}

bool isMessage(const pb::FieldDescriptor* field) {
    return field->cpp_type() == pb::FieldDescriptor::CPPTYPE_MESSAGE;
}

/// `arm`: which one of the message's oneofs has a value.
void fill(pb::Message& message, int arm, bool inside) {
    const auto* type = message.GetDescriptor();
    for (int i = 0; i < type->field_count(); ++i) {
        const auto* field = type->field(i);
        if (const auto* oneof = field->real_containing_oneof();
            oneof != nullptr && oneof->field(arm % oneof->field_count()) != field)
            continue;
        if (!isMessage(field)) {
            fillScalar(message, field);
        } else if (!inside) {
            auto& within = field->is_repeated() ? *message.GetReflection()->AddMessage(&message, field)
                                                : *message.GetReflection()->MutableMessage(&message, field);
            fill(within, 0, true);
        }
    }
}

template <class T>
std::string bytesOfIce(const Ice::CommunicatorPtr& communicator, const T& value) {
    Ice::OutputStream out(communicator);
    out.write(value);
    std::vector<Ice::Byte> bytes;
    out.finished(bytes);
    return {bytes.begin(), bytes.end()};
}

}  // namespace

std::vector<const pb::Descriptor*> messageTypes() {
    std::vector<const pb::Descriptor*> types;
    for (const auto& [name, type] : all().first) types.push_back(type);
    return types;
}

std::vector<const pb::EnumDescriptor*> enumerations() {
    std::vector<const pb::EnumDescriptor*> types;
    for (const auto& [name, type] : all().second) types.push_back(type);
    return types;
}

std::vector<std::unique_ptr<pb::Message>> samplesOf(const pb::Descriptor* type) {
    int arms = 1;
    for (int i = 0; i < type->real_oneof_decl_count(); ++i)
        arms = std::max(arms, type->oneof_decl(i)->field_count());
    std::vector<std::unique_ptr<pb::Message>> made;
    for (int arm = 0; arm < arms; ++arm) {
        made.emplace_back(pb::MessageFactory::generated_factory()->GetPrototype(type)->New());
        fill(*made.back(), arm, false);
    }
    return made;
}

Header sampleHeader() {
    Header head;
    head.sender = {kClient, "client1@lab", Role::Admin};
    head.entity = kEntity;
    head.msg_type = kMsgTask;
    head.held = {3, 7};
    head.stop_generation = 5;
    head.sequence = std::int64_t{1} << 40;
    head.sent_at_us = 1'000'000;
    return head;
}

Registration sampleRegistration() {
    Registration made;
    made.entity = kEntity;
    made.name = "PeopleBot";
    made.category = "ROBOT";
    made.type = "MOBILE";
    made.heartbeat_busy_ms = 50;
    made.heartbeat_idle_ms = 2000;
    made.server = "es1";
    return made;
}

EntityStatus sampleStatus() {
    EntityStatus made;
    made.entity = kEntity;
    made.state = EntityState::BUSY;
    made.latched = true;
    made.stop_generation = 5;
    made.holder = {kClient, "client1@lab", Role::Operator};
    made.held = {3, 7};
    made.reason = "why";
    made.orphaned = true;
    made.waiting = 2;
    made.stop_latency_us = 850;
    made.server = "es1";
    return made;
}

ServerAnnouncement sampleAnnouncement() {
    ServerAnnouncement made;
    made.name = "es1";
    made.instance = "1";
    made.signals = "signals:tcp -h 127.0.0.1 -p 10440";
    made.messages = "messages:tcp -h 127.0.0.1 -p 10441";
    made.published = 12;
    return made;
}

datagrams::StopDatagram sampleDatagram() {
    datagrams::StopDatagram made;
    made.lease = {3, 7};
    made.generation = 5;
    made.sequence = 9;
    made.sent_at_us = 1'000'000;
    made.sender = Id128::parse(kClient).value();
    return made;
}

direct::Claim sampleClaim() {
    direct::Claim made;
    made.lease = {3, 7};
    made.client = Id128::parse(kClient).value();
    made.path = Id128::parse("22222222-2222-4222-8222-222222222222").value();
    made.nonce = Id128::parse("33333333-3333-4333-8333-333333333333").value();
    return made;
}

std::vector<JournalRecord> sampleJournal() {
    std::vector<JournalRecord> records;
    for (std::size_t i = 0; i < kJournalKinds.size(); ++i) {
        JournalRecord record;
        record.kind = static_cast<JournalRecord::Kind>(i);
        if (record.kind == JournalRecord::Kind::Controlled) continue;  // it is never written
        record.lease = {3, static_cast<std::int32_t>(i) + 1};
        record.generation = 5;
        record.at_us = 1'000'000 + static_cast<std::int64_t>(i);
        record.who = "client1@lab";
        record.task = Id128::parse(kClient).value();
        record.service = "Driving";
        record.code = "TASK_STOPPED";
        record.text = "a \"quoted\" text \xC3\xA4";
        records.push_back(record);
    }
    return records;
}

std::vector<std::pair<std::string, std::string>> encodedNow() {
    std::vector<std::pair<std::string, std::string>> made;
    const auto add = [&](const char* name, std::string bytes) { made.emplace_back(name, std::move(bytes)); };

    std::string link_frame;
    appendFrame(link_frame, "content");
    add("link-frame", link_frame);

    const auto datagram = datagrams::encode(sampleDatagram(), kKey);
    add("stop-datagram", {datagram.data(), datagram.size()});

    const auto claim = sampleClaim();
    const auto proof = direct::proofOf(claim, direct::Prover::Client, kKey);
    direct::lane::ManagerOpening manager(claim.nonce);
    const auto greeting = manager.greeting();
    add("direct-nonce", greeting);
    direct::lane::ClientOpening client(
        claim, [&](const Id128&) { return proof; }, [](std::string_view) { return true; });
    add("direct-claim", std::get<std::string>(client.onFrame(std::string_view(greeting).substr(4))));
    add("direct-proof", manager.admit(direct::proofOf(claim, direct::Prover::EntityManager, kKey)));
    add("direct-refusal",
        direct::lane::ManagerOpening(claim.nonce).refuse({RefusalCode::NotHolder, "not the holder", {}}));
    for (const auto keeping : {direct::Keeping::Kept, direct::Keeping::Droppable}) {
        const auto head = direct::lane::headOf(keeping, sampleHeader(), 7).value();
        add(keeping == direct::Keeping::Kept ? "direct-message" : "direct-droppable",
            std::string(head.view()) + "content");
    }

    // Ice's own encoding of what every routed operation carries.
    const Ice::CommunicatorHolder communicator(Ice::initialize());
    add("slice-header", bytesOfIce(communicator.communicator(), transport::toIce(sampleHeader())));
    add("slice-registration",
        bytesOfIce(communicator.communicator(), transport::toIce(sampleRegistration())));
    add("slice-status", bytesOfIce(communicator.communicator(), transport::toIce(sampleStatus())));
    add("slice-announcement",
        bytesOfIce(communicator.communicator(), transport::toIce(sampleAnnouncement())));
    return made;
}

std::string hexOf(std::string_view bytes) {
    static constexpr char kDigits[] = "0123456789abcdef";
    std::string text;
    for (const unsigned char c : bytes) text += {kDigits[c >> 4U], kDigits[c & 15U]};
    return text;
}

std::string bytesOf(std::string_view hex) {
    std::string bytes;
    if (hex.size() % 2 != 0) throw std::invalid_argument("an odd number of hexadecimal digits");
    for (std::size_t i = 0; i < hex.size(); i += 2)
        bytes += static_cast<char>(std::stoi(std::string(hex.substr(i, 2)), nullptr, 16));
    return bytes;
}

}  // namespace axon::compatibility
