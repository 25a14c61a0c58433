// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/options.hpp"

#include <gmock/gmock.h>

#include <fstream>
#include <stdexcept>
#include <vector>

namespace axon::partner {
namespace {

using testing::HasSubstr;

PartnerOptions read(std::vector<const char*> words) {
    words.insert(words.begin(), "axon-partner");
    return readPartnerOptions(static_cast<int>(words.size()), words.data());
}

std::string refusal(const std::vector<const char*>& words) {
    try {
        read(words);
    } catch (const std::runtime_error& error) {
        return error.what();
    }
    return "accepted";
}

std::string fileWith(const std::string& name, const std::string& text) {
    const auto path = testing::TempDir() + "/" + name;
    std::ofstream(path) << text;
    return path;
}

TEST(PartnerOptionsTest, TwoNamesAndAServerAreEnough) {
    const auto options = read({"--name", "b", "--as", "a", "--server", "lab-b:10410"});
    EXPECT_EQ(options.gateway.core.laboratory, "b");
    EXPECT_EQ(options.gateway.core.home, "a");
    EXPECT_EQ(options.gateway.there.server, "lab-b:10410");
    EXPECT_FALSE(options.gateway.there.direct);
    EXPECT_EQ(options.gateway.home.host, "127.0.0.1");
    EXPECT_EQ(options.gateway.home.port, 10412);
    EXPECT_EQ(options.gateway.core.visitors_max, 200U);
    EXPECT_THAT(options.state_folder.string(), testing::EndsWith("axon/partner-b"));
}

TEST(PartnerOptionsTest, WhatIsMissingIsNamed) {
    EXPECT_THAT(refusal({"--as", "a", "--server", "b:1"}), HasSubstr("--name (Partner.Name) is missing"));
    EXPECT_THAT(refusal({"--name", "b", "--server", "b:1"}), HasSubstr("--as (Partner.As) is missing"));
    EXPECT_THAT(refusal({"--name", "b", "--as", "a"}), HasSubstr("say --server HOST:PORT"));
}

TEST(PartnerOptionsTest, WhatIsWrongIsRefusedWithWhatIsExpected) {
    EXPECT_THAT(refusal({"--name", "b/c", "--as", "a", "--server", "b:1"}),
                HasSubstr("expected 1 to 32 letters"));
    EXPECT_THAT(refusal({"--name", "b", "--as", "a", "--server", "nonsense:x"}), HasSubstr("--server: "));
    EXPECT_THAT(refusal({"--name", "b", "--as", "a", "--server", "b:1", "-e", "a:x"}),
                HasSubstr("--entity-server: "));
    for (const auto* wrong : {"0", "-1", "x", "10001", "999999"})
        EXPECT_THAT(refusal({"--name", "b", "--as", "a", "--server", "b:1", "--visitors", wrong}),
                    HasSubstr("expected a whole number from 1 to 10000"))
            << wrong;
    EXPECT_THAT(refusal({"--name", "b", "--as", "a", "--server", "b:1", "--log-level", "loud"}),
                HasSubstr("--log-level (Partner.LogLevel): expected"));
    EXPECT_THAT(refusal({"--name", "b", "--as", "a", "--server", "ssl://b:1"}), HasSubstr("ertificate"));
}

TEST(PartnerOptionsTest, EachLaboratoryHasAFileOfItsOwn) {
    const auto client = fileWith("client.cfg", "Axon.Server=lab-b:1\nAxon.User=lab-a\nIce.Trace.Network=0\n");
    const auto entity = fileWith("entity.cfg", "Axon.Server=here:2\nAxon.User=partners\n");
    const auto config = fileWith("partner.cfg", "Partner.Name=b\nPartner.As=a\nPartner.Client=" + client +
                                                    "\nPartner.Entity=" + entity + "\nPartner.Visitors=7\n");
    const auto options = read({"--config", config.c_str()});
    EXPECT_EQ(options.gateway.there.server, "lab-b:1");
    EXPECT_EQ(options.gateway.there.user, "lab-a");
    EXPECT_EQ(options.gateway.there.properties.at("Ice.Trace.Network"), "0");
    EXPECT_EQ(options.gateway.home.host, "here");
    EXPECT_EQ(options.gateway.home.port, 2);
    EXPECT_EQ(options.gateway.home.user, "partners");
    EXPECT_EQ(options.gateway.core.visitors_max, 7U);
    EXPECT_EQ(read({"--config", config.c_str(), "--name", "c"}).gateway.core.laboratory, "c");
}

TEST(PartnerOptionsTest, APropertyOfIceBelongsToOneOfTheTwo) {
    const auto config = fileWith("mixed.cfg", "Partner.Name=b\nIceSSL.CAs=ca.pem\n");
    EXPECT_THAT(refusal({"--config", config.c_str()}),
                HasSubstr("IceSSL.CAs belongs to one of the two laboratories"));
    const auto unknown = fileWith("unknown.cfg", "Partner.Nmae=b\n");
    EXPECT_THAT(refusal({"--config", unknown.c_str()}), HasSubstr("unknown property"));
}

TEST(PartnerOptionsTest, AnUnknownOptionIsExplainedAndEndsWithStatus2) {
    testing::internal::CaptureStderr();
    EXPECT_EQ(read({"--nmae", "b"}).exit_code, 2);
    EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("--name"));
}

}  // namespace
}  // namespace axon::partner
