// SPDX-License-Identifier: GPL-2.0-or-later
// Any bytes are a profile or findings, never a crash; and a profile without an error survives writer and
// reader.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "claim.hpp"
#include "messages/profile_reader.hpp"
#include "messages/profile_writer.hpp"

namespace {

template <class Read, class Write>
void exercise(std::string_view xml, const Read& read, const Write& write) {
    const auto reading = read(xml, "fuzz.xml");
    require(reading.findings.size() <= axon::kMaxFindings + 1, "the number of findings is bounded");
    for (const auto& finding : reading.findings) {
        require(finding.line >= 0, "lines are counted from 1, 0 for the whole file");
        require(!finding.element.empty() && !finding.expected.empty() && !finding.fix.empty(),
                "a finding is complete");
    }
    // The writer indents, and writes choices as elements: a text near the limits may leave them. From 16 KiB
    // no text can.
    if (!reading.ok() || xml.size() > 16 * 1024) return;
    const auto again = read(write(reading.message), "again.xml");
    require(again.ok(), "what the writer writes is a profile");
    require(again.message.SerializeAsString() == reading.message.SerializeAsString(),
            "writing and reading change nothing");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    const std::string_view xml(reinterpret_cast<const char*>(bytes), size);
    switch (axon::detectKind(xml)) {
        case axon::ProfileKind::Services:
            exercise(xml, axon::readServicesProfile, axon::writeServicesProfile);
            break;
        case axon::ProfileKind::Global:
            exercise(xml, axon::readGlobalProfile, axon::writeGlobalProfile);
            break;
        default:
            exercise(xml, axon::readBasicProfile, axon::writeBasicProfile);
            break;
    }
    return 0;
}
