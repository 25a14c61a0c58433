// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/verbs/holding.hpp"

#include <algorithm>
#include <utility>

#include "cli/words.hpp"

namespace axon::cli {

int refuse(Session& session, const Refusal& refusal, const std::string& entity) {
    session.events.emit(errorEvent(refusal, entity));
    return exitOf(refusal);
}

int misused(Session& session, const std::string& message, const std::string& mend) {
    session.events.emit(usageEvent(message, mend));
    return kUsage;
}

namespace {
bool holds(const Station& station, const std::string& id) {
    const auto held = station.held();
    return std::any_of(held.begin(), held.end(), [&](const Entity& entity) { return entity.id == id; });
}
}  // namespace

Result<Holding> Holding::of(Session& session, const std::string& name, const std::string& what) {
    auto found = session.station->find(name);
    if (!found) return found.refusal();
    const auto& entity = found.value();
    if (holds(*session.station, entity.id)) return Holding(session, entity, false);
    if (auto granted = session.station->checkOut({entity.id}); !granted) return granted.refusal();
    session.events.emit(
        {{"event", "checked_out"},
         {"entities", {{{"id", entity.id}, {"name", entity.name}, {"call", callOf(session, entity)}}}},
         {"kept", false},
         {"for", what}});
    return Holding(session, entity, true);
}

Holding::Holding(Session& session, Entity entity, bool own)
    : station_(session.station), entity_(std::move(entity)), call_(callOf(session, entity_)), own_(own) {}

Holding::Holding(Holding&& other) noexcept
    : station_(std::move(other.station_)),
      entity_(std::move(other.entity_)),
      call_(std::move(other.call_)),
      own_(std::exchange(other.own_, false)) {}

Holding::~Holding() {
    // A refusal here means that it is not ours any more: what was wanted.
    if (own_) static_cast<void>(station_->release(entity_.id).ok());
}

std::string callOf(const Session& session, const Entity& entity) {
    return callName(entity, session.station->entities());
}

std::optional<Refusal> whyLost(const Station& station, const std::string& id) {
    for (const auto& lost : station.lost()) {
        if (lost.entity.id == id) return lost.why;
    }
    return std::nullopt;
}

Result<Entity> findHeld(Session& session, const std::string& name) {
    auto found = session.station->find(name);
    if (!found) return found;
    if (holds(*session.station, found->id)) return found;
    Refusal refusal{RefusalCode::NotHolder, callOf(session, found.value()) + " is not checked out here", {}};
    if (const auto lost = whyLost(*session.station, found->id)) {
        refusal = *lost;
        refusal.message =
            "the check-out of " + callOf(session, found.value()) + " was lost: " + lost->message;
    }
    return refusal;
}

std::shared_ptr<void> listenTo(Session& session, const Entity& entity) {
    Listener listener;
    const auto mailbox = session.mailbox;
    const auto name = callOf(session, entity);
    listener.text = [=](const std::string& text) {
        mailbox->post({{"event", "text"}, {"entity", name}, {"text", text}}, true);
    };
    listener.raw = [=](const std::string& bytes) {
        mailbox->post({{"event", "raw"}, {"entity", name}, {"size", bytes.size()}, {"hex", toHex(bytes)}},
                      true);
    };
    listener.lost = [=](const Refusal& refusal) {
        mailbox->post({{"event", "lost"},
                       {"entity", name},
                       {"code", refusalName(refusal.code)},
                       {"message", refusal.message},
                       {"holder", refusal.holder}});
    };
    return session.station->listen(entity.id, std::move(listener));
}

std::string toHex(const std::string& bytes) {
    static constexpr char kDigits[] = "0123456789abcdef";
    std::string hex;
    hex.reserve(bytes.size() * 2);
    for (const char c : bytes) {
        const auto byte = static_cast<unsigned char>(c);
        hex += kDigits[byte >> 4U];
        hex += kDigits[byte & 15U];
    }
    return hex;
}

std::optional<std::string> fromHex(const std::string& hex) {
    if (hex.size() % 2 != 0) return std::nullopt;
    const auto digit = [](char c) {
        if (c >= '0' && c <= '9') return c - '0';
        if (c >= 'a' && c <= 'f') return c - 'a' + 10;
        return -1;
    };
    std::string bytes;
    bytes.reserve(hex.size() / 2);
    for (std::size_t i = 0; i < hex.size(); i += 2) {
        const int high = digit(hex[i]);
        const int low = digit(hex[i + 1]);
        if (high < 0 || low < 0) return std::nullopt;
        bytes += static_cast<char>(high * 16 + low);
    }
    return bytes;
}

}  // namespace axon::cli
