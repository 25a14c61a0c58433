// SPDX-License-Identifier: GPL-2.0-or-later
// What people write or pass on: a query for entities, a settings file (ports.cfg), and a lease's ticket. Any
// text is one or a refusal that says what was expected; a ticket that is taken says the same again. The first
// byte chooses.
#include <cstdint>
#include <string_view>

#include "claim.hpp"
#include "client/core/entity_query.hpp"
#include "client/core/session_core.hpp"
#include "host/port_range.hpp"
#include "host/settings_file.hpp"

namespace {

using namespace axon;

template <class T>
void requireMend(const Result<T>& result) {
    if (!result) require(!result.refusal().message.empty(), "a refusal says why");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    if (size == 0) return 0;
    const std::string_view text(reinterpret_cast<const char*>(bytes + 1), size - 1);
    if (bytes[0] % 3 == 0) {
        requireMend(client::parseQuery(text));
        return 0;
    }
    if (bytes[0] % 3 == 2) {
        const auto ticket = client::LeaseTicket::parse(text);
        requireMend(ticket);
        if (!ticket) return 0;
        const auto again = client::LeaseTicket::parse(ticket->toText());
        require(again.ok() && again->entity == ticket->entity && again->lease == ticket->lease &&
                    again->key == ticket->key,
                "a ticket that is taken is written and read as the same");
        return 0;
    }
    const auto settings = parseSettings(text, "ports.cfg");
    requireMend(settings);
    if (settings)
        for (const auto& setting : settings.value())
            require(!setting.key.empty() && setting.where.starts_with("ports.cfg:"),
                    "a setting has a key, and says where it is");
    const auto ports = parsePorts(text, "ports.cfg");
    require(settings.ok() || !ports.ok(), "what is no settings file is no ports.cfg");
    requireMend(ports);
    if (ports)
        require(ports->ports.first >= PortRange::kLowest && ports->ports.first <= ports->ports.last &&
                    ports->ports.last <= PortRange::kHighest,
                "the range is within 5500 to 8000");
    return 0;
}
