// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/refusals.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "support/moved_clock.hpp"
#include "support/recorded_audit.hpp"

namespace axon::router_guard {
namespace {

using axon::test::MovedClock;
using axon::test::RecordedAudit;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::SizeIs;

/// The trail of one program, which stays when Refusals ends it.
class Passed final : public audit::AuditTrail {
  public:
    Passed(RecordedAudit& to, bool& ended) : to_(to), ended_(ended) {}
    ~Passed() override { ended_ = true; }
    void note(const audit::Note& note) override { to_.note(note); }

  private:
    RecordedAudit& to_;
    bool& ended_;
};

struct RefusalsTest : testing::Test {
    static std::string trace(const std::string& what, const std::string& local,
                             const std::string& exception) {
        return what + "\nlocal address = " + local + "\nremote address = 10.0.0.7:50122\n" + exception;
    }
    static std::string foreign() {
        return trace(
            "failed to accept ssl connection", "10.0.0.1:10414",
            "src/IceSSL/OpenSSLTransceiverI.cpp:444: ::Ice::SecurityException:\nsecurity exception:\n"
            "IceSSL: certificate verification failed:\nunable to verify the first certificate");
    }
    static std::string badMagic(const std::string& local) {
        return trace("closed tcp connection", local,
                     "src/Ice/ConnectionI.cpp:1676: ::Ice::BadMagicException:\nunknown magic number: 0x47, "
                     "0x45, 0x54, 0x20");
    }

    MovedClock clock;
    RecordedAudit audit;
    bool ended = false;
    std::vector<std::string> said;
    Refusals refusals{std::make_unique<Passed>(audit, ended), clock,
                      [this](const std::string& line) { said.push_back(line); }};
};

TEST_F(RefusalsTest, AHandshakeThatIsRefusedIsRecordedAndSaid) {
    refusals.onTrace(foreign());
    EXPECT_THAT(
        audit.notes(),
        ElementsAre("@10.0.0.7:50122|refusal||||a TLS handshake at 10.0.0.1:10414: the certificate is "
                    "of another CA|PERMISSION_DENIED"));
    EXPECT_THAT(said,
                ElementsAre("audit: a connection from 10.0.0.7:50122 was refused: a TLS handshake at "
                            "10.0.0.1:10414: the certificate is of another CA (::Ice::SecurityException: "
                            "security exception: IceSSL: certificate verification failed: unable to "
                            "verify the first certificate)"));
}

TEST_F(RefusalsTest, AHandshakeThatThePeerEndsIsRecordedAndSaid) {
    refusals.onTrace(
        trace("failed to accept ssl connection", "10.0.0.1:10414",
              "x.cpp:1: ::Ice::ConnectionLostException:\nconnection lost: recv() returned zero"));
    EXPECT_THAT(audit.notes(),
                ElementsAre(HasSubstr("@10.0.0.7:50122|refusal||||a TLS handshake at 10.0.0.1:10414: no "
                                      "certificate was shown")));
    EXPECT_THAT(said, SizeIs(1));
}

TEST_F(RefusalsTest, WhatIsNotIceIsRecordedAtItsOwnPortsOnly) {
    refusals.onTrace("listening for tcp connections\nlocal address = 0.0.0.0:10414");
    refusals.onTrace(badMagic("10.0.0.1:40000"));  // whom it has called, speaks nonsense
    EXPECT_THAT(audit.notes(), SizeIs(0));
    EXPECT_THAT(said, SizeIs(0));
    refusals.onTrace(badMagic("10.0.0.1:10414"));
    EXPECT_THAT(audit.notes(),
                ElementsAre("@10.0.0.7:50122|refusal||||a connection to 10.0.0.1:10414: it does "
                            "not speak Ice's protocol|MALFORMED"));
    EXPECT_THAT(said, SizeIs(1));
}

TEST_F(RefusalsTest, WhatRefusesNobodyIsNeitherRecordedNorSaid) {
    refusals.onTrace("listening for tcp connections\nlocal address = 0.0.0.0:10414");
    refusals.onTrace(trace("accepted tcp connection", "10.0.0.1:10414", ""));
    refusals.onTrace(
        trace("closed tcp connection", "10.0.0.1:10414",
              "x.cpp:1: ::Ice::ConnectionLostException:\nconnection lost: recv() returned zero"));
    refusals.onTrace(trace("failed to accept ssl connection", "10.0.0.1:10414",
                           "x.cpp:1: ::Ice::ObjectAdapterDeactivatedException:\nobject adapter deactivated"));
    refusals.onTrace("");
    EXPECT_THAT(audit.notes(), SizeIs(0));
    EXPECT_THAT(said, SizeIs(0));
}

TEST_F(RefusalsTest, TheLogHasTenLinesInASecondAndTheTrailIsAskedForAll) {
    for (int i = 0; i < 50; ++i) refusals.onTrace(foreign());
    EXPECT_THAT(said, SizeIs(10));
    EXPECT_THAT(audit.notes(), SizeIs(50));
    clock.advance(std::chrono::seconds{1});
    refusals.onTrace(foreign());
    EXPECT_THAT(said, SizeIs(11));
}

TEST_F(RefusalsTest, AfterTheEndOfTheTrailRefusalsAreSaid) {
    refusals.end();
    EXPECT_TRUE(ended);
    refusals.onTrace(foreign());
    EXPECT_THAT(audit.notes(), SizeIs(0));
    EXPECT_THAT(said, ElementsAre(HasSubstr("the certificate is of another CA")));
    refusals.end();
}

}  // namespace
}  // namespace axon::router_guard
