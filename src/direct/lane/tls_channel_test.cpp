// SPDX-License-Identifier: GPL-2.0-or-later
// Both ends of a data lane over TLS, between two memories: certificates of a CA that the test makes, and its
// clock.
#include "direct/lane/tls_channel.hpp"

#include <gmock/gmock.h>
#include <gnutls/gnutls.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <random>
#include <vector>

#include "common/frame.hpp"
#include "direct/lane/frames.hpp"

namespace axon::direct::lane {
namespace {

using namespace std::chrono;
using certificates::Credentials;
using certificates::WallTime;
using testing::HasSubstr;
using State = Channel::State;

constexpr WallTime kNow{sys_days{year{2026} / 11 / 26}};

/// The socket of one side: takes as much as it has room for.
struct Memory final : Wire {
    std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
        if (lost) return std::nullopt;
        std::size_t taken = 0;
        for (const auto piece : pieces) {
            const auto part = std::min(piece.size(), room);
            sent += piece.substr(0, part);
            room -= part;
            taken += part;
            if (part < piece.size()) break;
        }
        return taken;
    }
    std::string sent;
    std::size_t room = 100'000'000;
    bool lost = false;
};

/// One end, and what it has heard.
struct End {
    explicit End(std::unique_ptr<Channel> (*make)(Wire&, const std::shared_ptr<const Tls>&),
                 const std::shared_ptr<const Tls>& tls)
        : channel(make(socket, tls)) {}
    /// Bytes of the other side, at most `piece` at once.
    void hear(std::string bytes, std::size_t piece = 1'000'000) {
        for (std::string_view left(bytes); !left.empty();) {
            const auto room = channel->room(frames);
            const auto count = std::min({piece, room.size(), left.size()});
            left.copy(room.data(), count);
            left.remove_prefix(count);
            state = channel->filled(frames, count);
            std::string frame;
            while (frames.next(frame)) heard.push_back(frame);
        }
    }
    std::string said() { return std::exchange(socket.sent, {}); }
    std::optional<std::size_t> write(std::string_view bytes) { return channel->write({&bytes, 1}); }

    Memory socket;
    std::unique_ptr<Channel> channel;
    FrameReader frames{kMessageFrameMax};
    State state = State::Opening;
    std::vector<std::string> heard;
};

std::unique_ptr<Channel> toRobot(Wire& socket, const std::shared_ptr<const Tls>& tls) {
    return tls->toEntity("robot", socket);
}
std::unique_ptr<Channel> fromCaller(Wire& socket, const std::shared_ptr<const Tls>& tls) {
    return tls->fromCaller(socket);
}

class TlsChannelTest : public testing::Test {
  protected:
    static Credentials credentials(const certificates::Issued& by, certificates::Kind kind,
                                   const std::string& name, WallTime at = kNow) {
        const auto issued = certificates::issue(by, {kind, {name}}, at);
        Credentials its;
        its.authorities = by.certificate;
        its.certificate = issued.certificate;
        its.key = issued.key;
        return its;
    }
    std::shared_ptr<const Tls> tls(const Credentials& its) {
        return Tls::of(its, [this] { return now; });
    }
    /// Until neither has anything to say.
    static void talk(End& client, End& robot, std::size_t piece = 1'000'000) {
        if (client.state == State::Opening && client.socket.sent.empty())
            client.state = client.channel->filled(client.frames, 0);
        while (!client.socket.sent.empty() || !robot.socket.sent.empty()) {
            robot.hear(client.said(), piece);
            client.hear(robot.said(), piece);
        }
    }
    struct Outcome {
        State client, robot;
        std::string client_why, robot_why;
    };
    Outcome outcome(const Credentials& of_client, const Credentials& of_robot) {
        End client(toRobot, tls(of_client)), robot(fromCaller, tls(of_robot));
        talk(client, robot);
        return {client.state, robot.state, client.channel->why(), robot.channel->why()};
    }

    const certificates::Issued ours = certificates::makeAuthority(kNow);
    const certificates::Issued others = certificates::makeAuthority(kNow);
    const Credentials robots = credentials(ours, certificates::Kind::Entity, "robot");
    const Credentials anns = credentials(ours, certificates::Kind::Client, "ann");
    WallTime now = kNow;
};

/// An Entity Manager of somebody else, which uses more of TLS 1.3 than ours: it is GnuTLS alone, between two
/// memories.
class OtherRobot {
  public:
    explicit OtherRobot(const Credentials& its) {
        const auto datum = [](const std::string& text) {
            return gnutls_datum_t{reinterpret_cast<unsigned char*>(const_cast<char*>(text.data())),
                                  static_cast<unsigned int>(text.size())};
        };
        gnutls_certificate_allocate_credentials(&credentials_);
        const auto certificate = datum(its.certificate), key = datum(its.key);
        gnutls_certificate_set_x509_key_mem(credentials_, &certificate, &key, GNUTLS_X509_FMT_PEM);
        gnutls_init(&session_, GNUTLS_SERVER | GNUTLS_NONBLOCK);
        gnutls_priority_set_direct(session_, "NORMAL:-VERS-ALL:+VERS-TLS1.3", nullptr);
        gnutls_credentials_set(session_, GNUTLS_CRD_CERTIFICATE, credentials_);
        gnutls_transport_set_ptr(session_, this);
        gnutls_transport_set_push_function(session_, [](void* self, const void* bytes, std::size_t count) {
            static_cast<OtherRobot*>(self)->out_.append(static_cast<const char*>(bytes), count);
            return static_cast<ssize_t>(count);
        });
        gnutls_transport_set_pull_function(session_, [](void* self, void* into, std::size_t count) {
            return static_cast<OtherRobot*>(self)->pull(into, count);
        });
    }
    ~OtherRobot() {
        gnutls_deinit(session_);
        gnutls_certificate_free_credentials(credentials_);
    }
    OtherRobot(const OtherRobot&) = delete;
    OtherRobot& operator=(const OtherRobot&) = delete;

    /// What it answers. Its tickets come with its last flight, as a part of the handshake.
    std::string shakeHands(const std::string& heard) {
        in_ += heard;
        gnutls_handshake(session_);
        return said();
    }
    void say(const std::string& bytes) { gnutls_record_send(session_, bytes.data(), bytes.size()); }
    void changeKeys() { gnutls_session_key_update(session_, GNUTLS_KU_PEER); }
    std::string said() { return std::exchange(out_, {}); }

  private:
    ssize_t pull(void* into, std::size_t count) {
        if (in_.empty()) {
            gnutls_transport_set_errno(session_, EAGAIN);
            return -1;
        }
        const auto part = std::min(count, in_.size());
        std::copy_n(in_.data(), part, static_cast<char*>(into));
        in_.erase(0, part);
        return static_cast<ssize_t>(part);
    }
    gnutls_certificate_credentials_t credentials_ = nullptr;
    gnutls_session_t session_ = nullptr;
    std::string in_, out_;
};

TEST_F(TlsChannelTest, WhatComesBehindMessagesOfTlsItselfIsNotLost) {
    OtherRobot robot(robots);
    End client(toRobot, tls(anns));
    client.state = client.channel->filled(client.frames, 0);
    while (!client.socket.sent.empty()) {
        auto answer = robot.shakeHands(client.said());
        if (client.state == State::Open) {  // with the tickets
            std::string first;
            appendFrame(first, "behind the tickets");
            robot.say(first);
            answer += robot.said();
        }
        client.hear(answer);
        if (client.state == State::Open && client.socket.sent.empty()) break;
    }
    ASSERT_EQ(client.state, State::Open) << client.channel->why();
    for (const auto* const text : {"behind new keys", "and again"}) {
        std::string frame;
        appendFrame(frame, text);
        robot.changeKeys();
        robot.say(frame);
        client.hear(robot.said());
        ASSERT_EQ(client.state, State::Open) << client.channel->why();
        ASSERT_FALSE(client.heard.empty());
        EXPECT_EQ(client.heard.back(), text);
    }
}

TEST_F(TlsChannelTest, FramesOfBothSidesComeAsTheyWereSentHoweverTheBytesAreCut) {
    const std::vector<std::string> said{"a", std::string(300, 'b'), std::string(100'000, 'c'), "d"};
    for (const std::size_t piece : {1U, 7U, 1000U, 1'000'000U}) {
        End caller(toRobot, tls(anns)), robot(fromCaller, tls(robots));
        talk(caller, robot, piece);
        ASSERT_EQ(caller.state, State::Open) << caller.channel->why();
        ASSERT_EQ(robot.state, State::Open) << robot.channel->why();
        for (const auto& one : said) {
            std::string frame;
            appendFrame(frame, one);
            const std::array<std::string_view, 3> pieces{std::string_view(frame).substr(0, 3), "",
                                                         std::string_view(frame).substr(3)};
            EXPECT_EQ(caller.channel->write(pieces), frame.size());
            EXPECT_EQ(robot.channel->write(pieces), frame.size());
            EXPECT_EQ(robot.socket.sent.find(frame), std::string::npos) << "it goes in clear";
        }
        talk(caller, robot, piece);
        EXPECT_EQ(robot.heard, said);
        EXPECT_EQ(caller.heard, said);
    }
}

TEST_F(TlsChannelTest, AByteCountsAsWrittenWhenTheSocketHasTakenIt) {
    End caller(toRobot, tls(anns)), robot(fromCaller, tls(robots));
    talk(caller, robot);
    caller.socket.room = 0;
    std::string frame;
    appendFrame(frame, std::string(50'000, 'x'));
    EXPECT_EQ(caller.write(frame), 0U);
    caller.socket.room = 20'000;
    EXPECT_EQ(caller.write(frame), 0U) << "the records are not all sent";
    robot.hear(caller.said());
    caller.socket.room = 100'000'000;
    EXPECT_EQ(caller.write(frame), frame.size());
    robot.hear(caller.said());
    ASSERT_EQ(robot.heard.size(), 1U);
    EXPECT_EQ(robot.heard.front(), frame.substr(4)) << "nothing came twice, and nothing is missing";
}

// As LaneOutbox uses it, at a socket that takes any number of bytes at a time.
TEST_F(TlsChannelTest, WhatWaitsInAnOutboxComesOnceAndInOrder) {
    std::mt19937 random(7);
    const auto upTo = [&](std::size_t most) {
        return std::uniform_int_distribution<std::size_t>(0, most)(random);
    };
    End caller(toRobot, tls(anns)), robot(fromCaller, tls(robots));
    talk(caller, robot);
    LaneOutbox outbox(transport::OutboxLimits{}, *caller.channel);
    std::int64_t sent = 0;
    std::vector<std::string> contents;
    caller.socket.room = 0;
    while (sent < 400 || outbox.waiting()) {
        if (sent < 400) {
            Header head;
            head.sequence = ++sent;
            contents.emplace_back(upTo(1) == 0 ? upTo(300) : upTo(90'000),
                                  static_cast<char>('a' + sent % 26));
            ASSERT_EQ(outbox.post(Keeping::Kept, head, std::make_shared<const std::string>(contents.back())),
                      LaneOutbox::Outcome::Taken);
        }
        if (upTo(2) == 0) {
            caller.socket.room += upTo(200'000);
            ASSERT_EQ(outbox.flush(), LaneOutbox::Outcome::Taken);
        }
        robot.hear(caller.said(), 1 + upTo(70'000));
    }
    ASSERT_EQ(robot.heard.size(), contents.size());
    for (std::size_t i = 0; i < contents.size(); ++i) {
        const auto message = messageIn(robot.heard[i]).value();
        EXPECT_EQ(message.sequence, static_cast<std::int64_t>(i) + 1);
        EXPECT_EQ(message.content, contents[i]);
    }
}

TEST_F(TlsChannelTest, AnEntityOfAnotherCaIsRefusedByTheClient) {
    const auto its = outcome(anns, credentials(others, certificates::Kind::Entity, "robot"));
    EXPECT_EQ(its.client, State::Over);
    EXPECT_NE(its.robot, State::Open);
    EXPECT_THAT(its.client_why, HasSubstr("of another CA; fix: axon certs issue --entity"));
}

TEST_F(TlsChannelTest, AClientOfAnotherCaIsRefusedAndBothSidesSayWhy) {
    auto stranger = credentials(others, certificates::Kind::Client, "ann");
    stranger.authorities = ours.certificate;  // who trusts the entity
    const auto its = outcome(stranger, robots);
    EXPECT_EQ(its.robot, State::Over);
    EXPECT_EQ(its.robot_why, "the certificate is of another CA");
    EXPECT_EQ(its.client, State::Over);
    EXPECT_THAT(its.client_why, HasSubstr("the other side ended TLS"));
    EXPECT_THAT(its.client_why, HasSubstr("axon certs show"));
}

TEST_F(TlsChannelTest, WhoeverShowsNoCertificateIsRefusedUnlessNoneIsRequired) {
    Credentials none;
    none.authorities = ours.certificate;
    const auto refused = outcome(none, robots);
    EXPECT_EQ(refused.robot, State::Over);
    EXPECT_THAT(refused.robot_why, HasSubstr("shown"));
    EXPECT_EQ(refused.client, State::Over);
    for (const auto peer : {Credentials::Peer::Asked, Credentials::Peer::NotAsked}) {
        auto patient = robots;
        patient.caller = peer;
        const auto its = outcome(none, patient);
        EXPECT_EQ(its.robot, State::Open) << its.robot_why;
        EXPECT_EQ(its.client, State::Open) << its.client_why;
    }
    // One that is asked for must still be right.
    auto asks = robots;
    asks.caller = Credentials::Peer::Asked;
    auto wrong = credentials(others, certificates::Kind::Client, "ann");
    wrong.authorities = ours.certificate;
    EXPECT_EQ(outcome(wrong, asks).robot, State::Over);
    EXPECT_EQ(outcome(anns, none).client, State::Over) << "an entity always shows one";
}

TEST_F(TlsChannelTest, AnotherEntityOrAnotherKindIsNotTheOneThatIsCalled) {
    const auto left = outcome(anns, credentials(ours, certificates::Kind::Entity, "left"));
    EXPECT_EQ(left.client, State::Over);
    EXPECT_THAT(left.client_why, HasSubstr("the entity 'left'; expected that of the entity 'robot'"));
    EXPECT_THAT(outcome(anns, credentials(ours, certificates::Kind::Client, "robot")).client_why,
                HasSubstr("the client 'robot'"));
}

TEST_F(TlsChannelTest, AnExpiredCertificateIsRefusedByEitherSide) {
    now = kNow + days{364};
    EXPECT_EQ(outcome(anns, robots).robot, State::Open);
    now = kNow + days{366};
    EXPECT_THAT(outcome(anns, robots).client_why, HasSubstr("expired on 2027-11-26"));
    const auto newer = credentials(ours, certificates::Kind::Entity, "robot", now);
    EXPECT_THAT(outcome(anns, newer).robot_why, HasSubstr("expired on 2027-11-26"));
}

TEST_F(TlsChannelTest, TlsOneTwoIsSpokenOnlyWhereBothPermitIt) {
    auto old_client = anns, old_entity = robots;
    old_client.tls_1_2 = old_entity.tls_1_2 = true;
    for (const auto& [its, robots] :
         {std::pair{old_client, old_entity}, std::pair{old_client, robots}, std::pair{anns, old_entity}})
        EXPECT_EQ(outcome(its, robots).client, State::Open) << "1.3 is common to all";
}

TEST_F(TlsChannelTest, AClientThatDoesNotSpeakTlsIsTurnedAway) {
    for (const auto& said :
         {std::string("GET / HTTP/1.1\r\n\r\n"), frameOf(Kind::Claim, std::string(92, 'c')),
          std::string(5000, '\0'), std::string(200, '\xff')}) {
        End robot(fromCaller, tls(robots));
        robot.hear(said);
        EXPECT_EQ(robot.state, State::Over) << said.size();
        EXPECT_THAT(robot.channel->why(), HasSubstr("does not speak TLS"));
        EXPECT_TRUE(robot.heard.empty());
        EXPECT_LT(robot.socket.sent.size(), 100U) << "an alert at most";
        EXPECT_FALSE(robot.write("x")) << "it stays over";
    }
}

TEST_F(TlsChannelTest, AnEntityManagerThatDoesNotSpeakTlsIsLeft) {
    End caller(toRobot, tls(anns));
    caller.state = caller.channel->filled(caller.frames, 0);
    EXPECT_EQ(caller.state, State::Opening);
    caller.hear(frameOf(Kind::Nonce, std::string(20, 'n')));
    EXPECT_EQ(caller.state, State::Over);
    EXPECT_THAT(caller.channel->why(), HasSubstr("does not speak TLS"));
}

/// Whether the byte is the type or the version in the head of an encrypted record: both are fixed there
/// (RFC 8446, section 5.2), and GnuTLS does not look at what came.
bool saysNothing(const std::string& records, std::size_t at) {
    std::size_t head = 0;
    while (head + 5 <= records.size()) {
        const auto length = static_cast<std::uint8_t>(records[head + 3]) * 256U +
                            static_cast<std::uint8_t>(records[head + 4]);
        if (at < head + 5 + length) return at < head + 3;
        head += 5 + length;
    }
    return false;
}

TEST_F(TlsChannelTest, AHandshakeThatIsCutOrChangedAnywhereOpensNothing) {
    End whole_client(toRobot, tls(anns)), whole_robot(fromCaller, tls(robots));
    whole_client.state = whole_client.channel->filled(whole_client.frames, 0);
    const auto hello = whole_client.said();
    std::mt19937 random(3);
    for (std::size_t at = 0; at < hello.size(); at += 3) {
        End robot(fromCaller, tls(robots));
        robot.hear(hello.substr(0, at));
        EXPECT_EQ(robot.state, State::Opening) << "it waits for the rest, for which it has 10 s";
        robot.hear(std::string(400, static_cast<char>(random())));
        EXPECT_NE(robot.state, State::Open);
        EXPECT_TRUE(robot.heard.empty());
    }
    whole_robot.hear(hello);
    whole_client.hear(whole_robot.said());
    const auto answer = whole_client.said();
    ASSERT_EQ(whole_client.state, State::Open);
    ASSERT_EQ(whole_robot.state, State::Opening) << "the client's certificate is awaited";
    for (std::size_t at = 0; at < answer.size(); at += 5) {
        End caller(toRobot, tls(anns)), robot(fromCaller, tls(robots));
        caller.state = caller.channel->filled(caller.frames, 0);
        robot.hear(caller.said());
        caller.hear(robot.said());
        auto changed = caller.said();
        const auto place = std::min(at, changed.size() - 1);
        if (saysNothing(changed, place)) continue;
        changed[place] ^= 1;
        robot.hear(changed);
        EXPECT_NE(robot.state, State::Open) << at;
    }
}

TEST_F(TlsChannelTest, ARecordThatWasChangedOnTheWayEndsTheConnection) {
    End caller(toRobot, tls(anns)), robot(fromCaller, tls(robots));
    talk(caller, robot);
    std::string frame;
    appendFrame(frame, "drive");
    ASSERT_EQ(caller.write(frame), frame.size());
    auto bytes = caller.said();
    bytes[bytes.size() - 3] ^= 4;
    robot.hear(bytes);
    EXPECT_EQ(robot.state, State::Over);
    EXPECT_TRUE(robot.heard.empty());
    EXPECT_FALSE(robot.write(frame));
}

TEST_F(TlsChannelTest, AConnectionThatIsLostIsOverForTheWriter) {
    End caller(toRobot, tls(anns)), robot(fromCaller, tls(robots));
    talk(caller, robot);
    caller.socket.lost = true;
    EXPECT_FALSE(caller.write("x"));
    EXPECT_EQ(caller.channel->why(), "the connection was lost");
    robot.socket.room = 0;
    End another(toRobot, tls(anns)), full(fromCaller, tls(robots));
    full.socket.room = 10;
    another.state = another.channel->filled(another.frames, 0);
    full.hear(another.said());
    EXPECT_EQ(full.state, State::Over) << "a new connection has room for its handshake";
}

TEST_F(TlsChannelTest, NothingIsWrittenBeforeItIsOpen) {
    End caller(toRobot, tls(anns));
    EXPECT_FALSE(caller.write("x"));
    EXPECT_TRUE(caller.socket.sent.empty());
}

TEST_F(TlsChannelTest, CredentialsThatDoNotBelongTogetherAreTold) {
    auto wrong = robots;
    wrong.key = anns.key;
    EXPECT_THROW(tls(wrong), certificates::Unusable);
    wrong = robots;
    wrong.key = "nonsense";
    EXPECT_THROW(tls(wrong), certificates::Unusable);
    wrong = robots;
    wrong.authorities.clear();
    EXPECT_THROW(tls(wrong), certificates::Unusable);
}

}  // namespace
}  // namespace axon::direct::lane
