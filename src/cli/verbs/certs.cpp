// SPDX-License-Identifier: GPL-2.0-or-later
#include <chrono>
#include <optional>
#include <utility>

#include "certificates/folder.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"

// axon certs
namespace axon::cli {
namespace {

using namespace certificates;
namespace fs = std::filesystem;

WallTime now() {
    return std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
}

std::vector<std::string> namesOf(const Session& session) {
    return session.args.value("name", std::vector<std::string>{});
}

/// The option of the kind of certificate; the number of them that were given, too.
std::pair<int, Kind> kindIn(const Session& session) {
    std::pair<int, Kind> found{0, Kind::Client};
    for (const auto kind : kKinds)
        if (session.args.value(certificates::toString(kind), false)) found = {found.first + 1, kind};
    return found;
}

std::string kindOptions() {
    std::string all;
    for (const auto kind : kKinds)
        all += (all.empty() ? "--" : ", --") + std::string(certificates::toString(kind));
    return all;
}

const char* toString(Validity validity) {
    switch (validity) {
        case Validity::Valid:
            return "valid";
        case Validity::ExpiresSoon:
            return "expires soon";
        case Validity::Expired:
            return "expired";
        case Validity::NotYetValid:
            break;
    }
    return "not yet valid";
}

Json toJson(const Certificate& certificate, const fs::path& file, WallTime at) {
    const auto left = std::chrono::floor<std::chrono::days>(certificate.until - at).count();
    return {{"file", file.string()},
            {"name", certificate.name},
            {"kind", certificate.authority ? "ca" : certificate.unit},
            {"names", certificate.names},
            {"issuer", certificate.issuer},
            {"from", day(certificate.from)},
            {"until", day(certificate.until)},
            {"days_left", left},
            {"validity", toString(validity(certificate, at))}};
}

void tellWritten(Session& session, const Written& written, const std::string& next) {
    auto files = Json::array();
    for (const auto& file : written.files) files.push_back(file.string());
    session.events.emit({{"event", "issued"},
                         {"certificate", toJson(written.certificate, written.files.front(), now())},
                         {"files", files},
                         {"next", next}});
}

int init(Session& session, const Folder& folder) {
    if (!namesOf(session).empty()) return misused(session, "axon certs init takes no name");
    const bool force = session.args.value("force", false);
    const auto written = folder.init(now(), force);
    std::string next =
        "keep a copy of ca.key.pem where nobody else can read it, then run axon certs issue --server "
        "HOST ADDRESS";
    if (force)
        next += "; axon certs revoke makes the list that servers with IceSSL.RevocationCheck need of this CA";
    tellWritten(session, written, next);
    return kDone;
}

int issue(Session& session, const Folder& folder) {
    Request request;
    const auto [kinds, kind] = kindIn(session);
    if (kinds != 1) return misused(session, "expected one of " + kindOptions());
    request.kind = kind;
    request.names = namesOf(session);
    request.valid = std::chrono::days{session.args.value("days", 365)};
    const auto written = folder.issue(request, now(), session.args.value("force", false));
    tellWritten(session, written, "the last file is the configuration that uses it");
    return kDone;
}

int revoke(Session& session, const Folder& folder) {
    const auto [kinds, kind] = kindIn(session);
    if (kinds > 1) return misused(session, "expected one of " + kindOptions() + ", or none");
    auto names = namesOf(session);
    if (kinds == 1 && names.empty())
        return misused(session, std::string("expected a name after --") + certificates::toString(kind));
    if (kinds == 1 && isCalled(kind) && names.size() > 1)
        return misused(session, std::string("expected one name after --") + certificates::toString(kind) +
                                    ": the first of those that axon certs issue was given, here perhaps " +
                                    shellWord(names.front()));
    if (kinds == 1)
        for (auto& name : names) name = fileStem({kind, {name}});
    std::optional<std::chrono::days> valid;
    if (session.args.contains("days")) valid = std::chrono::days{session.args.at("days").get<int>()};
    const auto done = folder.revoke(names, valid, now());
    session.events.emit(
        {{"event", "revoked"},
         {"added", done.added},
         {"revoked", done.in_the_list},
         {"file", done.list.string()},
         {"until", day(done.until)},
         {"lines",
          {"IceSSL.RevocationCheck=1",
           "IceSSL.CertificateRevocationListFiles=" + done.list.filename().string()}},
         {"next",
          "copy the list to each server, router, IceStorm, registry and node of IceGrid, beside its "
          "certificate, give its configuration these two lines, and restart it; a program reads the list "
          "when it starts. For a cluster on one machine, in whose folder these certificates are, "
          "axon-cluster down and up do this. If the key of one of these was stolen, clients and Entity "
          "Managers need the list too (docs/reference/tls.md)"}});
    return kDone;
}

std::string fixOf(const Certificate& certificate) {
    if (certificate.authority) return "axon certs init --force, then issue all certificates again";
    return "axon certs issue --" + certificate.unit + " " + shellWord(certificate.name) +
           (certificate.names.empty() || certificate.names == std::vector{certificate.name} ? "" : " …") +
           " --force, then restart the program that uses it";
}

/// What expires is said on the way, and expired is a failure: scripts ask for it.
int show(Session& session, const fs::path& its_folder) {
    auto list = Json::array();
    std::vector<std::pair<Certificate, fs::path>> all;
    const auto add = [&](const fs::path& file) {
        for (auto& one : readCertificateFile(file)) all.emplace_back(std::move(one), file);
    };
    const auto named = namesOf(session);
    if (!named.empty()) {
        for (const auto& file : named) add(file);
    } else {
        for (const auto& file : Folder(its_folder).certificateFiles()) add(file);
    }
    const auto at = now();
    std::optional<RevocationList> revoked;
    std::optional<Unusable> unreadable;
    try {
        if (!its_folder.empty()) revoked = Folder(its_folder).revocationList();
    } catch (const Unusable& unusable) {
        if (named.empty()) throw;
        unreadable = unusable;  // the files that were named may have nothing to do with it
    }
    const auto isRevoked = [&](const Certificate& one) {
        return revoked && revoked->serials.contains(one.serial);
    };
    for (const auto& [certificate, file] : all) {
        list.push_back(toJson(certificate, file, at));
        if (isRevoked(certificate)) list.back()["validity"] = "revoked";
    }
    session.events.emit({{"event", "certificates"}, {"certificates", list}});
    int exit = kDone;
    for (const auto& [certificate, file] : all) {
        const auto state = validity(certificate, at);
        if (state == Validity::Valid || isRevoked(certificate)) continue;
        const bool soon = state == Validity::ExpiresSoon;
        if (!soon) exit = kRefused;
        const auto when = state == Validity::NotYetValid ? "is valid from " + day(certificate.from) + " on"
                          : soon                         ? "expires on " + day(certificate.until)
                                                         : "expired on " + day(certificate.until);
        session.events.emit(
            {{"event", "finding"},
             {"level", soon ? "warn" : "bad"},
             {"name", certificate.name},
             {"message", file.filename().string() + " " + when},
             {"fix", state == Validity::NotYetValid ? "set the clock of this machine" : fixOf(certificate)}});
    }
    if (unreadable)
        session.events.emit(
            {{"event", "finding"},
             {"level", "warn"},
             {"name", "revocation list"},
             {"message", std::string(unreadable->what()) + "; so it is not known whether these are revoked"},
             {"fix", unreadable->fix()}});
    if (!revoked) return exit;
    if (const auto state = validity(*revoked, at); state != Validity::Valid) {
        const bool soon = state == Validity::ExpiresSoon;
        const bool future = state == Validity::NotYetValid;
        if (!soon) exit = kRefused;
        session.events.emit(
            {{"event", "finding"},
             {"level", soon ? "warn" : "bad"},
             {"name", "revocation list"},
             {"message", future ? "is valid from " + day(revoked->from) +
                                      " on; servers that use it refuse everybody until then"
                                : std::string(soon ? "ends on " : "ended on ") + day(revoked->until) +
                                      "; servers that use it refuse everybody from then on"},
             {"fix", std::string(future ? "set the clock of this machine; if it is right: " : "") +
                         "axon certs revoke without a name, then copy revoked.crl.pem to these servers and "
                         "restart them"}});
    }
    return exit;
}

int certs(Session& session) {
    const std::string action = session.args.at("action");
    try {
        const fs::path named = session.args.value("folder", std::string());
        const auto folder = named.empty() ? defaultFolder() : named;
        if (action == "show") return show(session, folder);
        if (action == "revoke") return revoke(session, Folder(folder));
        return action == "init" ? init(session, Folder(folder)) : issue(session, Folder(folder));
    } catch (const Unusable& unusable) {
        session.events.emit(usageEvent(unusable.what(), unusable.fix()));
    } catch (const std::exception& error) {
        session.events.emit(usageEvent(error.what()));
    }
    return kUsage;
}

}  // namespace

extern const Verb kCerts{
    "certs",
    "Make and show the certificates of the laboratory",
    "  axon certs init                                       the laboratory's own CA, once\n"
    "  axon certs issue --server lab.example 192.168.0.5     its names and addresses\n"
    "  axon certs issue --router lab.example 192.168.0.5\n"
    "  axon certs issue --front-end fe1 lab.example          of several servers: its Server.Name, then its "
    "hosts\n"
    "  axon certs issue --entity-server es1 192.168.0.6\n"
    "  axon certs issue --storm lab.example                  for IceStorm between several servers\n"
    "  axon certs issue --registry lab.example               for IceGrid, which starts these programs\n"
    "  axon certs issue --entity PeopleBot                   the name in its basic profile\n"
    "  axon certs issue --client client1                     the name in users.cfg\n"
    "  axon certs revoke --client client1                    no longer valid, where servers use the list\n"
    "  axon certs revoke                                     the same list, valid for longer\n"
    "  axon certs show                                       list them, and when they expire\n"
    "docs/reference/tls.md says how they are used.\n",
    Runs::Local,
    {{"action",
      Takes::Choice,
      true,
      false,
      "init, issue, revoke or show",
      {"init", "issue", "revoke", "show"}},
     {"name", Takes::File, false, true,
      "issue: the name, and the names and addresses by which a server is called; revoke: the name "
      "after the option of its kind (of a server, only the first), or KIND-NAME, or files; show: files"}},
    {{"folder", Takes::File, "Folder of the CA (default ~/.config/axon/certs)"},
     {"server", Takes::Nothing, "For axon-server"},
     {"front-end", Takes::Nothing, "For one of several front-end servers: its name and its hosts"},
     {"entity-server", Takes::Nothing, "For one of several entity servers, likewise"},
     {"storm", Takes::Nothing, "For IceStorm between several servers"},
     {"registry", Takes::Nothing, "For IceGrid: registry, node and icegridadmin"},
     {"router", Takes::Nothing, "For glacier2router"},
     {"entity", Takes::Nothing, "For the Entity Manager of the entity of this name"},
     {"client", Takes::Nothing, "For the user of this name"},
     {"days", Takes::Count, "Days until it expires (default 365; revoke: as long as the CA)"},
     {"force", Takes::Nothing, "Replace existing files"}},
    certs};

}  // namespace axon::cli
