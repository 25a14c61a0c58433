// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/sessions/open_sessions.hpp"

#include <gtest/gtest.h>

#include <utility>

#include "transport/ice/known_connections.hpp"

namespace axon::transport {
namespace {

using Peer = ConnectionLimits::Peer;

/// To one of a server's ports.
class Connection final : public PeerConnection {
  public:
    Connection(std::string peer, std::string local) : peer_(std::move(peer)), local_(std::move(local)) {}
    void onClosed(std::function<void(const CloseReason&)>) override {}
    void disconnect(CloseReason, bool) override {}
    void require(const Ice::Current&) override {}
    bool routed() const override { return false; }
    const void* key() const override { return this; }
    const void* connection() const override { return this; }
    std::string peer() const override { return peer_; }
    std::string ends() const override { return bothEnds(peer_, local_); }
    std::string localAddress() const override { return local_; }
    bool tls() const override { return false; }

  private:
    const std::string peer_, local_;
};

struct Session {
    bool ready() const { return used; }
    void disconnect(const std::string& why) { ended = why; }
    bool used = true;
    std::string ended;
};

// One peer may come to two ports of a server from one port of its own; they are two connections.
class FromOnePort : public testing::Test {
  protected:
    ManualClock clock;
    OpenSessions<Session> sessions{clock};
    const Connection first{"10.0.0.7:50122", "10.0.0.1:10411"};
    const Connection second{"10.0.0.7:50122", "10.0.0.1:10413"};
    const std::shared_ptr<Session> session = std::make_shared<Session>(), other = std::make_shared<Session>();
};

TEST_F(FromOnePort, WhoHasASessionMakesNobodyElseKnown) {
    EXPECT_TRUE(sessions.add(first, session).ok());
    EXPECT_EQ(sessions.stateOf(first.ends()), Peer::HasSession);
    EXPECT_EQ(sessions.stateOf(second.ends()), Peer::Stranger);
    EXPECT_FALSE(sessions.add(first, other).ok()) << "one for each connection";
}

TEST_F(FromOnePort, WhoAsksForASessionExemptsNobodyElse) {
    sessions.asks(first.ends());
    EXPECT_EQ(sessions.stateOf(first.ends()), Peer::Exempt);
    EXPECT_EQ(sessions.stateOf(second.ends()), Peer::Stranger);
    sessions.answered(first.ends());
    EXPECT_EQ(sessions.stateOf(first.ends()), Peer::Stranger);
}

TEST_F(FromOnePort, TheEndOfOneSessionLeavesTheOther) {
    EXPECT_TRUE(sessions.add(first, session).ok());
    EXPECT_TRUE(sessions.add(second, other).ok());
    sessions.remove(second.key());
    EXPECT_EQ(sessions.stateOf(second.ends()), Peer::Stranger);
    EXPECT_EQ(sessions.stateOf(first.ends()), Peer::HasSession);
    sessions.endSilent(first.ends());
    EXPECT_EQ(session->ended, "nothing was heard of it for a minute");
    EXPECT_EQ(other->ended, "");
}

TEST_F(FromOnePort, AConnectionWithTheEndsOfOneThatHasEndedKeepsItsSession) {
    const Connection again{"10.0.0.7:50122", "10.0.0.1:10411"};
    EXPECT_TRUE(sessions.add(first, session).ok());
    EXPECT_TRUE(sessions.add(again, other).ok()) << "the end of the first is told a little later";
    sessions.remove(first.key());
    EXPECT_EQ(sessions.stateOf(again.ends()), Peer::HasSession);
}

}  // namespace
}  // namespace axon::transport
