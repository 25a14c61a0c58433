// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/console_core.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "common/refusal.hpp"
#include "console/core/form.hpp"

namespace axon::console {
namespace {

using Json = nlohmann::json;

constexpr const char* kConnection = "a connection to the web console";
constexpr const char* kRequest = "a request to the web console";
constexpr const char* kText = "text/plain; charset=utf-8";
constexpr const char* kHtml = "text/html; charset=utf-8";
constexpr const char* kJson = "application/json";
constexpr std::string_view kFormType = "application/x-www-form-urlencoded";
// Vite names what lies here after its content.
constexpr std::string_view kNamedByContent = "/assets/";

std::shared_ptr<const std::string> shared(std::string text) {
    return std::make_shared<const std::string>(std::move(text));
}

Answer said(int status, const char* type, std::string text) {
    return {status, {{"Content-Type", type}, {"Cache-Control", "no-store"}}, shared(std::move(text))};
}

Answer json(int status, const Json& value) {
    return said(status, kJson, value.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n");
}

Answer refused(int status, RefusalCode code, const std::string& message) {
    return json(status, {{"code", refusalName(code)}, {"message", message}});
}

Answer notPermitted(const char* methods) {
    auto answer = said(405, kText, std::string("expected one of the methods ") + methods + "\n");
    answer.headers.emplace_back("Allow", methods);
    return answer;
}

std::string escaped(const std::string& text) {
    std::string out;
    for (const char c : text) {
        switch (c) {
            case '&':
                out += "&amp;";
                break;
            case '<':
                out += "&lt;";
                break;
            case '>':
                out += "&gt;";
                break;
            case '"':
                out += "&quot;";
                break;
            default:
                out += c;
        }
    }
    return out;
}

/// `folder` is empty for strangers, whom it does not concern.
Answer notBuilt(const std::string& folder) {
    return said(
        503, kHtml,
        "<!doctype html>\n<html lang=\"en\">\n<head><meta "
        "charset=\"utf-8\"><title>Axon</title></head>\n<body>\n"
        "<h1>The Axon server runs, but its web console is not here</h1>\n"
        "<p>Expected the file <code>index.html</code> of the built console" +
            (folder.empty() ? std::string() : " in <code>" + escaped(folder) + "</code>") +
            ".</p>\n"
            "<p>To build it from the source: <code>apt install nodejs npm</code> as root; then, in the top "
            "folder of the source, <code>cmake -DAXON_WEB=ON build/release &amp;&amp; "
            "cmake --build build/release --target console</code>. "
            "(If this server is that of another build folder, name that folder instead of build/release.) "
            "If the console is in another folder, name it with <code>axon-server --console-files DIR</code> "
            "or <code>Console.Files</code>. Then load this page again.</p>\n"
            "<p>Robots can be watched and commanded without it: <code>axon ls</code>, "
            "<code>axon --help</code>.</p>\n</body>\n</html>\n");
}

std::string addressOf(const std::string& end) {
    return end.substr(0, end.rfind(':'));
}

int statusOf(RefusalCode code) {
    switch (code) {
        case RefusalCode::PermissionDenied:
            return 403;
        case RefusalCode::Malformed:
            return 400;
        default:
            return 503;
    }
}

bool isForm(std::string_view content_type) {
    const auto type = content_type.substr(0, content_type.find(';'));
    return type.substr(0, type.find_last_not_of(' ') + 1) == kFormType;
}

}  // namespace

ConsoleCore::ConsoleCore(Sites sites, FilesPort& files, LoginPort& logins, Visitors& visitors,
                         std::function<void(const std::string&)> note,
                         std::function<void(const std::string&)> strangers)
    : sites_(std::move(sites)),
      files_(files),
      logins_(logins),
      visitors_(visitors),
      note_(std::move(note)),
      strangers_(strangers ? std::move(strangers) : note_) {}

std::string ConsoleCore::cookieName(const Site& site) const {
    // A browser sends the cookies of a host to all its ports: two servers on a machine need two names. The
    // beginning of the other one promises a browser that no other host and no plain HTTP has set it.
    const auto port = site.origin.substr(site.origin.rfind(':') + 1);
    const bool digits = port.find_first_not_of("0123456789") == std::string::npos;
    return (site.secure ? "__Host-axon" : "axon") + (digits ? "-" + port : std::string());
}

std::string ConsoleCore::setCookie(const Site& site, std::string_view value,
                                   std::chrono::seconds life) const {
    return cookieName(site) + "=" + std::string(value) + "; Path=/; Max-Age=" + std::to_string(life.count()) +
           "; HttpOnly; SameSite=Strict" + (site.secure ? "; Secure" : "");
}

Answer ConsoleCore::secured(Answer answer, const Site* site) {
    // The console runs its timers in a worker made of a blob, as Ice for JavaScript does.
    std::string policy = "default-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";
    if (site != nullptr)
        policy +=
            "; script-src 'self'; style-src 'self'; font-src 'self'; manifest-src 'self'; "
            "img-src 'self' data: blob:; worker-src 'self' blob:; connect-src 'self' " +
            site->socket + (site->signal_socket == site->socket ? "" : " " + site->signal_socket);
    auto& headers = answer.headers;
    headers.emplace_back("Content-Security-Policy", policy);
    headers.emplace_back("X-Content-Type-Options", "nosniff");
    headers.emplace_back("X-Frame-Options", "DENY");
    headers.emplace_back("Referrer-Policy", "no-referrer");
    headers.emplace_back("Cross-Origin-Opener-Policy", "same-origin");
    headers.emplace_back("Cross-Origin-Resource-Policy", "same-origin");
    headers.emplace_back("Permissions-Policy", "camera=(), microphone=(), geolocation=(), payment=()");
    return answer;
}

void ConsoleCore::turnAway(const std::string& peer, RefusalCode code, const std::string& why) {
    strangers_("audit: console: a connection from " + peer + " was closed: " + why);
    logins_.turnedAway(peer, kConnection, {code, why, {}});
}

Answer ConsoleCore::refuse(const Request& request, int status, RefusalCode code, const std::string& message) {
    strangers_("audit: console: a request from " + request.peer + " was refused: " + message);
    logins_.turnedAway(request.peer, kRequest, {code, message, {}});
    return refused(status, code, message);
}

void ConsoleCore::handle(Request request, std::function<void(Answer)> reply) {
    const auto site = sites_.ofHost(request.host, addressOf(request.local));
    if (site && site->proxy && isOfThisMachine(request.peer))
        if (const auto client = forwardedFor(request.forwarded_for)) request.peer = *client + ":0";
    const auto answer = [&](Answer its) { reply(secured(std::move(its), site ? &*site : nullptr)); };
    const auto record = [&](const std::string& why) {
        strangers_("audit: console: a request from " + request.peer + " was refused: " + why);
        logins_.turnedAway(request.peer, kRequest, {RefusalCode::PermissionDenied, why, {}});
    };
    if (!site) {
        record("this server is not called by the name in its header Host");
        return answer(
            said(421, kText,
                 "This server is not called by that name.\nfix: call it by its address, or add the name to "
                 "Console.Names, or the address of the proxy to Console.Proxies, in the configuration of "
                 "axon-server\n"));
    }
    const bool reads = request.method == "GET" || request.method == "HEAD";
    const bool acts = request.path == "/login" || request.path == "/logout" || request.path == "/ticket";
    if (acts ? request.method != "POST" : !reads) {
        const auto* const methods = acts ? "POST" : "GET, HEAD";
        record(std::string("its method is none of ") + methods);
        return answer(notPermitted(methods));
    }
    if (!acts) return answer(file(request, *site));
    // A browser names the origin of every POST. What names none is no browser, and nobody's cookie is in it.
    if (request.origin != site->origin) {
        strangers_(std::string("audit: console: a request ") +
                   (request.origin.empty() ? "without an origin" : "of a foreign page") + " from " +
                   request.peer + " was refused");
        const Refusal foreign{RefusalCode::PermissionDenied,
                              "this request does not come from a page of this console; fix: open the console "
                              "at " +
                                  site->origin,
                              {}};
        logins_.turnedAway(request.peer, kRequest, foreign);
        return answer(refused(403, foreign.code, foreign.message));
    }
    if (request.too_large)
        return answer(refuse(request, 413, RefusalCode::TooLarge,
                             "the body of a request has at most " + std::to_string(kBodyMax) + " bytes"));
    if (request.path == "/login")
        return login(request, *site, [reply = std::move(reply), site = *site](Answer its) {
            reply(secured(std::move(its), &site));
        });
    answer(request.path == "/logout" ? logout(request, *site) : ticket(request, *site));
}

Answer ConsoleCore::file(const Request& request, const Site& site) {
    const auto files = files_.files();
    if (files->find("/index.html") == files->end()) {
        if (request.path == "/" || request.path == "/index.html")
            return notBuilt(isOfThisMachine(request.peer) && !site.proxy ? files_.folder() : std::string());
        return said(404, kText, "There is no such file; the console is not built.\n");
    }
    const auto found = files->find(request.path == "/" ? "/index.html" : request.path);
    if (found == files->end())
        return said(404, kText, "There is no such file.\nfix: begin at the console's first page, /\n");
    const auto& its = found->second;
    auto body = its.plain;
    const char* coding = nullptr;
    if (its.br && accepts(request.accept_encoding, "br")) {
        body = its.br;
        coding = "br";
    } else if (its.gzip && accepts(request.accept_encoding, "gzip")) {
        body = its.gzip;
        coding = "gzip";
    }
    const auto tag = "\"" + its.tag + (coding == nullptr ? "" : std::string("-") + coding) + "\"";
    Answer answer;
    answer.headers = {
        {"ETag", tag},
        {"Vary", "Accept-Encoding"},
        {"Cache-Control",
         request.path.starts_with(kNamedByContent) ? "public, max-age=31536000, immutable" : "no-cache"}};
    if (matchesTag(request.if_none_match, tag)) {
        answer.status = 304;
        return answer;
    }
    answer.headers.emplace_back("Content-Type", its.type);
    if (coding != nullptr) answer.headers.emplace_back("Content-Encoding", coding);
    answer.body = std::move(body);
    return answer;
}

void ConsoleCore::login(const Request& request, const Site& site, std::function<void(Answer)> reply) {
    if (!logins_.needed()) return reply(json(200, {{"user", ""}, {"role", ""}}));
    const auto form = isForm(request.content_type) ? parseForm(request.body) : std::nullopt;
    if (!form || !form->contains("user") || !form->contains("password"))
        return reply(refuse(request, 400, RefusalCode::Malformed,
                            "expected a body user=…&password=… of the type " + std::string(kFormType)));
    logins_.login(form->find("user")->second, form->find("password")->second, request,
                  [this, site, peer = request.peer, old = cookie(request.cookie, cookieName(site)),
                   reply = std::move(reply)](Result<LoginPort::Visitor> who) {
                      if (!who)
                          return reply(refused(statusOf(who.refusal().code), who.refusal().code,
                                               who.refusal().message));
                      const auto& [user, role] = who.value();
                      if (old) visitors_.leave(*old);
                      note_("audit: console: '" + user + "' logged in from " + peer + " as " + role);
                      auto answer = json(200, {{"user", user}, {"role", role}});
                      answer.headers.emplace_back("Set-Cookie",
                                                  setCookie(site, visitors_.enter(user), Visitors::kVisit));
                      reply(std::move(answer));
                  });
}

Answer ConsoleCore::logout(const Request& request, const Site& site) {
    if (const auto key = cookie(request.cookie, cookieName(site))) visitors_.leave(*key);
    auto answer = json(200, Json::object());
    answer.headers.emplace_back("Set-Cookie", setCookie(site, "", std::chrono::seconds{0}));
    return answer;
}

Answer ConsoleCore::ticket(const Request& request, const Site& site) {
    Json its{{"user", ""}, {"password", ""}, {"endpoint", site.endpoint}};
    if (logins_.needed()) {
        const auto key = cookie(request.cookie, cookieName(site));
        const auto user = key ? visitors_.userOf(*key) : std::nullopt;
        if (!user) {
            const char* const why =
                "nobody is logged in here; fix: log in with user and password (POST /login)";
            // Without a cookie it is a browser's first visit.
            return key ? refuse(request, 401, RefusalCode::PermissionDenied, why)
                       : refused(401, RefusalCode::PermissionDenied, why);
        }
        its["user"] = *user;
        its["password"] = visitors_.ticket(*user);
    }
    return json(200, its);
}

}  // namespace axon::console
