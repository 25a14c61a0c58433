// SPDX-License-Identifier: MIT
#include "host/link_users.hpp"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/descriptor.hpp"

namespace axon {
namespace {

using testing::HasSubstr;

constexpr uid_t kNobody = 65534;

struct Listener {
    Listener() : socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
        address.sin_family = AF_INET;
        address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        socklen_t size = sizeof address;
        EXPECT_EQ(::bind(socket.get(), reinterpret_cast<sockaddr*>(&address), size), 0);
        EXPECT_EQ(::listen(socket.get(), 4), 0);
        EXPECT_EQ(::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&address), &size), 0);
    }
    Descriptor connect() const {
        Descriptor out(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
        EXPECT_EQ(::connect(out.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
        return out;
    }
    Descriptor accept() const { return Descriptor(::accept(socket.get(), nullptr, nullptr)); }
    Descriptor socket;
    sockaddr_in address{};
};

TEST(LinkUsers, AreThisUserRootAndTheNamed) {
    const LinkUsers mine;
    EXPECT_TRUE(mine.admits(::geteuid()));
    EXPECT_TRUE(mine.admits(0));
    EXPECT_FALSE(mine.admits(kNobody));
    for (const char* text : {"nobody", "65534", " daemon,nobody ", "1 2 nobody"}) {
        const auto parsed = LinkUsers::parse(text, "ports.cfg:3");
        ASSERT_TRUE(parsed.ok()) << text;
        EXPECT_TRUE(parsed->admits(kNobody)) << text;
        EXPECT_TRUE(parsed->admits(0)) << text;
    }
}

TEST(LinkUsers, ANameThatNobodyHasIsRefusedWithItsPlace) {
    for (const char* text : {"no-such-user", "nobody no-such-user", "-1", "99999999999"}) {
        const auto refused = LinkUsers::parse(text, "ports.cfg:3");
        ASSERT_FALSE(refused.ok()) << text;
        EXPECT_EQ(refused.refusal().code, RefusalCode::Malformed);
        EXPECT_THAT(refused.refusal().message, HasSubstr("ports.cfg:3: '"));
    }
}

TEST(LinkUsers, BothEndsOfAConnectionOfOneUserAreAdmitted) {
    const Listener listener;
    const auto client = listener.connect();
    const auto accepted = listener.accept();
    EXPECT_FALSE(LinkUsers().check(accepted.get()));
    EXPECT_FALSE(LinkUsers().check(client.get()));
}

TEST(LinkUsers, WhomTheKernelDoesNotNameIsRefused) {
    const Listener listener;
    auto client = listener.connect();
    const auto accepted = listener.accept();
    client = Descriptor();
    const auto refused = LinkUsers().check(accepted.get());
    ASSERT_TRUE(refused);
    EXPECT_THAT(refused->message, HasSubstr("the kernel does not say"));
    EXPECT_TRUE(LinkUsers().check(-1));
}

TEST(LinkUsers, AnotherUserIsRefusedAndToldWhatToWrite) {
    if (::geteuid() != 0) GTEST_SKIP() << "only root can be somebody else";
    const Listener listener;
    int ends[2];
    ASSERT_EQ(::pipe(ends), 0);
    Descriptor until(ends[0]), writing(ends[1]);
    const auto child = ::fork();
    if (child == 0) {
        writing.reset();
        if (::setuid(kNobody) != 0) ::_exit(1);
        const auto client = listener.connect();
        char ignored = 0;
        while (::read(until.get(), &ignored, 1) > 0) {
        }
        ::_exit(0);
    }
    until.reset();
    const auto accepted = listener.accept();
    const auto refused = LinkUsers().check(accepted.get());
    ASSERT_TRUE(refused);
    EXPECT_EQ(refused->code, RefusalCode::PermissionDenied);
    EXPECT_THAT(refused->message, HasSubstr("the number 65534"));
    EXPECT_THAT(refused->message, HasSubstr("Axon.Users = 65534"));
    EXPECT_FALSE(LinkUsers::parse("nobody", "f")->check(accepted.get()));
    writing.reset();
    int status = 0;
    ::waitpid(child, &status, 0);
    EXPECT_EQ(status, 0);
}

}  // namespace
}  // namespace axon
