// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/properties.hpp"

#include <Ice/Ice.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <random>
#include <stdexcept>

#include "common/descriptor.hpp"

namespace axon::transport {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class PropertiesTest : public testing::Test {
  protected:
    PropertiesTest() {
        std::string name = std::filesystem::temp_directory_path() / "axon-properties-XXXXXX";
        Descriptor(::mkstemp(name.data())).reset();
        file = name;
    }
    ~PropertiesTest() override { std::filesystem::remove(file); }
    Properties read(const std::string& text) const {
        std::ofstream(file) << text;
        return readProperties(file, {"Axon.Server", "Ice.Default.Router", "Server.Peer."});
    }
    std::string refusal(const std::string& text) const {
        try {
            static_cast<void>(read(text));
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return "accepted";
    }
    std::filesystem::path file;
};

TEST_F(PropertiesTest, TellsTheProgramsOwnFromThoseOfIce) {
    const auto properties = read(
        "Axon.Server=here\nIce.Default.Router=r\nServer.Peer.es1=there\nIce.Trace.Network=1\nIceSSL.CAs=c\n");
    EXPECT_EQ(properties.own.size(), 3U);
    EXPECT_EQ(properties.own.at("Server.Peer.es1").where, file.string() + ":3");
    EXPECT_EQ(properties.ice,
              (std::map<std::string, std::string>{{"Ice.Trace.Network", "1"}, {"IceSSL.CAs", "c"}}));
}

TEST_F(PropertiesTest, TheLastLineCountsAndAnEmptyValueIsNone) {
    EXPECT_EQ(read("Axon.Server=a\nAxon.Server=b\n").own.at("Axon.Server").value, "b");
    EXPECT_TRUE(read("Axon.Server=a\nAxon.Server=\nIce.IPv6=1\nIce.IPv6=\n").own.empty());
    EXPECT_TRUE(read("Ice.IPv6=1\nIce.IPv6=\n").ice.empty());
}

TEST_F(PropertiesTest, AKeyThatNobodyKnowsIsRefusedWithItsLineAndThoseThereAre) {
    for (const auto* key : {"Axon.Srever", "Server.Peer.", "Icy.IPv6"})
        EXPECT_THAT(refusal("\n" + std::string(key) + "=1"),
                    AllOf(HasSubstr(file.string() + ":2: unknown property '" + key + "'"),
                          HasSubstr("Axon.Server, Ice.Default.Router, Server.Peer.*, or a property of Ice"),
                          HasSubstr("fix: ")));
}

TEST_F(PropertiesTest, ReadsWhatIceReadsInTheSameFile) {
    constexpr unsigned kSeed = 20261124;
    std::mt19937 dice(kSeed);
    const auto some = [&](std::string_view letters, unsigned most) {
        std::string text;
        for (auto n = dice() % (most + 1); n > 0; --n) text += letters[dice() % letters.size()];
        return text;
    };
    for (int round = 0; round < 2000; ++round) {
        // No backslash ends a line: Ice then adds the escaped blanks before it twice.
        const auto text = some(" \t", 2) + "Ice.k" + some("ab.", 2) + some(" \t", 2) + "=" +
                          some("ab\\\\#= \t", 12) + "x" + some(" \t", 2) + "\r\n";
        const auto ours = read(text).ice;
        const auto its = Ice::createProperties();
        its->load(file.string());
        EXPECT_EQ(ours, its->getPropertiesForPrefix("Ice.k")) << kSeed << ", round " << round << ": " << text;
    }
}

}  // namespace
}  // namespace axon::transport
