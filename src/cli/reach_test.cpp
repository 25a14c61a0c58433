// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/reach.hpp"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cstring>
#include <vector>

#include "common/descriptor.hpp"

using namespace axon;
using namespace axon::cli;
using std::chrono::milliseconds;

namespace {

/// A socket of loopback that is bound, and listens if `backlog` is not negative.
struct Bound {
    Descriptor fd{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
    sockaddr_in address{};
    explicit Bound(int backlog) {
        address.sin_family = AF_INET;
        address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        socklen_t size = sizeof address;
        EXPECT_EQ(::bind(fd.get(), reinterpret_cast<sockaddr*>(&address), size), 0);
        EXPECT_EQ(::getsockname(fd.get(), reinterpret_cast<sockaddr*>(&address), &size), 0);
        if (backlog >= 0) {
            EXPECT_EQ(::listen(fd.get(), backlog), 0);
        }
    }
    std::uint16_t port() const { return ntohs(address.sin_port); }
};

}  // namespace

TEST(Reach, TellsAnOpenPortFromOneWhereNobodyListens) {
    const Bound listening(4);
    const Bound quiet(-1);
    EXPECT_EQ(reach("127.0.0.1", listening.port(), milliseconds(5000)), Reach::Open);
    EXPECT_EQ(reach("127.0.0.1", quiet.port(), milliseconds(5000)), Reach::Refused);
}

TEST(Reach, APortThatDropsWhatComesIsSilent) {
    const Bound full(0);
    // As behind a firewall: the queue of the listener is full, and the kernel drops what comes.
    std::vector<Descriptor> waiting;
    for (int i = 0; i < 4; ++i) {
        waiting.emplace_back(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
        ::connect(waiting.back().get(), reinterpret_cast<const sockaddr*>(&full.address),
                  sizeof full.address);
    }
    EXPECT_EQ(reach("127.0.0.1", full.port(), milliseconds(100)), Reach::Silent);
}

TEST(Reach, ANameThatNobodyHasIsNotOneThatNobodyCanLookUp) {
    EXPECT_EQ(meaningOf(EAI_NONAME), Reach::UnknownHost);
    EXPECT_EQ(meaningOf(EAI_AGAIN), Reach::NoResolver) << "the name service is down";
    for (const auto why : {Reach::UnknownHost, Reach::NoResolver}) {
        Network network;
        network.addresses = [why](const std::string&, std::uint16_t) { return Addresses{{}, why}; };
        EXPECT_EQ(reach("lab.example.org", 10410, milliseconds(100), network), why);
    }
}

TEST(Reach, AnAddressThatIsSilentTakesNoTimeFromTheNext) {
    const Bound listening(4);
    Network network;
    network.addresses = [&](const std::string&, std::uint16_t) {
        Addresses two;
        for (int i = 0; i < 2; ++i) {
            auto& address = two.list.emplace_back();
            std::memcpy(&address.storage, &listening.address, sizeof listening.address);
            address.size = sizeof listening.address;
        }
        return two;
    };
    std::vector<milliseconds> given;
    network.answers = [&](int fd, milliseconds patience) {
        given.push_back(patience);
        return given.size() > 1 && answersWithin(fd, milliseconds(5000));
    };
    EXPECT_EQ(reach("lab.example.org", 10410, milliseconds(2000), network), Reach::Open);
    EXPECT_THAT(given, testing::ElementsAre(milliseconds(2000), milliseconds(2000)));
}

TEST(Reach, ReadsTheFormsOfAServersAddress) {
    EXPECT_EQ(hostPortOf("lab:10410")->host, "lab");
    EXPECT_EQ(hostPortOf("ssl://lab.example.org:443")->host, "lab.example.org");
    EXPECT_EQ(hostPortOf("ssl://lab.example.org:443")->port, 443);
    EXPECT_EQ(hostPortOf("[::1]:10410")->host, "::1");
    for (const auto* text :
         {"lab", ":10410", "lab:", "lab:x", "lab:70000", "lab:0", "Axon.Clients/router:tcp -h lab -p 10414"})
        EXPECT_FALSE(hostPortOf(text)) << text;
}

TEST(Reach, SeesThatAPortIsTaken) {
    const Bound listening(4);
    EXPECT_TRUE(isTaken(listening.port()));
    std::uint16_t port = 0;
    {
        const Bound gone(4);
        port = gone.port();
    }
    EXPECT_FALSE(isTaken(port));
}
