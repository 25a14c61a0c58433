// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <string_view>

namespace axon::audit {

/// What a record is about. docs/reference/audit.md says which station records which.
enum class Kind : std::uint8_t {
    Started,    ///< the program began to record
    Login,      ///< somebody was let in
    Session,    ///< a client or an entity joined or left
    Ownership,  ///< a check-out, its end, its loss, its resumption
    TakeOver,   ///< a robot passed to another holder
    Command,    ///< what a client asked of an entity; a task that began, and how it ended
    Refusal,    ///< of a log-in or a command
    Stop,
    Rearm,
    Lost,  ///< records that could not be kept
};

inline constexpr std::array<std::string_view, 10> kKinds{
    "started", "login", "session", "ownership", "take-over", "command", "refusal", "stop", "rearm", "lost"};

constexpr std::string_view toString(Kind kind) {
    return kKinds.at(static_cast<std::size_t>(kind));
}

/// Something to record. The texts are copied before note() returns; what is unknown stays empty. Never a
/// password, a value of a parameter, a text between people or a sample.
struct Note {
    Kind kind = Kind::Started;
    std::string_view user{};     ///< as it has logged in
    std::string_view name{};     ///< what the client or the entity calls itself
    std::string_view client{};   ///< id of the client
    std::string_view peer{};     ///< address of the connection
    std::string_view entity{};   ///< UUID; in an Entity Manager
    std::string_view what{};     ///< the operation, and what people should know of it
    std::string_view outcome{};  ///< "OK", or the code of the refusal
};

/// What stations tell of what they do (docs/adr/0041-audit.md). Threads: any. Does not wait, allocates
/// nothing, and does not fail: what cannot be kept is counted and told of in the trail itself.
class AuditTrail {
  public:
    virtual ~AuditTrail() = default;
    virtual void note(const Note& note) = 0;
};

/// Where nothing is to be recorded.
class NoTrail final : public AuditTrail {
  public:
    void note(const Note&) override {}
};

/// `trail`, or one that records nothing where there is none.
inline AuditTrail& orNone(AuditTrail* trail) {
    static NoTrail none;
    return trail != nullptr ? *trail : none;
}

}  // namespace axon::audit
