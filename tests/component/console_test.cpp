// SPDX-License-Identifier: GPL-2.0-or-later
// The web console from outside: pages over HTTP, and sessions over WebSocket as a browser opens them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <array>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "common/descriptor.hpp"
#include "component/any_ports.hpp"
#include "component/raw_peers.hpp"
#include "support/certificate_folder.hpp"
#include "support/log_lines.hpp"
#include "transport/ice/endpoint.hpp"

namespace axon::test {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;
using Json = nlohmann::json;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

Descriptor connectedTo(const std::string& host, std::uint16_t port) {
    Descriptor fd(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    ::inet_pton(AF_INET, host.c_str(), &address.sin_addr);
    const timeval patience{10, 0};
    ::setsockopt(fd.get(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    EXPECT_EQ(::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    return fd;
}

void sendAll(int fd, std::string_view text) {
    while (!text.empty()) {
        const auto sent = ::send(fd, text.data(), text.size(), MSG_NOSIGNAL);
        if (sent <= 0) return;
        text.remove_prefix(static_cast<std::size_t>(sent));
    }
}

std::string received(int fd, std::string_view end = {}) {
    std::string all;
    std::array<char, 4096> buffer;
    while (end.empty() || all.find(end) == std::string::npos) {
        const auto got = ::recv(fd, buffer.data(), buffer.size(), 0);
        if (got <= 0) break;
        all.append(buffer.data(), static_cast<std::size_t>(got));
    }
    return all;
}

/// A relay for one connection that writes a header into the request of its WebSocket: Ice for C++ sends no
/// Origin, as a browser does.
class WithOrigin {
  public:
    WithOrigin(const std::string& host, std::uint16_t port, std::string origin)
        : listener_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
        sockaddr_in address{};
        address.sin_family = AF_INET;
        ::inet_pton(AF_INET, loopbackAddress().c_str(), &address.sin_addr);
        ::bind(listener_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address);
        ::listen(listener_.get(), 4);
        socklen_t size = sizeof address;
        ::getsockname(listener_.get(), reinterpret_cast<sockaddr*>(&address), &size);
        port_ = ntohs(address.sin_port);
        thread_ = std::thread([this, host, port, origin = std::move(origin)] {
            const Descriptor near(::accept(listener_.get(), nullptr, nullptr));
            if (near.get() < 0) return;
            const auto far = connectedTo(host, port);
            auto request = received(near.get(), "\r\n\r\n");
            request.insert(request.find("\r\n") + 2, "Origin: " + origin + "\r\n");
            sendAll(far.get(), request);
            std::thread back([&] { pump(far.get(), near.get()); });
            pump(near.get(), far.get());
            back.join();
        });
    }
    ~WithOrigin() {
        ::shutdown(listener_.get(), SHUT_RDWR);
        thread_.join();
    }
    std::string endpoint() const {
        return "ws -h " + loopbackAddress() + " -p " + std::to_string(port_) + " -r /axon";
    }

  private:
    static void pump(int from, int to) {
        std::array<char, 4096> buffer;
        while (true) {
            const auto got = ::recv(from, buffer.data(), buffer.size(), 0);
            if (got < 0 && errno == EAGAIN) continue;
            if (got <= 0) break;
            sendAll(to, {buffer.data(), static_cast<std::size_t>(got)});
        }
        ::shutdown(to, SHUT_WR);
        ::shutdown(from, SHUT_RD);
    }
    Descriptor listener_;
    std::uint16_t port_ = 0;
    std::thread thread_;
};

class RawBrowser : public RawClient {
  public:
    RawBrowser(const std::string& endpoint, const std::string& user, const std::string& password,
               const std::map<std::string, std::string>& properties = {})
        : RawClient(Socket{endpoint}, user, password, properties) {}
};

void onAnyPorts(server::ConsoleSettings& console, const std::string& scheme = {}) {
    console.endpoint = console.session_endpoint = console.signal_endpoint = scheme + loopbackAddress() + ":0";
}

std::string socketAt(std::uint16_t port, const std::string& resource) {
    return "ws -h " + loopbackAddress() + " -p " + std::to_string(port) + " -r " + resource;
}

// Of the passwords secret1 to secret3. Those that axon-server writes take long to verify.
constexpr const char* kUsers =
    "boss admin "
    "$6$rounds=1000$saltsalt$LvweozNq3uy/"
    ".3XRgMXda4Dkj6Safv9Yd0DC3zz8ZSfufZc3t21qW1YwrbMBMKZI3arOYmnVgPAJWMORDSoZ6.\n"
    "watcher observer "
    "$6$rounds=1000$saltsalt$IcsFeTyZ4ZRtQlVjJ1XmjetGHC9zmG4II9rU2QAcYsOD1GOILoKhPBfxZ.To2zd7r4hy1h/"
    "LHJos5XGk2/CW00\n"
    "left entity "
    "$6$rounds=1000$saltsalt$h7CeRQwg9/5f04A24xH1ksQkM2fVPsSuL1riltMvYMLRwVnUTkhj9MWGjmepDMnkRbAah.eo6lHpF5/"
    "o.XnyP1\n";

class Console : public testing::Test {
  protected:
    using Change = std::function<void(server::ServerSettings&)>;
    explicit Console(bool with_users = false, const std::vector<std::string>& proxies = {})
        : Console(Change([&](server::ServerSettings& settings) {
              settings.console.proxies = proxies;
              if (!with_users) return;
              settings.users_file = (folder / "users.cfg").string();
              std::ofstream(settings.users_file) << kUsers;
              fs::permissions(settings.users_file, fs::perms::owner_read | fs::perms::owner_write);
          })) {}
    explicit Console(const Change& change) {
        std::string name = (fs::temp_directory_path() / "axon-console-XXXXXX").string();
        folder = ::mkdtemp(name.data());
        auto settings = onLoopback();
        onAnyPorts(settings.console);
        settings.console.folder = (folder / "dist").string();
        change(settings);
        server.emplace(settings);
    }
    ~Console() override {
        server.reset();
        fs::remove_all(folder);
    }

    std::string origin() const {
        auto its = server->consoleAddress();
        its.pop_back();
        return its;
    }
    std::string host() const { return origin().substr(std::string("http://").size()); }
    std::uint16_t port() const {
        return static_cast<std::uint16_t>(std::stoi(host().substr(host().find(':') + 1)));
    }

    std::string exchange(const std::string& text) const {
        const auto fd = connectedTo(loopbackAddress(), port());
        sendAll(fd.get(), text);
        return received(fd.get());
    }
    std::string get(const std::string& path) const {
        return exchange("GET " + path + " HTTP/1.1\r\nHost: " + host() + "\r\nConnection: close\r\n\r\n");
    }
    std::string post(const std::string& path, const std::string& body = {},
                     const std::string& cookie = {}) const {
        return exchange("POST " + path + " HTTP/1.1\r\nHost: " + host() + "\r\nOrigin: " + origin() +
                        "\r\nConnection: close\r\nContent-Type: application/x-www-form-urlencoded\r\n" +
                        (cookie.empty() ? "" : "Cookie: " + cookie + "\r\n") +
                        "Content-Length: " + std::to_string(body.size()) + "\r\n\r\n" + body);
    }
    static Json jsonOf(const std::string& answer) {
        return Json::parse(answer.substr(answer.find("\r\n\r\n") + 4), nullptr, false);
    }
    static std::string cookieOf(const std::string& answer) {
        const std::string name = "Set-Cookie: ";
        const auto at = answer.find(name);
        if (at == std::string::npos) return {};
        const auto begin = at + name.size();
        return answer.substr(begin, answer.find(';', begin) - begin);
    }
    /// A page of this console opens a session.
    Json ticket(const std::string& cookie = {}) const { return jsonOf(post("/ticket", {}, cookie)); }
    std::string sessions() const { return socketAt(server->consoleSessionPort(), "/axon"); }
    std::string signals() const { return socketAt(server->consoleSessionPort(Lane::Signal), "/axon-signal"); }
    static std::string refusalOf(const std::function<void()>& open) {
        try {
            open();
        } catch (const Axon::CommUtil::RequestRefused& refused) {
            return refused.reason;
        }
        return "opened";
    }

    fs::path folder;
    std::optional<server::Server> server;
};

class ConsoleWithUsers : public Console {
  protected:
    ConsoleWithUsers() : Console(true) {}
};

class ConsoleBehindAProxy : public Console {
  protected:
    ConsoleBehindAProxy() : Console(true, {"https://lab.example"}) {}
};

TEST_F(ConsoleBehindAProxy, BothLanesAreAtTheProxy) {
    const auto login = post("/login", "user=watcher&password=secret2");
    const auto its = ticket(cookieOf(login));
    ASSERT_TRUE(its.contains("password")) << its;
    const WithOrigin browser(loopbackAddress(), server->consoleSessionPort(), "https://lab.example");
    const RawBrowser client(browser.endpoint(), "", its["password"]);
    EXPECT_EQ(client.facts.signalEndpoint, "wss -h lab.example -p 443 -r /axon-signal");
}

TEST_F(Console, IsInTheReadyLineAndSaysWhatIsMissing) {
    EXPECT_THAT(server->readyLine(), testing::EndsWith(" console=" + server->consoleAddress()));
    EXPECT_THAT(server->consoleAddress(), StartsWith("http://" + loopbackAddress() + ":"));
    const auto page = get("/");
    EXPECT_THAT(page, StartsWith("HTTP/1.1 503 "));
    EXPECT_THAT(page, HasSubstr("--target console"));
    const auto socket = " ws://" + loopbackAddress() + ":";
    EXPECT_THAT(page, HasSubstr("connect-src 'self'" + socket + std::to_string(server->consoleSessionPort()) +
                                socket + std::to_string(server->consoleSessionPort(Lane::Signal))));
}

TEST_F(Console, ServesWhatHasBeenBuiltMeanwhile) {
    fs::create_directories(folder / "dist/assets");
    std::ofstream(folder / "dist/assets/a.js") << "script";
    std::ofstream(folder / "dist/index.html") << "first page";
    EXPECT_THAT(get("/"), HasSubstr("\r\n\r\nfirst page"));
    EXPECT_THAT(get("/assets/a.js"), HasSubstr("Content-Type: text/javascript; charset=utf-8\r\n"));
    EXPECT_THAT(get("/../../../../../etc/passwd"), StartsWith("HTTP/1.1 404 "));
}

TEST_F(Console, WithoutUsersAPageOpensASessionOverWebSocketAndStopsARobot) {
    RawEntity robot(server->entityAddress(Lane::Data), kFirst);
    robot.join();
    const auto its = ticket();
    ASSERT_TRUE(its.contains("endpoint")) << its;
    const WithOrigin browser(loopbackAddress(), server->consoleSessionPort(), origin());
    RawBrowser client(browser.endpoint(), "", its["password"]);
    EXPECT_EQ(client.facts.signalEndpoint, signals());
    EXPECT_EQ(client.facts.me.role, Axon::CommUtil::Role::Admin) << "the server's own user";
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("joined Robot ") + kFirst); }));
    client.data()->ice_oneway()->sendStopSignal(transport::toIce(client.headTo(kFirst)),
                                                Axon::CommUtil::StopCause::Requested);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested"); }));
    EXPECT_TRUE(waitUntil([&] { return client.log.has("data stop accepted for 1"); }));
}

TEST_F(Console, TheEndpointOfATicketIsThatOfTheSessions) {
    EXPECT_EQ(ticket()["endpoint"], sessions());
    RawBrowser(sessions(), "", "");
}

TEST_F(Console, AStopGoesOverASignalLaneOfItsOwn) {
    RawEntity robot(server->entityAddress(Lane::Data), kFirst);
    robot.join();
    const WithOrigin data(loopbackAddress(), server->consoleSessionPort(), origin());
    const WithOrigin signal(loopbackAddress(), server->consoleSessionPort(Lane::Signal), origin());
    RawBrowser client(data.endpoint(), "", "");
    client.attach(signal.endpoint(), client.facts.token);
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("joined Robot ") + kFirst); }));
    client.stalled = true;  // the page's own data
    client.stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested"); }));
    EXPECT_TRUE(waitUntil([&] { return client.log.has("signal stop accepted for 1"); }));
}

TEST_F(Console, ASignalLaneIsAttachedAtItsOwnPortAndOnce) {
    RawBrowser client(sessions(), "", ""), other(sessions(), "", "");
    const auto refusal = [&](const std::string& endpoint, const std::string& token) {
        const auto its = refusalOf([&] { other.attach(endpoint, token); });
        other.cutSignal();  // a connection has one session
        return its;
    };
    EXPECT_THAT(refusal(sessions(), client.facts.token), HasSubstr("attachSignalLane on the signal port"));
    EXPECT_THAT(refusal(signals(), "guessed"), HasSubstr("no session waits for this token"));
    client.attach(signals(), client.facts.token);
    EXPECT_THAT(refusal(signals(), client.facts.token), HasSubstr("no session waits for this token"));
    EXPECT_NO_THROW(client.signal()->ice_ping());
}

TEST_F(Console, AForeignPageOpensNoSignalLane) {
    for (const auto* foreign : {"http://other.example", "null"}) {
        const WithOrigin browser(loopbackAddress(), server->consoleSessionPort(Lane::Signal), foreign);
        RawBrowser client(sessions(), "", "");
        EXPECT_THAT(refusalOf([&] { client.attach(browser.endpoint(), client.facts.token); }),
                    HasSubstr("not this server's console"))
            << foreign;
        client.attach(signals(), client.facts.token);
    }
}

TEST_F(Console, AForeignPageOpensNoSession) {
    for (const auto* foreign : {"http://other.example", "null", "http://localhost:3000"}) {
        const WithOrigin browser(loopbackAddress(), server->consoleSessionPort(), foreign);
        EXPECT_THAT(refusalOf([&] { RawBrowser(browser.endpoint(), "", ""); }),
                    HasSubstr("not this server's console"))
            << foreign;
    }
}

/// Whatever strangers do at one port of the sessions, it costs them their connection and nobody else
/// anything.
class AbusedPort : public Console, public testing::WithParamInterface<Lane> {
  protected:
    explicit AbusedPort(Duration to_log_in = 60s)
        : Console(Change([&](server::ServerSettings& settings) { settings.console.to_log_in = to_log_in; })) {
    }
    /// Both lanes are open to a browser.
    void TearDown() override {
        EXPECT_TRUE(waitUntil([&] {
            try {
                RawBrowser client(sessions(), "", "");
                client.attach(signals(), client.facts.token);
                return true;
            } catch (const Ice::Exception&) {
                return false;
            }
        }));
    }
    Descriptor connected() const {
        return connectedTo(loopbackAddress(), server->consoleSessionPort(GetParam()));
    }
    static bool isClosed(const Descriptor& fd, std::string* got = nullptr) {
        errno = 0;
        const auto all = received(fd.get());
        if (got != nullptr) *got = all;
        return errno != EAGAIN;
    }
    static std::string request(const std::string& more = {}) {
        return "GET /axon HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
               "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: ice.zeroc.com\r\n"
               "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n" +
               more + "\r\n";
    }
};

class ImpatientPort : public AbusedPort {
  protected:
    ImpatientPort() : AbusedPort(500ms) {}
};

const auto kName = [](const testing::TestParamInfo<Lane>& of) {
    return of.param == Lane::Data ? "Data" : "Signal";
};
INSTANTIATE_TEST_SUITE_P(Console, AbusedPort, testing::Values(Lane::Data, Lane::Signal), kName);
INSTANTIATE_TEST_SUITE_P(Console, ImpatientPort, testing::Values(Lane::Data, Lane::Signal), kName);

TEST_P(ImpatientPort, ClosesWhatIsNoWebSocket) {
    std::vector<Descriptor> open;
    for (const auto& garbage :
         {std::string("\0\1\2\3\r\n\r\n", 8), std::string("IceP\1\0\1\0\3\0\16\0\0\0", 14),
          std::string("\x16\3\1\2\0\1\0\1\xfc\3\3"), std::string("POST /axon HTTP/1.1\r\n\r\n"),
          std::string("GET /axon HTTP/1.1\r\n\r\n"), std::string(1000, '\n'),
          request() + std::string(100, '\xff'),
          request() + std::string("\x82\xff\x7f\xff\xff\xff\xff\xff\xff\xff", 10)}) {
        open.push_back(connected());
        sendAll(open.back().get(), garbage);
    }
    for (std::size_t i = 0; i < open.size(); ++i) EXPECT_TRUE(isClosed(open[i])) << i;
}

TEST_P(ImpatientPort, ClosesWhoSendsNothing) {
    const auto silent = connected(), half = connected(), upgraded = connected();
    ::shutdown(half.get(), SHUT_WR);
    sendAll(upgraded.get(), request());
    EXPECT_TRUE(isClosed(silent));
    EXPECT_TRUE(isClosed(half));
    std::string got;
    EXPECT_TRUE(isClosed(upgraded, &got));
    EXPECT_THAT(got, StartsWith("HTTP/1.1 101 ")) << "it was a WebSocket";
}

TEST_P(ImpatientPort, ClosesWhoSendsAByteAtATime) {
    const auto slow = connected();
    sendAll(slow.get(), "GET /axon HTTP/1.1\r\nX-Slow: ");
    EXPECT_TRUE(waitUntil([&] { return ::send(slow.get(), "x", 1, MSG_NOSIGNAL) < 0; }));
}

TEST_P(AbusedPort, ClosesAHugeRequest) {
    const auto fd = connected();
    sendAll(fd.get(), request("X-Huge: " + std::string(1 << 20, 'x') + "\r\n"));
    std::string got;
    EXPECT_TRUE(isClosed(fd, &got));
    EXPECT_THAT(got, Not(HasSubstr("101")));
}

TEST_P(AbusedPort, RefusesAForeignPageAndOneThatNamesTwoOrigins) {
    for (const auto& origins :
         {std::string("http://other.example"), std::string("null"),
          origin() + "\r\nOrigin: http://other.example", "http://other.example\r\nOrigin: " + origin()}) {
        const WithOrigin browser(loopbackAddress(), server->consoleSessionPort(GetParam()), origins);
        EXPECT_THAT(refusalOf([&] {
                        RawBrowser client(GetParam() == Lane::Data ? browser.endpoint() : sessions(), "", "");
                        if (GetParam() == Lane::Signal) client.attach(browser.endpoint(), client.facts.token);
                    }),
                    HasSubstr("not this server's console"))
            << origins;
    }
}

TEST_P(AbusedPort, OfManyConnectionsTheOldestIsClosed) {
    std::vector<Descriptor> open;
    for (int i = 0; i < 80; ++i) open.push_back(connected());
    EXPECT_TRUE(isClosed(open.front()));
    char byte = 0;
    EXPECT_EQ(::recv(open.back().get(), &byte, 1, MSG_DONTWAIT), -1) << "the youngest is not";
    RawClient(server->clientAddress(Lane::Data));
}

TEST_F(Console, AMessageThatIsLargerThanAPageSendsEndsItsSession) {
    RawBrowser client(sessions(), "", ""), other(sessions(), "", "");
    client.text(kFirst, std::string(std::size_t{400} << 10U, 'x'));
    EXPECT_NO_THROW(client.data()->ice_ping());
    EXPECT_TRUE(waitUntil([&] {
        try {
            client.text(kFirst, std::string(std::size_t{600} << 10U, 'x'));
            return false;
        } catch (const Ice::Exception&) {
            return true;
        }
    }));
    EXPECT_NO_THROW(other.data()->ice_ping());
}

TEST_F(ConsoleWithUsers, APasswordGivesACookieTheCookieATicketAndTheTicketASession) {
    EXPECT_THAT(post("/ticket"), StartsWith("HTTP/1.1 401 "));
    const auto login = post("/login", "user=watcher&password=secret2");
    ASSERT_THAT(login, StartsWith("HTTP/1.1 200 "));
    EXPECT_EQ(jsonOf(login), (Json{{"user", "watcher"}, {"role", "observer"}}));
    const auto cookie = cookieOf(login);
    const auto its = ticket(cookie);
    ASSERT_TRUE(its.contains("password")) << its;
    {
        const RawBrowser client(sessions(), its["user"], its["password"]);
        EXPECT_EQ(client.facts.me.role, Axon::CommUtil::Role::Observer);
        EXPECT_THAT(client.facts.me.name, StartsWith("watcher@"));
    }
    EXPECT_THAT(refusalOf([&] { RawBrowser(sessions(), its["user"], its["password"]); }),
                HasSubstr("good once"));
    EXPECT_THAT(post("/logout", {}, cookie), StartsWith("HTTP/1.1 200 "));
    EXPECT_THAT(post("/ticket", {}, cookie), StartsWith("HTTP/1.1 401 "));
}

TEST_F(ConsoleWithUsers, WhoComesBackWithAnotherUsersTicketIsThatUser) {
    const auto watcher = cookieOf(post("/login", "user=watcher&password=secret2"));
    const auto boss = cookieOf(post("/login", "user=boss&password=secret1"));
    std::string first, token;
    {
        RawBrowser client(sessions(), "watcher", ticket(watcher)["password"]);
        first = client.facts.me.id;
        token = client.facts.token;
        client.data()->leave();
    }
    // The ticket says who it is, whatever name comes with it.
    RawBrowser again(sessions(), "watcher", ticket(boss)["password"]);
    EXPECT_EQ(again.facts.me.role, Axon::CommUtil::Role::Admin);
    EXPECT_THAT(again.facts.me.name, StartsWith("boss@"));
    EXPECT_NE(again.facts.me.id, first);
    EXPECT_THAT(refusalOf([&] { again.attach(signals(), token); }), HasSubstr("no session waits"))
        << "nothing of the other one's is left";
}

TEST_F(ConsoleWithUsers, APasswordOpensNoSession) {
    EXPECT_THAT(refusalOf([&] { RawBrowser(sessions(), "boss", "secret1"); }), HasSubstr("ticket"));
}

TEST_F(ConsoleWithUsers, WrongPasswordsAreRefusedAndSlowedDown) {
    for (int i = 0; i < 3; ++i)
        EXPECT_THAT(post("/login", "user=boss&password=wrong"), StartsWith("HTTP/1.1 403 "));
    const auto refused = post("/login", "user=boss&password=secret1");
    EXPECT_THAT(refused, StartsWith("HTTP/1.1 403 "));
    EXPECT_THAT(refused, HasSubstr("try again in 1 s"));
    EXPECT_THAT(post("/login", "user=left&password=secret3"), StartsWith("HTTP/1.1 403 "))
        << "an Entity Manager";
    EXPECT_THAT(post("/login", "user=watcher&password=secret2"), StartsWith("HTTP/1.1 200 "))
        << "others do not wait";
}

TEST(ConsoleStart, WhereItsPortIsTakenTheServerStartsUnlessItWasAskedFor) {
    auto settings = onLoopback();
    onAnyPorts(settings.console);
    const server::Server first(settings);
    const auto address = first.consoleAddress();
    settings.console.endpoint = address.substr(7, address.size() - 8);
    EXPECT_THROW(server::Server{settings}, std::runtime_error);
    settings.console.required = false;
    const server::Server second(settings);
    EXPECT_THAT(second.readyLine(), Not(HasSubstr("console=")));
    EXPECT_EQ(second.consoleSessionPort(), 0);
}

TEST(ConsoleStart, WhereAPortOfItsSessionsIsTakenTheServerStartsAndClosesTheOthers) {
    const Descriptor taken(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    sockaddr_in address{};
    address.sin_family = AF_INET;
    ::inet_pton(AF_INET, loopbackAddress().c_str(), &address.sin_addr);
    socklen_t size = sizeof address;
    ASSERT_EQ(::bind(taken.get(), reinterpret_cast<const sockaddr*>(&address), size), 0);
    ASSERT_EQ(::listen(taken.get(), 1), 0);
    ::getsockname(taken.get(), reinterpret_cast<sockaddr*>(&address), &size);
    const auto its = loopbackAddress() + ":" + std::to_string(ntohs(address.sin_port));
    // Two more that are free, to see that they are free again. The other ports of the servers are at another
    // address, so that none of them is one of these.
    auto settings = onLoopback();
    settings.client_endpoint = settings.client_signal_endpoint = settings.entity_endpoint =
        settings.entity_signal_endpoint = "127.0.0.1:0";
    onAnyPorts(settings.console);
    const auto [pages, sessions] = [&] {
        const server::Server other(settings);
        return std::pair(other.consoleAddress().substr(7, other.consoleAddress().size() - 8),
                         loopbackAddress() + ":" + std::to_string(other.consoleSessionPort()));
    }();
    settings.console.endpoint = pages;
    settings.console.session_endpoint = sessions;
    settings.console.signal_endpoint = its;
    EXPECT_THROW(server::Server{settings}, std::runtime_error) << "somebody has asked for it";
    settings.console.required = false;
    const auto log = std::make_shared<LogLines>();
    spdlog::default_logger()->sinks().push_back(log);
    const server::Server without(settings);
    spdlog::default_logger()->sinks().pop_back();
    EXPECT_THAT(log->all(),
                testing::ContainsRegex("the web console is left out: [^\n]*cannot listen on[^\n]*fix: "))
        << "one line";
    EXPECT_THAT(without.readyLine(), Not(HasSubstr("console=")));
    EXPECT_EQ(without.consoleSessionPort(), 0);
    RawClient(without.clientAddress(Lane::Data));
    settings.console.signal_endpoint = loopbackAddress() + ":0";
    settings.console.required = true;
    const server::Server with(settings);
    EXPECT_THAT(with.readyLine(), HasSubstr(pages)) << "the one without has closed its ports";
}

TEST(ConsoleStart, RefusesPagesAndSessionsAtTwoHosts) {
    for (auto lane : {Lane::Data, Lane::Signal}) {
        auto settings = onLoopback();
        onAnyPorts(settings.console);
        (lane == Lane::Data ? settings.console.session_endpoint : settings.console.signal_endpoint) =
            "127.77.0.1:10418";
        try {
            const server::Server server(settings);
            FAIL() << "expected a misconfiguration";
        } catch (const std::runtime_error& error) {
            EXPECT_THAT(error.what(), HasSubstr("expected one host"));
            EXPECT_THAT(error.what(), HasSubstr("fix: give both the same host"));
            EXPECT_THAT(error.what(), HasSubstr(loopbackAddress() + ":10418"));
        }
    }
}

TEST(ConsoleStart, RefusesToMixTlsAndNone) {
    auto settings = onLoopback();
    for (auto* its : {&settings.console.session_endpoint, &settings.console.signal_endpoint}) {
        onAnyPorts(settings.console);
        *its = "ssl://" + *its;
        EXPECT_THROW(server::Server{settings}, std::runtime_error);
    }
}

TEST(ConsoleStart, RefusesAProxyWithoutUsers) {
    auto settings = onLoopback();
    onAnyPorts(settings.console);
    settings.console.proxies = {"https://lab.example"};
    try {
        const server::Server server(settings);
        FAIL() << "expected a misconfiguration";
    } catch (const std::runtime_error& error) {
        EXPECT_THAT(error.what(), HasSubstr("no users"));
    }
}

TEST(ConsoleStart, RefusesANameThatIsNone) {
    auto settings = onLoopback();
    onAnyPorts(settings.console);
    settings.console.names = {"http://lab.example"};
    EXPECT_THROW(server::Server{settings}, std::runtime_error);
}

TEST(ConsoleOverTls, ABrowserWithoutACertificateOpensASession) {
    const CertificateFolder folder;
    const auto issued = [&](certificates::Kind kind, const std::string& name) {
        const auto properties = Ice::createProperties();
        properties->load(folder.issue(kind, {name}).string());
        return properties->getPropertiesForPrefix("IceSSL");
    };
    auto settings = onLoopback();
    settings.ice_properties = issued(certificates::Kind::Server, loopbackAddress());
    onAnyPorts(settings.console, "ssl://");
    const server::Server server(settings);
    EXPECT_THAT(server.consoleAddress(), StartsWith("https://"));
    // It knows the CA, and has nothing to show; the files are there because the plug-in is loaded for them.
    auto properties = issued(certificates::Kind::Client, "nobody");
    const RawBrowser client(
        "wss -h " + loopbackAddress() + " -p " + std::to_string(server.consoleSessionPort()) + " -r /axon",
        "", "", properties);
    EXPECT_EQ(client.facts.signalEndpoint, "wss -h " + loopbackAddress() + " -p " +
                                               std::to_string(server.consoleSessionPort(Lane::Signal)) +
                                               " -r /axon-signal");
}

}  // namespace
}  // namespace axon::test
