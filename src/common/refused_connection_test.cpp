// SPDX-License-Identifier: MIT
#include "common/refused_connection.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace axon {
namespace {

// The traces are what glacier2router of Ice 3.7.8 wrote.
const std::string kAddresses = "\nlocal address = 127.0.0.1:10414\nremote address = 127.0.0.1:42284";

std::string notAccepted(const std::string& exception, const std::string& type = "ssl") {
    return "failed to accept " + type + " connection" + kAddresses + "\n" + exception;
}

std::string closed(const std::string& exception, const std::string& type = "tcp") {
    return "closed " + type + " connection" + kAddresses + "\n" + exception;
}

std::string verification(const std::string& why) {
    return "src/IceSSL/OpenSSLTransceiverI.cpp:444: ::Ice::SecurityException:\nsecurity exception:\n"
           "IceSSL: certificate verification failed:\n" +
           why;
}

const std::string kNothingSaid =
    "src/IceSSL/OpenSSLTransceiverI.cpp:413: ::Ice::ProtocolException:\nprotocol exception:\n"
    "SSL error occurred for new incoming connection:" +
    kAddresses + "\n";
const std::string kTooLate =
    "src/Ice/ConnectionI.cpp:2194: ::Ice::ConnectTimeoutException:\ntimeout while establishing a connection";
const std::string kBadMagic =
    "src/Ice/ConnectionI.cpp:1676: ::Ice::BadMagicException:\nunknown magic number: 0x47, 0x45, 0x54, 0x20";
const std::string kBadUpgrade =
    "src/Ice/WSTransceiver.cpp:370: ::Ice::ProtocolException:\nprotocol exception:\nmalformed request";

std::string whyOf(const std::string& trace) {
    const auto its = refusedConnection(trace);
    return its ? its->why : "not refused";
}

TEST(RefusedConnection, ACertificateOfAnotherCaIsRefusedInTheHandshake) {
    const auto its = refusedConnection(notAccepted(verification("unable to verify the first certificate")));
    ASSERT_TRUE(its);
    EXPECT_EQ(its->at, RefusedAt::TlsHandshake);
    EXPECT_EQ(its->peer, "127.0.0.1:42284");
    EXPECT_EQ(its->local, "127.0.0.1:10414");
    EXPECT_EQ(its->why, "the certificate is of another CA");
    EXPECT_EQ(its->said,
              "::Ice::SecurityException: security exception: IceSSL: certificate verification failed: unable "
              "to verify the first certificate");
    EXPECT_EQ(its->code, RefusalCode::PermissionDenied);
    EXPECT_EQ(whyOf(notAccepted(verification("unable to verify the first certificate"), "wss")),
              "the certificate is of another CA");
}

TEST(RefusedConnection, TheReasonIsThatOfTheCertificate) {
    EXPECT_EQ(whyOf(notAccepted(verification("certificate has expired"))),
              "the certificate has expired (axon certs issue … --force makes a new one)");
    EXPECT_EQ(whyOf(notAccepted(verification("certificate is not yet valid"))),
              "the certificate is not yet valid (compare the clocks of the two machines)");
    EXPECT_EQ(
        whyOf(notAccepted("src/IceSSL/SSLEngine.cpp:259: ::Ice::SecurityException:\nsecurity exception:\n"
                          "incoming connection rejected by trust manager")),
        "the certificate is of another kind than this port takes");
}

const std::string kWithoutReason =
    "no certificate was shown (axon certs issue makes one), or the peer does not speak TLS 1.3, or it ended "
    "the handshake, as one does that does not accept this program's certificate";

/// A TLS handshake of kAddresses' peer that ended without a reason.
std::optional<RefusedConnection> endedWithoutReason(const std::string& trace) {
    const auto its = refusedConnection(trace);
    EXPECT_TRUE(its);
    if (!its) return its;
    EXPECT_EQ(its->at, RefusedAt::TlsHandshake);
    EXPECT_EQ(its->peer, "127.0.0.1:42284");
    EXPECT_EQ(its->why, kWithoutReason);
    return its;
}

TEST(RefusedConnection, WhereIceLosesTheReasonAllAreNamed) {
    const auto its = endedWithoutReason(notAccepted(kNothingSaid));
    ASSERT_TRUE(its);
    EXPECT_EQ(its->said,
              "::Ice::ProtocolException: protocol exception: SSL error occurred for new incoming connection");
    EXPECT_EQ(whyOf(notAccepted(kNothingSaid, "wss")), "the peer does not speak TLS 1.3");
}

TEST(RefusedConnection, AHandshakeThatTakesTooLongIsRefused) {
    const auto its = refusedConnection(notAccepted(kTooLate));
    ASSERT_TRUE(its);
    EXPECT_EQ(its->at, RefusedAt::TlsHandshake);
    EXPECT_EQ(its->code, RefusalCode::Expired);
    EXPECT_EQ(its->why, "it did not finish the TLS handshake in time");
    const auto web = refusedConnection(notAccepted(kTooLate, "wss"));
    ASSERT_TRUE(web);
    EXPECT_EQ(web->at, RefusedAt::WebSocket);
    EXPECT_EQ(web->code, RefusalCode::Expired);
}

TEST(RefusedConnection, WhatIsNoWebSocketIsNoMatterOfTls) {
    const auto its = refusedConnection(notAccepted(kBadUpgrade, "wss"));
    ASSERT_TRUE(its);
    EXPECT_EQ(its->at, RefusedAt::WebSocket);
    EXPECT_EQ(its->code, RefusalCode::Malformed);
    EXPECT_EQ(its->why, "it does not open a WebSocket");
}

TEST(RefusedConnection, WhatIsNotIceIsRefusedAfterTheConnectionWasAccepted) {
    for (const auto* type : {"tcp", "ssl", "ws", "wss"}) {
        const auto its = refusedConnection(closed(kBadMagic, type));
        ASSERT_TRUE(its) << type;
        EXPECT_EQ(its->at, RefusedAt::Protocol);
        EXPECT_EQ(its->peer, "127.0.0.1:42284");
        EXPECT_EQ(its->why, "it does not speak Ice's protocol");
        EXPECT_EQ(its->said, "::Ice::BadMagicException: unknown magic number: 0x47, 0x45, 0x54, 0x20");
        EXPECT_EQ(its->code, RefusalCode::Malformed);
    }
    EXPECT_EQ(whyOf(closed("include/Ice/Protocol.h:200: ::Ice::UnsupportedProtocolException:\n"
                           "protocol error: unsupported protocol version: 9.0\n"
                           "(can only support protocols compatible with version 1.0)")),
              "it speaks another version of Ice's protocol");
    EXPECT_EQ(
        whyOf(closed("src/Ice/ConnectionI.cpp:1698: ::Ice::MemoryLimitException:\n"
                     "protocol error: memory limit exceeded:\n"
                     "requested 268435456 bytes, maximum allowed is 4096 bytes (see Ice.MessageSizeMax)")),
        "it announced a message that is larger than this port takes");
}

const std::string kZero = "x.cpp:405: ::Ice::ConnectionLostException:\nconnection lost: recv() returned zero";

TEST(RefusedConnection, ATlsHandshakeThatThePeerEndsIsRefused) {
    const auto its = endedWithoutReason(notAccepted(kZero));
    ASSERT_TRUE(its);
    EXPECT_EQ(its->said, "::Ice::ConnectionLostException: connection lost: recv() returned zero");
    EXPECT_EQ(its->code, RefusalCode::PermissionDenied);
}

TEST(RefusedConnection, AConnectionThatItsPeerHasEndedIsNotRefused) {
    const std::string reset =
        "src/Ice/StreamSocket.cpp:265: ::Ice::ConnectionLostException:\nconnection lost: Connection reset by "
        "peer";
    for (const auto* type : {"tcp", "ssl", "ws", "wss"}) {
        EXPECT_EQ(whyOf(closed(kZero, type)), "not refused") << type;
        EXPECT_EQ(whyOf(closed(reset, type)), "not refused") << type;
    }
    for (const auto* type : {"tcp", "ws", "wss"})
        EXPECT_EQ(whyOf(notAccepted(kZero, type)), "not refused") << type;
    EXPECT_EQ(whyOf("closed tcp connection" + kAddresses), "not refused");
}

TEST(RefusedConnection, WhatThisProgramEndsForAReasonOfItsOwnIsNotRefused) {
    for (const auto* exception :
         {"::Ice::CommunicatorDestroyedException", "::Ice::ObjectAdapterDeactivatedException",
          "::Ice::SocketException", "::Ice::ForcedCloseConnectionException", "::Ice::UnknownException"})
        for (const auto* type : {"tcp", "ssl", "ws", "wss"}) {
            const auto said = std::string("src/Ice/ConnectionI.cpp:1: ") + exception + ":\nit stops";
            EXPECT_EQ(whyOf(notAccepted(said, type)), "not refused") << type << ' ' << exception;
            EXPECT_EQ(whyOf(closed(said, type)), "not refused") << type << ' ' << exception;
        }
}

TEST(RefusedConnection, AnAlertIsThePeerThatRefusesTheCertificateHere) {
    const auto alert = [](const std::string& its) {
        return kNothingSaid + "error:0A000418:SSL routines:ssl3_read_bytes:" + its +
               ":ssl/record/rec_layer_s3.c:1584:SSL alert number 48";
    };
    for (const auto* type : {"ssl", "wss"})
        for (const auto* its : {"tlsv1 alert unknown ca", "sslv3 alert bad certificate",
                                "sslv3 alert certificate expired", "sslv3 alert certificate unknown"})
            EXPECT_EQ(whyOf(notAccepted(alert(its), type)),
                      "the peer does not accept this program's certificate (compare IceSSL.CAs of the peer, "
                      "and the name or address that it called)")
                << its;
    EXPECT_EQ(whyOf(notAccepted(alert("tlsv1 alert protocol version"))), kWithoutReason)
        << "that is no matter of a certificate";
}

TEST(RefusedConnection, OtherMessagesAreNoRefusals) {
    for (const std::string& trace : std::vector<std::string>{
             "trying to accept ssl connection" + kAddresses, "accepted tcp connection" + kAddresses,
             "failed to establish ssl connection" + kAddresses + "\n" + kTooLate,
             "wss connection HTTP upgrade request failed" + kAddresses + "\n" + kBadUpgrade,
             closed("x.cpp:1: ::Ice::ObjectNotExistException:\nobject does not exist"),
             "listening for ssl connections\nlocal address = 127.0.0.1:10414", "failed to accept connection",
             "closed connection", "failed to accept ", ""})
        EXPECT_FALSE(refusedConnection(trace)) << trace;
}

TEST(RefusedConnection, AMessageThatIsCutOffIsReadAsFarAsItGoes) {
    const auto whole = notAccepted(verification("certificate has expired"));
    for (std::size_t bytes = 0; bytes < whole.size(); ++bytes) {
        const auto its = refusedConnection(whole.substr(0, bytes));
        if (its) {
            EXPECT_EQ(its->peer, "127.0.0.1:42284");
        }
    }
    const auto unknown = refusedConnection("failed to accept ssl connection\n<not connected>\n" + kTooLate);
    ASSERT_TRUE(unknown);
    EXPECT_EQ(unknown->peer, "an unknown address");
    EXPECT_EQ(unknown->local, "an unknown address");
}

TEST(RefusedConnection, IceSaysWhereItListens) {
    EXPECT_EQ(listeningAt("listening for ssl connections\nlocal address = 127.0.0.1:10414"),
              "127.0.0.1:10414");
    EXPECT_EQ(listeningAt("listening for tcp connections\nlocal address = [::1]:10414"), "[::1]:10414");
    EXPECT_FALSE(listeningAt("listening for ssl connections"));
    EXPECT_FALSE(listeningAt("accepted ssl connection" + kAddresses));
    EXPECT_EQ(portIn("127.0.0.1:10414"), "10414");
    EXPECT_EQ(portIn("nothing"), "");
}

}  // namespace
}  // namespace axon
