// SPDX-License-Identifier: GPL-2.0-or-later
// The rim on real sockets: what a request that breaks the rules of HTTP, or of time, comes to.
#include "console/http_server.hpp"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <functional>
#include <mutex>
#include <optional>

#include "common/descriptor.hpp"
#include "common/refuse.hpp"
#include "support/loopback.hpp"
#include "support/moved_clock.hpp"

namespace axon::console {
namespace {

using namespace std::chrono_literals;
using test::loopbackAddress;
using test::waitUntil;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

class OneFile final : public FilesPort {
  public:
    std::shared_ptr<const BuiltFiles> files() override { return all_; }
    std::string folder() const override { return "here"; }

  private:
    const std::shared_ptr<const BuiltFiles> all_ = std::make_shared<const BuiltFiles>(
        BuiltFiles{{"/index.html",
                    {"text/html; charset=utf-8", "aa", std::make_shared<const std::string>("<html>page"),
                     nullptr, nullptr}},
                   {"/large.bin",
                    {"application/octet-stream", "bb",
                     std::make_shared<const std::string>(std::string(8 << 20, 'x')), nullptr, nullptr}}});
};

class HeldLogins final : public LoginPort {
  public:
    bool needed() const override { return true; }
    void login(const std::string&, const std::string&, const Request&, Answered answered) override {
        const std::lock_guard lock(mutex_);
        held_.push_back(std::move(answered));
    }
    void turnedAway(const std::string& peer, const std::string&, const Refusal& refusal) override {
        const std::lock_guard lock(mutex_);
        turned_away_.push_back(peer + ": " + refusal.message);
    }
    bool hasTurnedAway(const std::string& words) {
        const std::lock_guard lock(mutex_);
        return std::any_of(turned_away_.begin(), turned_away_.end(),
                           [&](const auto& one) { return one.find(words) != std::string::npos; });
    }
    std::string turnedAway() {
        const std::lock_guard lock(mutex_);
        std::string all;
        for (const auto& one : turned_away_) all += one + "\n";
        return all;
    }
    std::size_t count() {
        const std::lock_guard lock(mutex_);
        return held_.size();
    }
    void settle() {
        const std::lock_guard lock(mutex_);
        for (auto& answered : held_) answered(Visitor{"anna", "operator"});
        held_.clear();
    }

  private:
    std::mutex mutex_;
    std::vector<Answered> held_;
    std::vector<std::string> turned_away_;
};

class HttpServerTest : public testing::Test {
  protected:
    explicit HttpServerTest(unsigned connections_of_one = 64, bool real_time = false,
                            unsigned connections_of_proxy = 0) {
        HttpServer::Settings settings;
        settings.host = loopbackAddress();
        settings.connections_of_one_max = connections_of_one;
        settings.connections_of_proxy_max = connections_of_proxy;
        server.emplace(settings);
        core.emplace(Sites({false, server->port(), 10418, 10419, {}, {}}), files, logins, visitors,
                     [](const auto&) {});
        server->serve(*core, real_time ? static_cast<const Clock&>(steady) : clock);
    }
    ~HttpServerTest() override {
        logins.settle();
        server.reset();
    }

    std::string host() const { return loopbackAddress() + ":" + std::to_string(server->port()); }
    Descriptor connected() const {
        Descriptor fd(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
        const timeval patience{10, 0};
        ::setsockopt(fd.get(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
        sockaddr_in address{};
        address.sin_family = AF_INET;
        address.sin_port = htons(server->port());
        ::inet_pton(AF_INET, loopbackAddress().c_str(), &address.sin_addr);
        EXPECT_EQ(::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
        return fd;
    }
    static bool write(const Descriptor& to, std::string_view text) {
        while (!text.empty()) {
            const auto sent = ::send(to.get(), text.data(), text.size(), MSG_NOSIGNAL);
            if (sent <= 0) return false;
            text.remove_prefix(static_cast<std::size_t>(sent));
        }
        return true;
    }
    /// Until the server closes, or `end` has come.
    static std::string read(const Descriptor& from, std::string_view end = {}) {
        std::string all;
        char buffer[65536];
        while (end.empty() || all.find(end) == std::string::npos) {
            const auto got = ::recv(from.get(), buffer, sizeof buffer, 0);
            if (got < 0 && errno == EAGAIN)
                ADD_FAILURE() << "the server is silent after: " << all.substr(0, 200);
            if (got <= 0) break;
            all.append(buffer, static_cast<std::size_t>(got));
        }
        return all;
    }
    std::string get(const std::string& path, const std::string& more = {}) const {
        return "GET " + path + " HTTP/1.1\r\nHost: " + host() + "\r\n" + more + "\r\n";
    }
    std::string exchange(const std::string& text) const {
        const auto fd = connected();
        write(fd, text);
        ::shutdown(fd.get(), SHUT_WR);
        return read(fd);
    }
    std::string post(const std::string& path, const std::string& body, const std::string& more = {}) const {
        return "POST " + path + " HTTP/1.1\r\nHost: " + host() + "\r\nOrigin: http://" + host() +
               "\r\nContent-Type: application/x-www-form-urlencoded\r\n" + more +
               "Content-Length: " + std::to_string(body.size()) + "\r\n\r\n" + body;
    }
    /// What came until the server closed, while time passes.
    std::string readWhileTimePasses(
        const Descriptor& from, const std::function<void()>& each = [] {}) {
        std::string all;
        EXPECT_TRUE(waitUntil([&] {
            char buffer[65536];
            const auto got = ::recv(from.get(), buffer, sizeof buffer, MSG_DONTWAIT);
            if (got > 0) all.append(buffer, static_cast<std::size_t>(got));
            if (got < 0 && errno == EAGAIN) {
                each();
                clock.advance(1s);
            }
            return got == 0 || (got < 0 && errno != EAGAIN);
        }));
        return all;
    }
    bool serves() const {
        return exchange(get("/", "Connection: close\r\n")).find("<html>page") != std::string::npos;
    }

    test::MovedClock clock;
    SteadyClock steady;
    SystemRandom random;
    OneFile files;
    HeldLogins logins;
    Visitors visitors{clock, random};
    std::optional<HttpServer> server;
    std::optional<ConsoleCore> core;
};

TEST_F(HttpServerTest, ServesItsFiles) {
    const auto got = exchange(get("/", "Connection: close\r\n"));
    EXPECT_THAT(got, StartsWith("HTTP/1.1 200 "));
    EXPECT_THAT(got, HasSubstr("Content-Security-Policy: default-src 'none'"));
    EXPECT_THAT(got, HasSubstr("\r\n\r\n<html>page"));
}

TEST_F(HttpServerTest, HeadHasNoBody) {
    const auto got = exchange("HEAD / HTTP/1.1\r\nHost: " + host() + "\r\nConnection: close\r\n\r\n");
    EXPECT_THAT(got, HasSubstr("Content-Length: 10\r\n"));
    EXPECT_THAT(got, testing::EndsWith("\r\n\r\n"));
}

TEST_F(HttpServerTest, PipelinedRequestsAreAnsweredInOrder) {
    const auto got = exchange(get("/") + get("/nothing") + get("/", "Connection: close\r\n"));
    const auto first = got.find("HTTP/1.1 200 "), second = got.find("HTTP/1.1 404 ");
    EXPECT_EQ(first, 0U);
    ASSERT_NE(second, std::string::npos);
    EXPECT_NE(got.find("HTTP/1.1 200 ", second), std::string::npos);
}

TEST_F(HttpServerTest, NoPathLeadsOutOfTheFolder) {
    for (const auto* path :
         {"/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%2f..%2fetc%2fpasswd", "//etc/passwd",
          "/index.html%00.js/../../etc/passwd", "/./../etc/passwd", "/%c0%ae%c0%ae/etc/passwd"}) {
        const auto got = exchange(get(path, "Connection: close\r\n"));
        EXPECT_THAT(got, Not(HasSubstr("root:"))) << path;
        EXPECT_THAT(got, StartsWith("HTTP/1.1 ")) << path;
    }
}

TEST_F(HttpServerTest, AForeignHostIsRefused) {
    EXPECT_THAT(exchange("GET / HTTP/1.1\r\nHost: rebound.example\r\nConnection: close\r\n\r\n"),
                StartsWith("HTTP/1.1 421 "));
    EXPECT_THAT(exchange("GET / HTTP/1.0\r\n\r\n"), HasSubstr(" 421 ")) << "without a host";
}

TEST_F(HttpServerTest, AHugeHeaderIsRefusedAndNobodyElseNotices) {
    const auto got = exchange(get("/", "X-Huge: " + std::string(1 << 20, 'x') + "\r\n"));
    EXPECT_THAT(got, Not(HasSubstr("<html>page")));
    const auto many = [] {
        std::string lines;
        for (int i = 0; i < 5000; ++i) lines += "X-" + std::to_string(i) + ": y\r\n";
        return lines;
    }();
    EXPECT_THAT(exchange(get("/", many)), Not(HasSubstr("<html>page")));
    EXPECT_THAT(exchange(get("/" + std::string(1 << 20, 'x'))), Not(HasSubstr("<html>page")));
    EXPECT_TRUE(serves());
}

TEST_F(HttpServerTest, ABodyThatIsTooLargeIsRefused) {
    EXPECT_THAT(exchange(post("/login", std::string(100'000, 'x'), "Connection: close\r\n")),
                StartsWith("HTTP/1.1 413 "));
    // In pieces, without its length.
    std::string pieces = "POST /login HTTP/1.1\r\nHost: " + host() + "\r\nOrigin: http://" + host() +
                         "\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n";
    for (int i = 0; i < 20; ++i) pieces += "400\r\n" + std::string(1024, 'x') + "\r\n";
    EXPECT_THAT(exchange(pieces + "0\r\n\r\n"), StartsWith("HTTP/1.1 413 "));
    EXPECT_TRUE(serves());
}

TEST_F(HttpServerTest, WhatIsNoHttpIsClosed) {
    for (const auto& text :
         {std::string("\0\1\2\3\r\n\r\n", 8), std::string("IceP\1\0\1\0\3\0\16\0\0\0", 14),
          std::string("GET\r\n\r\n"), std::string("\x16\3\1\2\0\1\0\1\xfc\3\3"),
          std::string("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"), std::string(100, '\n'),
          "POST /login HTTP/1.1\r\nHost: " + host() + "\r\nContent-Length: -1\r\n\r\nuser=anna&password=x"}) {
        const auto fd = connected();
        write(fd, text);
        const auto got = readWhileTimePasses(fd);
        EXPECT_THAT(got, Not(HasSubstr("<html>page"))) << text;
        EXPECT_THAT(got, Not(HasSubstr(" 200 "))) << text;
    }
    EXPECT_EQ(logins.count(), 0U);
    EXPECT_TRUE(serves());
}

TEST_F(HttpServerTest, WhoSendsNoRequestInTimeIsRecordedByItsAddress) {  // garbage: tests/hostile/abuse.py
    const auto addressOf = [](const Descriptor& fd) {
        sockaddr_in its{};
        socklen_t size = sizeof its;
        ::getsockname(fd.get(), reinterpret_cast<sockaddr*>(&its), &size);
        return ":" + std::to_string(ntohs(its.sin_port)) + ": ";
    };
    const auto slow = connected();
    write(slow, "GET / HT");
    readWhileTimePasses(slow);
    EXPECT_TRUE(waitUntil([&] { return logins.hasTurnedAway(addressOf(slow) + "no request of it was"); }));
    const auto its = [&] {
        const auto leaves = connected();
        return addressOf(leaves);
    }();
    EXPECT_TRUE(serves() && serves()) << "by then it has seen the end of the other";
    EXPECT_FALSE(logins.hasTurnedAway(its)) << "it left: " << its << "\n" << logins.turnedAway();
}

TEST_F(HttpServerTest, AnOriginThatIsNullOrThereTwiceIsForeign) {
    const auto ours = "Origin: http://" + host() + "\r\n", foreign = std::string("Origin: http://other\r\n");
    for (const auto& origins : {std::string("Origin: null\r\n"), ours + foreign, foreign + ours, ours + ours})
        EXPECT_THAT(exchange("POST /login HTTP/1.1\r\nHost: " + host() + "\r\n" + origins +
                             "Connection: close\r\nContent-Length: 0\r\n\r\n"),
                    StartsWith("HTTP/1.1 403 "))
            << origins;
    EXPECT_EQ(logins.count(), 0U);
    EXPECT_THAT(exchange(get("/", "Host: other.example\r\nConnection: close\r\n")),
                Not(HasSubstr("<html>page")))
        << "nor is a second host";
}

TEST_F(HttpServerTest, ARequestWithTwoLengthsIsRefusedAndNothingBehindItIsRead) {
    const auto head = "POST /login HTTP/1.1\r\nHost: " + host() + "\r\nOrigin: http://" + host() + "\r\n";
    for (const auto* lengths : {"Content-Length: 4\r\nTransfer-Encoding: chunked\r\n",
                                "Transfer-Encoding: chunked\r\nContent-Length: 4\r\n",
                                "Transfer-Encoding: chunked\r\nContent-Length: 0\r\n"}) {
        const auto got = exchange(head + lengths + "\r\n0\r\n\r\n" + get("/"));
        EXPECT_THAT(got, StartsWith("HTTP/1.1 400 ")) << lengths;
        EXPECT_THAT(got, Not(HasSubstr("<html>page"))) << lengths;
    }
    EXPECT_EQ(logins.count(), 0U);
    EXPECT_TRUE(serves());
}

TEST_F(HttpServerTest, AByteAtATimeHoldsNoConnection) {
    const auto slow = connected();
    write(slow, "GET / HTTP/1.1\r\nHost: " + host() + "\r\nX-Slow: ");
    EXPECT_TRUE(serves()) << "others are served meanwhile";
    std::size_t bytes = 0;
    EXPECT_EQ(readWhileTimePasses(slow,
                                  [&] {
                                      write(slow, "x");
                                      ++bytes;
                                  }),
              "");
    EXPECT_GE(bytes, 14U);
}

TEST_F(HttpServerTest, ABodyThatComesAByteAtATimeHoldsNoConnection) {
    const auto slow = connected();
    write(slow, "POST /login HTTP/1.1\r\nHost: " + host() + "\r\nContent-Length: 4000\r\n\r\n");
    EXPECT_EQ(readWhileTimePasses(slow, [&] { write(slow, "x"); }), "");
    EXPECT_EQ(logins.count(), 0U);
}

TEST_F(HttpServerTest, AnAnswerThatNobodyReadsEnds) {
    const auto slow = connected();
    const int small = 65536;
    ::setsockopt(slow.get(), SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
    write(slow, get("/large.bin"));
    EXPECT_THAT(read(slow, "\r\n\r\n"), StartsWith("HTTP/1.1 200 "));
    clock.advance(121s);
    EXPECT_TRUE(serves());
    EXPECT_LT(read(slow).size(), std::size_t{8} << 20U);
}

TEST_F(HttpServerTest, ALogInThatTakesItsTimeHoldsUpNobody) {
    const auto waiting = connected();
    write(waiting, post("/login", "user=anna&password=x"));
    ASSERT_TRUE(waitUntil([&] { return logins.count() == 1; }));
    EXPECT_TRUE(serves());
    logins.settle();
    const auto got = read(waiting, "\"anna\"");
    EXPECT_THAT(got, StartsWith("HTTP/1.1 200 "));
    EXPECT_THAT(got, HasSubstr("Set-Cookie: axon-"));
}

TEST_F(HttpServerTest, EndsWhileALogInWaits) {
    const auto waiting = connected();
    write(waiting, post("/login", "user=anna&password=x"));
    ASSERT_TRUE(waitUntil([&] { return logins.count() == 1; }));
    server.reset();
    EXPECT_EQ(read(waiting).find("200"), std::string::npos);
    logins.settle();  // too late, and harmless
}

TEST_F(HttpServerTest, EndsWhileConnectionsAreOpen) {
    const auto idle = connected(), half = connected();
    write(half, "GET / HT");
    EXPECT_TRUE(serves());
    server.reset();
    EXPECT_EQ(read(idle), "");
}

TEST_F(HttpServerTest, ATakenPortIsSaid) {
    HttpServer::Settings settings;
    settings.host = loopbackAddress();
    settings.port = server->port();
    try {
        const HttpServer second(settings);
        FAIL() << "expected a misconfiguration";
    } catch (const std::runtime_error& error) {
        EXPECT_THAT(error.what(), HasSubstr("fix: "));
    }
    settings.host = "lab.example";
    EXPECT_THROW(HttpServer{settings}, std::runtime_error);
}

TEST_F(HttpServerTest, ACertificateThatIsNoneIsSaid) {
    HttpServer::Settings settings;
    settings.host = loopbackAddress();
    settings.certificate = settings.key = "no certificate";
    HttpServer other(settings);
    EXPECT_THROW(other.serve(*core, clock), std::runtime_error);
}

class InRealTime : public HttpServerTest {
  protected:
    InRealTime() : HttpServerTest(64, true) {}
};

TEST_F(InRealTime, ALogInIsAnsweredAtOnceWhenItIsDecided) {
    const auto waiting = connected();
    write(waiting, post("/login", "user=anna&password=x"));
    ASSERT_TRUE(waitUntil([&] { return logins.count() == 1; }));
    // Nothing else happens that would wake the server's thread.
    EXPECT_FALSE(waitUntil([] { return false; }, 100ms));
    logins.settle();
    EXPECT_THAT(read(waiting, "\"anna\""), StartsWith("HTTP/1.1 200 "));
}

class FewConnections : public HttpServerTest {
  protected:
    FewConnections() : HttpServerTest(4) {}
};

TEST_F(FewConnections, OfOneAddressAreServedAndMoreAreClosed) {
    std::vector<Descriptor> open;
    for (int i = 0; i < 4; ++i) open.push_back(connected());
    for (const auto& one : open) {
        write(one, get("/"));
        EXPECT_THAT(read(one, "<html>page"), HasSubstr("200"));
    }
    const auto more = connected();
    write(more, get("/"));
    EXPECT_THAT(read(more), Not(HasSubstr("<html>page")));
    open.clear();
    EXPECT_TRUE(waitUntil([&] { return serves(); }));
}

class FewConnectionsButOfTheProxy : public HttpServerTest {
  protected:
    FewConnectionsButOfTheProxy() : HttpServerTest(2, false, 6) {}
};

TEST_F(FewConnectionsButOfTheProxy, AProxyHasThoseOfEverybodyBehindIt) {
    std::vector<Descriptor> open;
    for (int i = 0; i < 6; ++i) {
        open.push_back(connected());
        write(open.back(), get("/"));
        EXPECT_THAT(read(open.back(), "<html>page"), HasSubstr("200"));
    }
    const auto more = connected();
    write(more, get("/"));
    EXPECT_THAT(read(more), Not(HasSubstr("<html>page")));
}

}  // namespace
}  // namespace axon::console
