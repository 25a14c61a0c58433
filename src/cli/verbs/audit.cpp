// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <deque>
#include <filesystem>
#include <map>
#include <set>
#include <stdexcept>
#include <system_error>
#include <vector>

#include "audit/note.hpp"
#include "audit/reader.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"
#include "common/queue_share.hpp"
#include "common/routed.hpp"

// axon audit
namespace axon::cli {
namespace {

using audit::Chain;
using audit::Record;

constexpr const char* kFolder = "/var/lib/axon-server/audit";

std::vector<const char*> kinds() {
    std::vector<const char*> all;
    for (const auto kind : audit::kKinds) all.push_back(kind.data());
    return all;
}

/// The beginning of a time as records have it: "2026", "2026-11-28T14".
bool isTime(const std::string& text) {
    static constexpr std::string_view kPattern = "0000-00-00T00:00:00.000000Z";
    if (text.size() < 4 || text.size() > kPattern.size()) return false;
    for (std::size_t i = 0; i < text.size(); ++i) {
        const bool digit = text[i] >= '0' && text[i] <= '9';
        if (kPattern[i] == '0' ? !digit : text[i] != kPattern[i]) return false;
    }
    return true;
}

/// What the records of sessions say of the clients and entities of other records.
struct Known {
    std::map<std::string, std::string> users;               // of clients, by their id
    std::map<std::string, std::set<std::string>> entities;  // UUIDs, by name

    void add(const Record& record) {
        if (record.kind != "session") return;
        if (!record.client.empty() && !record.user.empty()) users[record.client] = record.user;
        if (!record.entity.empty()) entities[record.name].insert(record.entity);
    }
    /// The user's name is in the id of a session, as a number: enough for the trail of an Entity Manager,
    /// which is told the id alone.
    static bool isSessionOf(const std::string& client, const std::string& user) {
        const auto uuid = uuidOf(client);
        return uuid.size() > kUserDigits && uuid[kUserDigits] == '8' && uuid.starts_with(userPart(user));
    }
    std::string userOf(const std::string& client) const {
        const auto user = users.find(client);
        return user == users.end() ? std::string() : user->second;
    }
};

/// What `axon audit show` is asked for; empty = all.
struct Filter {
    std::string entity, user, kind, since, until;
    std::set<std::string> uuids{};  // of the entity

    void know(const Known& known) {
        if (entity.empty()) return;
        uuids.insert(entity);
        if (const auto its = known.entities.find(entity); its != known.entities.end())
            uuids.insert(its->second.begin(), its->second.end());
    }
    bool wants(const Record& record, const Known& known) const {
        return (entity.empty() || concerns(record)) &&
               (user.empty() || record.user == user || record.name == user || record.client == user ||
                known.userOf(record.client) == user || Known::isSessionOf(record.client, user)) &&
               (kind.empty() || record.kind == kind) && record.at >= since &&
               record.at.compare(0, until.size(), until) <= 0;
    }

  private:
    /// The entity, or all of them, or a list with it or without an end.
    bool concerns(const Record& record) const {
        if (!record.entity.empty()) return uuids.contains(record.entity);
        const auto& what = record.what;
        if (record.kind == "stop" || what.starts_with("drill")) {
            constexpr std::size_t kPerhapsCut = 500;
            return what.find(" entities: ") == std::string::npos || what.ends_with(" more") ||
                   what.size() >= kPerhapsCut ||
                   std::any_of(uuids.begin(), uuids.end(),
                               [&](const auto& uuid) { return what.find(uuid) != std::string::npos; });
        }
        return record.kind == "login" && record.name == entity;  // of its Entity Manager
    }
};

Json toJson(const std::string& trail, const Record& record, const Known& known) {
    Json event{{"event", "audit_record"},
               {"trail", trail},
               {"n", record.number},
               {"at", record.at},
               {"kind", record.kind}};
    for (const auto& [key, text] : {std::pair{"user", &record.user}, std::pair{"name", &record.name},
                                    std::pair{"client", &record.client}, std::pair{"peer", &record.peer},
                                    std::pair{"entity", &record.entity}, std::pair{"what", &record.what},
                                    std::pair{"outcome", &record.outcome}})
        if (!text->empty()) event[key] = *text;
    if (const auto user = known.userOf(record.client); record.user.empty() && !user.empty())
        event["session_user"] = user;
    return event;
}

void requireTrails(const std::string& folder, const std::vector<Chain>& chains) {
    if (chains.empty())
        throw std::runtime_error(
            "there is no audit trail in '" + folder +
            "'; expected files NAME.NUMBER.jsonl; fix: name the folder of Axon.Audit.Folder");
}

/// 64 hexadecimal digits.
bool isHash(const std::string& text) {
    return text.size() == audit::kNoHash.size() &&
           text.find_first_not_of("0123456789abcdef") == std::string::npos;
}

/// What is wrong with a folder, in one line with the fix.
std::string complaintOf(const std::string& folder, const std::error_code& failed) {
    if (failed == std::errc::no_such_file_or_directory)
        return "there is no folder '" + folder + "'; fix: name the folder of Axon.Audit.Folder";
    auto complaint = "'" + folder + "' cannot be read: " + failed.message();
    if (failed == std::errc::permission_denied || failed == std::errc::operation_not_permitted)
        complaint += "; fix: run it as the user who runs the program, or as root";
    return complaint;
}

int show(Session& session, const std::string& folder) {
    const auto text = [&](const char* option) { return session.args.value(option, std::string()); };
    Filter filter{text("entity"), text("user"), text("kind"), text("since"), text("until")};
    for (const auto& time : {filter.since, filter.until})
        if (!time.empty() && !isTime(time))
            return misused(session,
                           "'" + time +
                               "' is no time; expected the beginning of one in UTC, such as 2026-11-28 or "
                               "2026-11-28T14:35");
    const auto last = session.args.value("last", std::size_t{0});
    // All trails once before: the trail with the session may come after the one with what was done.
    Known known;
    requireTrails(folder, audit::readTrails(folder, {}, [&](const std::string&, const Record& record) {
                      known.add(record);
                  }));
    filter.know(known);
    std::deque<std::pair<std::string, Record>> found;
    const auto chains = audit::readTrails(folder, {}, [&](const std::string& trail, const Record& record) {
        if (filter.wants(record, known)) found.emplace_back(trail, record);
    });
    std::stable_sort(found.begin(), found.end(),
                     [](const auto& a, const auto& b) { return a.second.at < b.second.at; });
    if (last > 0 && found.size() > last)
        found.erase(found.begin(), found.end() - static_cast<std::ptrdiff_t>(last));
    for (const auto& [trail, record] : found) session.events.emit(toJson(trail, record, known));
    for (const auto& chain : chains)
        if (!chain.whole())
            session.events.emit(
                {{"event", "finding"},
                 {"level", "bad"},
                 {"name", chain.name},
                 {"message", "the trail is not whole: what is shown may be changed or incomplete"},
                 {"fix", "axon audit verify says where"}});
    return kDone;
}

int verify(Session& session, const std::string& folder) {
    const auto kept = session.args.value("kept", std::string());
    if (session.args.contains("kept") && !isHash(kept))
        return misused(session, "'" + kept +
                                    "' is no hash; expected 64 hexadecimal digits (0 to 9, a to f), as axon "
                                    "audit verify prints them");
    const auto chains = audit::readTrails(folder, kept);
    requireTrails(folder, chains);
    int exit = kDone;
    const auto bad = [&](const std::string& place, const std::string& message) {
        exit = kRefused;
        session.events.emit({{"event", "finding"}, {"level", "bad"}, {"name", place}, {"message", message}});
    };
    bool kept_found = false;
    for (const auto& chain : chains) {
        session.events.emit({{"event", "audit_trail"},
                             {"trail", chain.name},
                             {"whole", chain.whole()},
                             {"records", chain.records},
                             {"first", chain.first},
                             {"last", chain.last},
                             {"last_at", chain.last_at},
                             {"hash", chain.hash},
                             {"unfinished", chain.unfinished},
                             {"unfinished_lines", chain.unfinished_lines}});
        for (const auto& fault : chain.faults) bad(fault.place(), fault.text);
        if (chain.faulty > chain.faults.size())
            bad(chain.name, std::to_string(chain.faulty - chain.faults.size()) + " further lines are wrong");
        kept_found = kept_found || chain.kept_found;
    }
    if (!kept.empty() && !kept_found)
        bad(folder,
            "no line has the hash " + kept +
                ": the trail was cut or written anew since that was noted, or the file with that line was "
                "rotated away");
    return exit;
}

int auditVerb(Session& session) {
    const std::string action = session.args.at("action");
    const auto operand = session.args.value("folder_name", std::string());
    const auto option = session.args.value("folder", std::string());
    if (!operand.empty() && !option.empty()) return misused(session, "the folder is named twice");
    const auto folder = !operand.empty() ? operand : !option.empty() ? option : std::string(kFolder);
    for (const auto* only : {"entity", "user", "kind", "since", "until", "last"})
        if (action == "verify" && session.args.contains(only))
            return misused(session, std::string("--") + only + " is for axon audit show");
    if (action == "show" && session.args.contains("kept"))
        return misused(session, "--kept is for axon audit verify");
    try {
        return action == "show" ? show(session, folder) : verify(session, folder);
    } catch (const std::filesystem::filesystem_error& failed) {
        session.events.emit(usageEvent(complaintOf(folder, failed.code())));
    } catch (const std::exception& error) {
        session.events.emit(usageEvent(error.what()));
    }
    return kUsage;
}

}  // namespace

extern const Verb kAudit{
    "audit",
    "Show and verify what servers and Entity Managers have recorded",
    "  axon audit show --last 20                      the newest records\n"
    "  axon audit show --kind stop --since 2026-11-28T14\n"
    "  axon audit show --user ann --json              what ann did, as JSON lines\n"
    "  axon audit verify /var/lib/axon-server/audit   whether anything is changed or missing\n"
    "  axon audit verify --kept HASH                  … and whether a line that was noted is still there\n"
    "docs/reference/audit.md says what is recorded, and what verifying proves.\n",
    Runs::Local,
    {{"action", Takes::Choice, true, false, "show or verify", {"show", "verify"}},
     {"folder_name", Takes::File, false, false, "Folder of the trails"}},
    {{"folder", Takes::File, "Folder of the trails (default /var/lib/axon-server/audit)"},
     {"entity", Takes::Text,
      "show: of this entity, by UUID or by the name with which it joined; also stops of all"},
     {"user", Takes::Text, "show: of this user, client name or client id"},
     {"kind", Takes::Choice, "show: of this kind", kinds()},
     {"since", Takes::Text, "show: from this time on, in UTC: 2026-11-28T14:35 or its beginning"},
     {"until", Takes::Text, "show: up to this time, which counts"},
     {"last", Takes::Count, "show: only so many, the newest"},
     {"kept", Takes::Text, "verify: a hash that was noted earlier must be there"}},
    auditVerb};

}  // namespace axon::cli
