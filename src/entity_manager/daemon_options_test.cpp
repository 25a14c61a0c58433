// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/daemon_options.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <stdexcept>

namespace axon::entity_manager {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

struct DaemonOptionsTest : testing::Test {
    DaemonOptionsTest() {
        std::string name = (fs::temp_directory_path() / "axon-options-XXXXXX").string();
        folder = ::mkdtemp(name.data());
    }
    ~DaemonOptionsTest() override { fs::remove_all(folder); }
    /// With these lines in the configuration file.
    DaemonOptions read(const std::string& lines) const {
        const auto file = (folder / "entitymanager.cfg").string();
        std::ofstream(file) << "Axon.State=" << folder.string() << "\n" << lines << "\n";
        const char* const words[] = {"axon-entity-manager", "--application", "hello", "--config",
                                     file.c_str()};
        return readDaemonOptions(5, words);
    }
    std::string refusal(const std::string& lines) const {
        try {
            (void)read(lines);
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return {};
    }
    fs::path folder;
};

TEST_F(DaemonOptionsTest, DirectPathsAreOfferedUnlessSwitchedOff) {
    EXPECT_TRUE(read("").direct.offered);
    EXPECT_TRUE(read("Axon.Direct=on").direct.offered);
    EXPECT_FALSE(read("Axon.Direct=off").direct.offered);
    const auto at = read("Axon.Direct=192.168.0.7").direct;
    EXPECT_EQ(at.address, "192.168.0.7");
    EXPECT_EQ(at.ports.first, 0);
    const auto range = read("Axon.Direct=10430-10439").direct;
    EXPECT_EQ(range.address, "");
    EXPECT_EQ(range.ports.first, 10430);
    EXPECT_EQ(range.ports.last, 10439);
    const auto both = read("Axon.Direct=192.168.0.7:10430-10431").direct;
    EXPECT_EQ(both.address, "192.168.0.7");
    EXPECT_EQ(both.ports.first, 10430);
    EXPECT_EQ(both.ports.last, 10431);
}

TEST_F(DaemonOptionsTest, TheReaderOfDirectPathsSpinsForAtMostAQuarterOfAMillisecond) {
    using namespace std::chrono_literals;
    EXPECT_EQ(read("Axon.Direct.Spin=0").direct.spin, 0us);
    EXPECT_EQ(read("Axon.Direct.Spin=250\nAxon.Direct=192.168.0.7").direct.spin, 250us);
    for (const auto* wrong : {"251", "-1", "on"})
        EXPECT_THAT(refusal(std::string("Axon.Direct.Spin=") + wrong),
                    HasSubstr("Axon.Direct.Spin: expected a whole number from 0 to 250"))
            << wrong;
}

TEST_F(DaemonOptionsTest, WhatNamesNoTwoPortsIsRefusedWithWhatIsExpected) {
    for (const auto* wrong :
         {"yes", "10430", "10430-10430", "10439-10430", "80-90", "10430-70000", "lab:10430-10439",
          "192.168.0.7:10430", ":10430-10439", "192.168.0.7:", "10430-", "-10439", "192.168.0.300", "1-2-3"})
        EXPECT_THAT(refusal(std::string("Axon.Direct=") + wrong),
                    HasSubstr("Axon.Direct: expected on, off, an address"))
            << wrong;
}

TEST_F(DaemonOptionsTest, DatagramsTakeAnAddressAPortOrBoth) {
    EXPECT_TRUE(read("").datagrams.offered);
    EXPECT_FALSE(read("Axon.Datagrams=off").datagrams.offered);
    EXPECT_EQ(read("Axon.Datagrams=10420").datagrams.port, 10420);
    const auto both = read("Axon.Datagrams=192.168.0.7:10420").datagrams;
    EXPECT_EQ(both.address, "192.168.0.7");
    EXPECT_EQ(both.port, 10420);
    for (const auto* wrong : {"yes", "70000", "192.168.0.7:", "lab:10420"})
        EXPECT_THAT(refusal(std::string("Axon.Datagrams=") + wrong),
                    HasSubstr("Axon.Datagrams: expected on, off, an address"))
            << wrong;
}

TEST_F(DaemonOptionsTest, TheAuditIsOffUntilAFolderIsNamedWhichMayBeInTheStateFolder) {
    EXPECT_TRUE(read("").audit.folder.empty());
    const auto its = read("Axon.State=/var/lib/axon/cart\nAxon.Audit.Folder=audit\nAxon.Audit.Files=2");
    EXPECT_EQ(its.audit.folder, "/var/lib/axon/cart/audit");
    EXPECT_EQ(its.audit.files.files, 2);
    EXPECT_EQ(read("Axon.Audit.Folder=/var/log/axon").audit.folder, "/var/log/axon");
    EXPECT_THAT(refusal("Axon.Audit.Size=1"),
                HasSubstr("Axon.Audit.Size: expected a whole number from 4096"));
}

TEST_F(DaemonOptionsTest, TheBoundOfAnUploadIsAProperty) {
    EXPECT_EQ(read("").core.resource_bytes_max, 1ULL << 30U);
    EXPECT_EQ(read("Axon.ResourceBytesMax=8589934592").core.resource_bytes_max, 8ULL << 30U);
    for (const auto* wrong : {"0", "-1", "1 GiB", "2199023255552"})
        EXPECT_THAT(
            refusal(std::string("Axon.ResourceBytesMax=") + wrong),
            HasSubstr("Axon.ResourceBytesMax: expected a whole number from 1 to 1099511627776, not '"))
            << wrong;
}

TEST_F(DaemonOptionsTest, WhatTheFileSaysWrongIsRefusedWithItsLine) {
    const auto line_3 = "entitymanager.cfg:3: ";
    EXPECT_THAT(refusal("\nAxon.LockMemory=2"), HasSubstr(std::string(line_3) + "Axon.LockMemory: expected"));
    EXPECT_THAT(refusal("\nAxon.LeaseGrace=-1"),
                HasSubstr(std::string(line_3) + "Axon.LeaseGrace: expected"));
    EXPECT_THAT(refusal("\nAxon.Direct=1"), HasSubstr(std::string(line_3) + "Axon.Direct: expected"));
    EXPECT_THAT(refusal("\nAxon.Direct on"),
                HasSubstr(std::string(line_3) + "'Axon.Direct': expected a line"));
    EXPECT_THAT(refusal("\nAxon.Drect=on"), HasSubstr(std::string(line_3) + "unknown property"));
}

TEST_F(DaemonOptionsTest, TheLogTakesBothSpellingsOfWarning) {
    EXPECT_EQ(read("Axon.LogLevel=warning").log_level, "warning");
    EXPECT_EQ(read("Axon.LogLevel=warn").log_level, "warn");
    EXPECT_THAT(refusal("Axon.LogLevel=loud"), HasSubstr("expected trace, debug, info, warning, error"));
}

TEST_F(DaemonOptionsTest, AnUnknownPropertyIsRefusedWithThoseThereAre) {
    EXPECT_THAT(refusal("Axon.Drect=on"),
                testing::AllOf(HasSubstr("unknown property 'Axon.Drect'"), HasSubstr("Axon.Direct")));
}

}  // namespace
}  // namespace axon::entity_manager
