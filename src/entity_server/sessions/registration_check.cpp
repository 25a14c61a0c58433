// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/registration_check.hpp"

#include <string>
#include <utility>

#include "common/entity_name.hpp"
#include "common/refuse.hpp"
#include "common/utf8.hpp"

namespace axon::entity_server {
namespace {

constexpr int kHeartbeatMinMs = 10;
constexpr int kHeartbeatMaxMs = 60'000;
constexpr std::size_t kNameMax = 256;
constexpr std::size_t kTextMax = 1024;

/// Like it, and one that isEntityName().
std::string otherName(std::string name) {
    const auto hash = name.rfind('#');
    if (hash == std::string::npos) return "Robot " + name.substr(0, 8);
    name[hash] = ' ';
    return validUtf8(name);
}

}  // namespace

void makeValid(std::string& text) {
    text = cutUtf8(validUtf8(text), kTextMax);
}

Result<void> checkRegistration(const Registration& registration, std::size_t profile_bytes,
                               std::size_t profile_bytes_max) {
    if (registration.name.empty() || registration.name.size() > kNameMax) {
        return refuse(RefusalCode::BadName,
                      "the entity's name must have 1 to 256 characters; fix <entity_name> in the "
                      "basic profile");
    }
    if (!isEntityName(registration.name)) {
        return refuse(RefusalCode::BadName, "'" + validUtf8(registration.name) +
                                                "' is how people call another entity, by NAME#NUMBER or its "
                                                "UUID: expected a name that is neither; "
                                                "fix: rename it in the basic profile, such as '" +
                                                otherName(registration.name) + "'");
    }
    for (const auto* text : {&registration.name, &registration.category, &registration.type}) {
        if (text->size() > kTextMax || validUtf8(*text) != *text) {
            return refuse(RefusalCode::Malformed,
                          "a text of the registration is no UTF-8 or longer than 1024 bytes; fix the basic "
                          "profile");
        }
    }
    for (const int period : {registration.heartbeat_busy_ms, registration.heartbeat_idle_ms}) {
        if (period < kHeartbeatMinMs || period > kHeartbeatMaxMs) {
            return refuse(RefusalCode::OutOfRange,
                          "a heartbeat period of " + std::to_string(period) +
                              " ms: expected 10 to 60000 ms; fix it in the Entity Manager's "
                              "configuration");
        }
    }
    if (profile_bytes > profile_bytes_max) {
        return refuse(RefusalCode::TooLarge, "the basic profile has " + std::to_string(profile_bytes) +
                                                 " bytes; expected at most " +
                                                 std::to_string(profile_bytes_max));
    }
    return {};
}

}  // namespace axon::entity_server
