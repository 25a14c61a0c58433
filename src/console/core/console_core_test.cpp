// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/console_core.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <optional>

#include "common/refuse.hpp"

namespace axon::console {
namespace {

using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

std::shared_ptr<const std::string> text(const char* its) {
    return std::make_shared<const std::string>(its);
}

class FakeFiles final : public FilesPort {
  public:
    std::shared_ptr<const BuiltFiles> files() override { return std::make_shared<const BuiltFiles>(all); }
    std::string folder() const override { return "/share/<console>"; }
    BuiltFiles all{
        {"/index.html", {"text/html; charset=utf-8", "aa", text("<html>"), text("GZ"), text("BR")}},
        {"/assets/app-1.js", {"text/javascript; charset=utf-8", "bb", text("let a;"), nullptr, nullptr}}};
};

class FakeLogins final : public LoginPort {
  public:
    bool needed() const override { return users; }
    void login(const std::string& user, const std::string& password, const Request& request,
               Answered answered) override {
        ++asked;
        peer = request.peer;
        if (user == "anna" && password == "right") return answered(Visitor{"anna", "operator"});
        if (user == "later") return void(later = std::move(answered));
        answered(refuse(RefusalCode::PermissionDenied, "wrong user or password; fix: correct them"));
    }
    void turnedAway(const std::string& its_peer, const std::string& what, const Refusal& refusal) override {
        turned_away.push_back(its_peer + " | " + what + " | " + std::string(refusalName(refusal.code)));
    }
    bool users = true;
    int asked = 0;
    std::vector<std::string> turned_away;
    std::string peer;
    Answered later;
};

class ConsoleCoreTest : public testing::Test {
  protected:
    static Request request(std::string method, std::string path) {
        Request its;
        its.method = std::move(method);
        its.path = std::move(path);
        its.host = "127.0.0.1:10417";
        its.peer = "127.0.0.1:50122";
        its.local = "127.0.0.1:10417";
        if (its.method == "POST") its.origin = "http://127.0.0.1:10417";
        return its;
    }
    static Request logIn(const std::string& body) {
        auto its = request("POST", "/login");
        its.content_type = "application/x-www-form-urlencoded;charset=UTF-8";
        its.body = body;
        return its;
    }
    Answer answer(Request its) {
        std::optional<Answer> got;
        core.handle(std::move(its), [&](Answer answered) { got = std::move(answered); });
        EXPECT_TRUE(got) << "answered";
        return got.value_or(Answer{});
    }
    static std::string field(const Answer& answer, const std::string& name) {
        std::string all;
        for (const auto& [key, value] : answer.headers)
            if (key == name) all += (all.empty() ? "" : "\n") + value;
        return all;
    }
    static std::string cookieOf(const Answer& answer) {
        const auto set = field(answer, "Set-Cookie");
        return set.substr(0, set.find(';'));
    }

    ManualClock clock;
    SeededRandom random{1};
    Visitors visitors{clock, random};
    FakeFiles files;
    FakeLogins logins;
    std::vector<std::string> notes;
    ConsoleCore core{Sites({false, 10417, 10418, 10419, {}, {"https://lab.example"}}), files, logins,
                     visitors, [this](const std::string& line) { notes.push_back(line); }};
};

TEST_F(ConsoleCoreTest, TheFirstPageIsTheIndex) {
    const auto its = answer(request("GET", "/"));
    EXPECT_EQ(its.status, 200);
    EXPECT_EQ(*its.body, "<html>");
    EXPECT_EQ(field(its, "Content-Type"), "text/html; charset=utf-8");
    EXPECT_EQ(field(its, "Cache-Control"), "no-cache");
    EXPECT_EQ(field(its, "ETag"), "\"aa\"");
}

TEST_F(ConsoleCoreTest, WhatIsNamedByItsContentIsKeptForAYear) {
    EXPECT_THAT(field(answer(request("GET", "/assets/app-1.js")), "Cache-Control"), HasSubstr("immutable"));
}

TEST_F(ConsoleCoreTest, ABrowserGetsTheSmallestCodingThatItReads) {
    auto its = request("GET", "/");
    its.accept_encoding = "gzip, br";
    EXPECT_EQ(*answer(its).body, "BR");
    its.accept_encoding = "gzip";
    const auto gzip = answer(its);
    EXPECT_EQ(*gzip.body, "GZ");
    EXPECT_EQ(field(gzip, "Content-Encoding"), "gzip");
    EXPECT_EQ(field(gzip, "Vary"), "Accept-Encoding");
    EXPECT_EQ(field(gzip, "Content-Type"), "text/html; charset=utf-8");
    EXPECT_NE(field(gzip, "ETag"), field(answer(request("GET", "/")), "ETag"));
}

TEST_F(ConsoleCoreTest, WhatTheBrowserHasIsNotSentAgain) {
    auto its = request("GET", "/");
    its.if_none_match = "\"aa\"";
    const auto got = answer(its);
    EXPECT_EQ(got.status, 304);
    EXPECT_EQ(got.body, nullptr);
    its.accept_encoding = "br";
    EXPECT_EQ(answer(its).status, 200) << "another coding";
}

TEST_F(ConsoleCoreTest, EveryAnswerHasThePolicy) {
    for (const auto* path : {"/", "/assets/app-1.js", "/nothing", "/ticket"}) {
        const auto its = answer(request("GET", path));
        const auto policy = field(its, "Content-Security-Policy");
        EXPECT_THAT(policy, HasSubstr("connect-src 'self' ws://127.0.0.1:10418 ws://127.0.0.1:10419"))
            << path;
        EXPECT_THAT(policy, HasSubstr("frame-ancestors 'none'"));
        EXPECT_THAT(policy, HasSubstr("default-src 'none'"));
        EXPECT_THAT(policy, Not(HasSubstr("unsafe"))) << path;
        EXPECT_EQ(field(its, "X-Content-Type-Options"), "nosniff");
    }
}

TEST_F(ConsoleCoreTest, NothingButItsFilesIsThere) {
    for (const auto* path :
         {"/../etc/passwd", "/assets/../../etc/passwd", "//etc/passwd", "/assets", "/assets/", "/.git/config",
          "/index.html/", "", "index.html", "/INDEX.HTML", "*"})
        EXPECT_EQ(answer(request("GET", path)).status, 404) << path;
}

TEST_F(ConsoleCoreTest, AForeignHostIsRefused) {
    for (const auto* host : {"rebound.example:10417", "rebound.example", "", "127.0.0.1:8080"}) {
        auto its = request("GET", "/");
        its.host = host;
        const auto got = answer(its);
        EXPECT_EQ(got.status, 421) << host;
        EXPECT_THAT(*got.body, Not(HasSubstr("<html>")));
        EXPECT_THAT(field(got, "Content-Security-Policy"), HasSubstr("default-src 'none'"));
    }
}

TEST_F(ConsoleCoreTest, FilesAreOnlyRead) {
    for (const auto* method : {"POST", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "BREW"}) {
        const auto its = answer(request(method, "/index.html"));
        EXPECT_EQ(its.status, 405) << method;
        EXPECT_EQ(field(its, "Allow"), "GET, HEAD");
    }
    EXPECT_EQ(answer(request("GET", "/login")).status, 405);
}

TEST_F(ConsoleCoreTest, ARightPasswordGivesACookieThatScriptsCannotRead) {
    const auto its = answer(logIn("user=anna&password=right"));
    EXPECT_EQ(its.status, 200);
    EXPECT_EQ(Json::parse(*its.body), (Json{{"user", "anna"}, {"role", "operator"}}));
    EXPECT_THAT(field(its, "Set-Cookie"), testing::MatchesRegex("axon-10417=[0-9a-f]{32}; Path=/; "
                                                                "Max-Age=43200; HttpOnly; SameSite=Strict"));
    EXPECT_EQ(field(its, "Cache-Control"), "no-store");
    ASSERT_EQ(notes.size(), 1U);
    EXPECT_THAT(notes[0], HasSubstr("'anna' logged in from 127.0.0.1:50122 as operator"));
}

TEST_F(ConsoleCoreTest, BehindAProxyThatSpeaksTlsTheCookieIsSecure) {
    auto its = logIn("user=anna&password=right");
    its.host = "lab.example";
    its.origin = "https://lab.example";
    const auto set = field(answer(its), "Set-Cookie");
    EXPECT_THAT(set, testing::StartsWith("__Host-axon="));
    EXPECT_THAT(set, testing::EndsWith("; Secure"));
}

TEST_F(ConsoleCoreTest, AWrongPasswordGivesNone) {
    const auto its = answer(logIn("user=anna&password=wrong"));
    EXPECT_EQ(its.status, 403);
    EXPECT_EQ(field(its, "Set-Cookie"), "");
    EXPECT_EQ(Json::parse(*its.body)["code"], "PERMISSION_DENIED");
}

TEST_F(ConsoleCoreTest, WhatIsNoLogInIsNotVerified) {
    for (const auto* body :
         {"", "user=anna", "password=right", "user=%", "{}", "user=anna&user=x&password=right"})
        EXPECT_EQ(answer(logIn(body)).status, 400) << body;
    auto its = logIn("user=anna&password=right");
    its.content_type = "text/plain";
    EXPECT_EQ(answer(its).status, 400);
    its = logIn("");
    its.too_large = true;
    EXPECT_EQ(answer(its).status, 413);
    EXPECT_EQ(logins.asked, 0);
}

TEST_F(ConsoleCoreTest, AForeignPageCannotLogInOutOrGetATicket) {
    for (const auto* path : {"/login", "/logout", "/ticket"}) {
        for (const auto* origin :
             {"", "null", "http://other.example", "http://127.0.0.1:3000", "http://localhost:10417",
              "https://127.0.0.1:10417", "https://lab.example"}) {
            auto its = logIn("user=anna&password=right");
            its.path = path;
            its.origin = origin;
            const auto got = answer(its);
            EXPECT_EQ(got.status, 403) << path << ' ' << origin;
            EXPECT_EQ(field(got, "Set-Cookie"), "");
        }
    }
    EXPECT_EQ(logins.asked, 0);
}

TEST_F(ConsoleCoreTest, ATicketIsForWhoHasTheCookie) {
    auto its = request("POST", "/ticket");
    EXPECT_EQ(answer(its).status, 401);
    its.cookie = "other=1; " + cookieOf(answer(logIn("user=anna&password=right")));
    const auto got = answer(its);
    ASSERT_EQ(got.status, 200);
    const auto ticket = Json::parse(*got.body);
    EXPECT_EQ(ticket["user"], "anna");
    EXPECT_EQ(ticket["endpoint"], "ws -h 127.0.0.1 -p 10418 -r /axon");
    EXPECT_EQ(visitors.redeem(ticket["password"].get<std::string>()), "anna");
}

TEST_F(ConsoleCoreTest, ABadCookieGetsNoTicket) {
    const auto good = cookieOf(answer(logIn("user=anna&password=right")));
    auto its = request("POST", "/ticket");
    for (const auto& bad :
         {good + "0", good.substr(0, good.size() - 1), good + "; " + good, std::string("axon-10417="),
          std::string(4000, ';'), "axon-10418=" + good.substr(11)}) {
        its.cookie = bad;
        EXPECT_EQ(answer(its).status, 401) << bad;
    }
}

TEST_F(ConsoleCoreTest, AfterLogOutTheCookieIsVoid) {
    auto its = request("POST", "/logout");
    its.cookie = cookieOf(answer(logIn("user=anna&password=right")));
    const auto got = answer(its);
    EXPECT_EQ(got.status, 200);
    EXPECT_THAT(field(got, "Set-Cookie"), HasSubstr("Max-Age=0"));
    its.path = "/ticket";
    EXPECT_EQ(answer(its).status, 401);
}

TEST_F(ConsoleCoreTest, ASecondLogInEndsTheFirst) {
    auto its = request("POST", "/ticket");
    its.cookie = cookieOf(answer(logIn("user=anna&password=right")));
    auto again = logIn("user=anna&password=right");
    again.cookie = its.cookie;
    answer(again);
    EXPECT_EQ(answer(its).status, 401);
}

TEST_F(ConsoleCoreTest, WithoutUsersNobodyLogsIn) {
    logins.users = false;
    EXPECT_EQ(Json::parse(*answer(logIn("")).body), (Json{{"user", ""}, {"role", ""}}));
    EXPECT_EQ(Json::parse(*answer(request("POST", "/ticket")).body),
              (Json{{"user", ""}, {"password", ""}, {"endpoint", "ws -h 127.0.0.1 -p 10418 -r /axon"}}));
}

TEST_F(ConsoleCoreTest, ALogInMayBeDecidedLater) {
    std::optional<Answer> got;
    core.handle(logIn("user=later&password=x"), [&](Answer its) { got = std::move(its); });
    EXPECT_FALSE(got);
    logins.later(LoginPort::Visitor{"later", "admin"});
    ASSERT_TRUE(got);
    EXPECT_EQ(got->status, 200);
    EXPECT_NE(field(*got, "Content-Security-Policy"), "");
}

TEST_F(ConsoleCoreTest, AConsoleThatIsNotBuiltSaysHowToBuildIt) {
    files.all.clear();
    const auto its = answer(request("GET", "/"));
    EXPECT_EQ(its.status, 503);
    EXPECT_THAT(
        *its.body,
        HasSubstr(
            "cmake -DAXON_WEB=ON build/release &amp;&amp; cmake --build build/release --target console"));
    EXPECT_THAT(*its.body, HasSubstr("/share/&lt;console&gt;"));
    EXPECT_EQ(answer(request("GET", "/other.js")).status, 404);
}

TEST_F(ConsoleCoreTest, BehindAProxyWhoeverItForwardsForLogsIn) {
    auto its = logIn("user=anna&password=right");
    its.host = "lab.example";
    its.origin = "https://lab.example";
    its.forwarded_for = "198.51.100.1, 192.0.2.7";
    answer(its);
    EXPECT_EQ(logins.peer, "192.0.2.7:0");
    its.forwarded_for = "unknown";
    answer(its);
    EXPECT_EQ(logins.peer, "127.0.0.1:50122");
}

TEST_F(ConsoleCoreTest, NobodyButTheProxySaysForWhomItSpeaks) {
    auto its = logIn("user=anna&password=right");
    its.forwarded_for = "192.0.2.7";
    answer(its);
    EXPECT_EQ(logins.peer, "127.0.0.1:50122") << "not under the proxy's name";
    its.host = "lab.example";
    its.origin = "https://lab.example";
    its.peer = "203.0.113.5:50122";
    its.local = "203.0.113.1:10417";
    answer(its);
    EXPECT_EQ(logins.peer, "203.0.113.5:50122") << "not from this machine";
}

TEST_F(ConsoleCoreTest, WhereItsFolderIsConcernsThisMachineOnly) {
    files.all.clear();
    auto its = request("GET", "/");
    its.peer = "192.0.2.7:50122";
    its.host = its.local = "192.0.2.1:10417";
    const auto far = answer(its);
    EXPECT_EQ(far.status, 503);
    EXPECT_THAT(*far.body, Not(HasSubstr("/share/")));
    EXPECT_THAT(*far.body, HasSubstr("--target console"));
    its = request("GET", "/");
    its.host = "lab.example";
    EXPECT_THAT(*answer(its).body, Not(HasSubstr("/share/"))) << "anybody behind the proxy";
}

TEST_F(ConsoleCoreTest, WhatIsRefusedIsRecordedByTheAddress) {
    auto foreign_host = request("GET", "/");
    foreign_host.host = "rebound.example";
    auto foreign_page = request("POST", "/login");
    foreign_page.origin = "http://other.example";
    auto large = logIn("");
    large.too_large = true;
    auto old_cookie = request("POST", "/ticket");
    old_cookie.cookie = "axon-10417=0123456789abcdef0123456789abcdef";
    for (const auto& [its, outcome] :
         {std::pair{foreign_host, "PERMISSION_DENIED"}, std::pair{request("PUT", "/"), "PERMISSION_DENIED"},
          std::pair{request("GET", "/login"), "PERMISSION_DENIED"},
          std::pair{foreign_page, "PERMISSION_DENIED"}, std::pair{large, "TOO_LARGE"},
          std::pair{logIn("user"), "MALFORMED"}, std::pair{old_cookie, "PERMISSION_DENIED"}}) {
        const auto before = logins.turned_away.size();
        EXPECT_GE(answer(its).status, 400);
        ASSERT_EQ(logins.turned_away.size(), before + 1) << its.method << its.path;
        EXPECT_EQ(logins.turned_away.back(),
                  std::string("127.0.0.1:50122 | a request to the web console | ") + outcome);
        EXPECT_THAT(notes.back(), HasSubstr("127.0.0.1:50122"));
    }
    const auto before = logins.turned_away.size();
    EXPECT_EQ(answer(request("POST", "/ticket")).status, 401) << "a browser's first visit";
    EXPECT_EQ(answer(request("GET", "/nothing")).status, 404);
    EXPECT_EQ(logins.turned_away.size(), before);
}

}  // namespace
}  // namespace axon::console
