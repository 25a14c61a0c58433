// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "common/ids.hpp"
#include "common/routed.hpp"

namespace axon::entity_manager {

/// One decision of the Entity Manager, written down for those who ask afterwards and for its next life
/// (docs/adr/0013-journal.md). A plain value; what an entry does not need stays empty.
struct JournalRecord {
    enum class Kind : std::uint8_t {
        Started,     ///< a life began, under the epoch of `lease`
        Granted,     ///< a check-out
        Lost,        ///< the holder was lost and its lease lives on for the grace
        Resumed,     ///< the holder is back under its lease
        TakenOver,   ///< handed over to `who`, by force or by consent
        LeaseEnded,  ///< for whatever reason
        Refused,     ///< a command or check-out, for reasons of ownership
        Stopped,
        Rearmed,
        Dispatched,  ///< a task; written before it is sent
        TaskEnded,   ///< a task that had been dispatched
        Part,        ///< a further part of a composite task; the first one is its dispatch
        Controlled,  ///< a pause, resume or cancel; mentioned only
    };
    Kind kind = Kind::Started;
    LeaseNumber lease{};           ///< note() fills in the present one
    std::uint32_t generation = 0;  ///< of the stops; note() fills in the present one
    std::int64_t at_us = 0;        ///< of the core's clock; note() fills it in
    std::string who{};             ///< for people: who asked, held or stopped
    std::string client{};          ///< its id, which only the server gives; of an entity, if that asked
    Id128 task{};
    std::string service{};
    std::string code{};  ///< a token: refusal, stop cause or final state of a task
    std::string text{};

    bool operator==(const JournalRecord&) const = default;
};

inline constexpr std::array<std::string_view, 13> kJournalKinds{
    "started", "granted", "lost",       "resumed",    "taken-over", "lease-ended", "refused",
    "stopped", "rearmed", "dispatched", "task-ended", "part",       "controlled"};

inline std::string_view toString(JournalRecord::Kind kind) {
    return kJournalKinds.at(static_cast<std::size_t>(kind));
}
inline std::optional<JournalRecord::Kind> journalKindOf(std::string_view token) {
    for (std::size_t i = 0; i < kJournalKinds.size(); ++i)
        if (kJournalKinds.at(i) == token) return static_cast<JournalRecord::Kind>(i);
    return std::nullopt;
}

}  // namespace axon::entity_manager
