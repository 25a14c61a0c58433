// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "common/routed.hpp"
#include "datagrams/stop_datagram.hpp"
#include "direct/proof.hpp"
#include "entity_manager/ports/journal_record.hpp"

// What was recorded of release 0.1: one sample of everything that a program of another release may read. The
// recorder (record.cpp) wrote them once; wire_format_test.cpp reads what it wrote.
namespace axon::compatibility {

/// Every message type of api/proto/axon, by name.
std::vector<const google::protobuf::Descriptor*> messageTypes();
/// Every enumeration of api/proto/axon, by name.
std::vector<const google::protobuf::EnumDescriptor*> enumerations();

/// Messages of this type with a value in every field. One for each arm of its oneofs, if it has any. A
/// message inside has values in its own scalar fields only: its type has samples itself.
std::vector<std::unique_ptr<google::protobuf::Message>> samplesOf(const google::protobuf::Descriptor* type);

Header sampleHeader();
Registration sampleRegistration();
EntityStatus sampleStatus();
ServerAnnouncement sampleAnnouncement();
datagrams::StopDatagram sampleDatagram();
direct::Claim sampleClaim();
/// One of each kind.
std::vector<entity_manager::JournalRecord> sampleJournal();

/// Of the lease in the samples.
inline constexpr const char* kKey = "0123456789abcdef";

/// Everything but protobuf, as today's code writes it: name and bytes.
std::vector<std::pair<std::string, std::string>> encodedNow();

std::string hexOf(std::string_view bytes);
/// Throws std::invalid_argument where the text is not hexadecimal.
std::string bytesOf(std::string_view hex);

}  // namespace axon::compatibility
