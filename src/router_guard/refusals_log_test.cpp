// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/refusals_log.hpp"

#include <Ice/LoggerUtil.h>
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <algorithm>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "audit/testing.hpp"
#include "common/descriptor.hpp"
#include "support/loopback.hpp"

namespace axon::router_guard {
namespace {

using audit::TrailFolder;
using axon::test::waitUntil;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::StartsWith;

const std::string kRouterPlugin = "Ice.Plugin.AxonRouterGuard";
const std::string kWithoutTraces =
    " is set, but not Ice.Trace.Network=2, without which Ice tells nobody whom it refuses; fix: add that "
    "line, "
    "which fills no log";

/// The logger that a program has before the plug-in.
class Kept final : public Ice::Logger {
  public:
    void print(const std::string& message) override { keep("print " + message); }
    void trace(const std::string& category, const std::string& message) override {
        keep("trace " + category + " " + message);
    }
    void warning(const std::string& message) override { keep("warning " + message); }
    void error(const std::string& message) override { keep("error " + message); }
    std::string getPrefix() override { return "prefix"; }
    Ice::LoggerPtr cloneWithPrefix(const std::string& prefix) override {
        keep("clone " + prefix);
        return this;
    }
    std::vector<std::string> lines() const {
        const std::lock_guard lock(mutex_);
        return lines_;
    }
    bool has(const std::string& part) const {
        const auto all = lines();
        return std::any_of(all.begin(), all.end(),
                           [&](const auto& line) { return line.find(part) != std::string::npos; });
    }

  private:
    void keep(std::string line) {
        const std::lock_guard lock(mutex_);
        lines_.push_back(std::move(line));
    }
    mutable std::mutex mutex_;
    std::vector<std::string> lines_;
};

/// A program of Ice's with this configuration.
class Program {
  public:
    using Properties = std::map<std::string, std::string>;
    explicit Program(const Properties& properties) {
        Ice::InitializationData data;
        data.properties = Ice::createProperties();
        data.properties->setProperty("Ice.ProgramName", "/usr/bin/glacier2router");
        for (const auto& [key, value] : properties) data.properties->setProperty(key, value);
        data.logger = log;
        communicator = Ice::initialize(data);
    }
    ~Program() { communicator->destroy(); }
    Program(const Program&) = delete;
    Program& operator=(const Program&) = delete;

    /// As the plug-in does it.
    WatchedProgram watched() const {
        auto its = watchRefusals(communicator, kRouterPlugin, false);
        const Ice::PluginPtr installs = new Ice::LoggerPlugin(communicator, its.logger);
        return its;
    }
    /// Why it does not start.
    std::string refused(const std::string& plug_in = kRouterPlugin, bool for_this_only = false) const {
        try {
            watchRefusals(communicator, plug_in, for_this_only);
            return "it starts";
        } catch (const Ice::PluginInitializationException& error) {
            return error.reason;
        }
    }

    const IceUtil::Handle<Kept> log = new Kept;
    Ice::CommunicatorPtr communicator;
};

/// Connects to a port of this process, and says something. Returns the address that it came from.
std::string say(int port, const std::string& text) {
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_port = htons(static_cast<std::uint16_t>(port));
    ::inet_pton(AF_INET, axon::test::loopbackAddress().c_str(), &at.sin_addr);
    const Descriptor socket{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
    socklen_t size = sizeof at;
    if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&at), size) != 0 ||
        ::send(socket.get(), text.data(), text.size(), MSG_NOSIGNAL) < 0)
        return "nobody";
    ::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&at), &size);
    std::string host(INET_ADDRSTRLEN, '\0');
    ::inet_ntop(AF_INET, &at.sin_addr, host.data(), host.size());
    host.resize(host.find('\0'));
    char heard = 0;
    while (::recv(socket.get(), &heard, 1, 0) > 0) {  // until Ice has closed it
    }
    return host + ":" + std::to_string(ntohs(at.sin_port));
}

TEST(RefusalsLog, AStrangerAtARealPortIsRecordedWithItsAddress) {
    const TrailFolder folder;
    std::string peer;
    {
        const Program program(Program::Properties{{"Ice.Trace.Network", "2"},
                                                  {"Axon.Audit.Folder", folder.path.string()},
                                                  {"Axon.Audit.Name", "client-router"}});
        const auto its = program.watched();
        const auto adapter = program.communicator->createObjectAdapterWithEndpoints(
            "Clients", "tcp -h " + axon::test::loopbackAddress() + " -p 0");
        adapter->activate();
        const auto port =
            Ice::TCPEndpointInfoPtr::dynamicCast(adapter->getEndpoints().front()->getInfo())->port;
        peer = say(port, "GET / HTTP/1.1\r\n\r\n");
        EXPECT_TRUE(waitUntil([&] { return program.log->has("it does not speak Ice's protocol"); }));
        EXPECT_FALSE(program.log->has("trace Network")) << "the log is not filled";
        its.refusals->end();
    }
    const auto records = folder.records();
    ASSERT_EQ(records.size(), 2U);
    EXPECT_EQ(records[0].kind, "started");
    EXPECT_THAT(records[0].what, StartsWith("client-router with axon "));
    EXPECT_EQ(records[1].kind, "refusal");
    EXPECT_EQ(records[1].peer, peer);
    EXPECT_THAT(records[1].what, HasSubstr("it does not speak Ice's protocol"));
    EXPECT_EQ(records[1].outcome, "MALFORMED");
    EXPECT_TRUE(folder.chain().faults.empty());
}

TEST(RefusalsLog, PassesOnWhatIsNotForIt) {
    const Program program(Program::Properties{{"Ice.Trace.Network", "2"}});
    const auto log = watchRefusals(program.communicator, kRouterPlugin, false).logger;
    log->print("a");
    log->warning("b");
    log->error("c");
    log->trace("Glacier2", "d");
    log->trace("Network", "e");
    EXPECT_EQ(log->getPrefix(), "prefix");
    log->cloneWithPrefix("f")->trace("Network", "g");
    EXPECT_THAT(program.log->lines(),
                ElementsAre("print a", "warning b", "error c", "trace Glacier2 d", "clone f"));
}

TEST(RefusalsLog, PassesOnTracesOfTheNetworkThatWereAskedFor) {
    const Program program(Program::Properties{{"Ice.Trace.Network", "3"}});
    watchRefusals(program.communicator, kRouterPlugin, false).logger->trace("Network", "e");
    EXPECT_THAT(program.log->lines(), ElementsAre("trace Network e"));
}

TEST(RefusalsLog, WithoutTracesARouterKeepsItsLoggerAndIsWarnedOnce) {
    const Program program(Program::Properties{});
    const auto its = watchRefusals(program.communicator, kRouterPlugin, false);
    EXPECT_FALSE(its.refusals);
    EXPECT_EQ(its.logger.get(), program.log.get());
    EXPECT_THAT(program.log->lines(), ElementsAre("warning " + kRouterPlugin + kWithoutTraces));
}

TEST(RefusalsLog, WithoutTracesAPlugInForNothingElseRefusesToStart) {
    const Program program(Program::Properties{});
    EXPECT_EQ(program.refused("Ice.Plugin.AxonRefusals", true), "Ice.Plugin.AxonRefusals" + kWithoutTraces);
    EXPECT_THAT(program.log->lines(), testing::IsEmpty());
    const Program traced(Program::Properties{{"Ice.Trace.Network", "2"}});
    EXPECT_EQ(traced.refused("Ice.Plugin.AxonRefusals", true), "it starts");
}

TEST(RefusalsLog, ATrailThatCannotBeKeptEndsTheStart) {
    const TrailFolder folder;
    const auto refused = [](const std::map<std::string, std::string>& properties) {
        return Program(properties).refused();
    };
    EXPECT_EQ(refused({{"Axon.Audit.Folder", folder.path.string()}}), "Axon.Audit.Folder" + kWithoutTraces);
    EXPECT_THAT(refused({{"Ice.Trace.Network", "2"}, {"Axon.Audit.Folder", "/dev/null/audit"}}),
                HasSubstr("cannot be kept in '/dev/null/audit'"));
    EXPECT_THAT(refused({{"Ice.Trace.Network", "2"}, {"Axon.Audit.Floder", "x"}}),
                HasSubstr("there is no key Axon.Audit.Floder; expected Axon.Audit.Folder"));
    for (const auto* wrong : {"4095", "x", "-1", "1099511627777", "5000 "})
        EXPECT_THAT(refused({{"Ice.Trace.Network", "2"}, {"Axon.Audit.Size", wrong}}),
                    HasSubstr("expected a number from 4096 to 1099511627776"))
            << wrong;
    EXPECT_THAT(refused({{"Ice.Trace.Network", "2"}, {"Axon.Audit.Files", "0"}}),
                HasSubstr("Axon.Audit.Files=0: expected a number from 1 to 10000"));
}

TEST(RefusalsLog, TwoProgramsOfTheSameNameDoNotShareATrail) {
    const TrailFolder folder;
    const std::map<std::string, std::string> same{{"Ice.Trace.Network", "2"},
                                                  {"Axon.Audit.Folder", folder.path.string()}};
    const Program first(same);
    const auto its = first.watched();
    EXPECT_THAT(Program(same).refused(), HasSubstr("the audit trail 'glacier2router' in '" +
                                                   folder.path.string() + "' is another process's"));
    auto other = same;
    other["Axon.Audit.Name"] = "second";
    EXPECT_EQ(Program(other).refused(), "it starts");
}

}  // namespace
}  // namespace axon::router_guard
