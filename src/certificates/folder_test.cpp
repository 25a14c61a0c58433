// SPDX-License-Identifier: GPL-2.0-or-later
#include "certificates/folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <fstream>
#include <iterator>

#include "certificates/testing.hpp"

namespace axon::certificates {
namespace {

using namespace std::chrono;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;
namespace fs = std::filesystem;

constexpr WallTime kNow{sys_days{year{2026} / 11 / 21}};
const Request kClient{Kind::Client, {"client1"}};

std::string contentOf(const fs::path& file) {
    std::ifstream stream(file);
    return {std::istreambuf_iterator<char>(stream), {}};
}

unsigned modeOf(const fs::path& file) {
    struct stat facts {};
    ::stat(file.c_str(), &facts);
    return facts.st_mode & 0777U;
}

class CertificateFolder : public testing::Test {
  protected:
    ~CertificateFolder() override { fs::remove_all(above); }
    static fs::path newFolder() {
        std::string name = fs::temp_directory_path() / "axon-certs-XXXXXX";
        return ::mkdtemp(name.data());
    }
    const fs::path above = newFolder();
    const Folder folder{above / "lab" / "certs"};
};

TEST_F(CertificateFolder, MakesACaWhoseKeyIsItsOwnersOnly) {
    const auto written = folder.init(kNow, false);
    EXPECT_EQ(modeOf(folder.path()), 0700U);
    EXPECT_EQ(modeOf(folder.path() / "ca.key.pem"), 0600U);
    EXPECT_TRUE(written.certificate.authority);
    EXPECT_EQ(readCertificateFile(folder.path() / "ca.cert.pem").front().name, written.certificate.name);
}

TEST_F(CertificateFolder, IssuesCertificateKeyAndConfiguration) {
    folder.init(kNow, false);
    const auto written = folder.issue(kClient, kNow, false);
    EXPECT_THAT(written.files,
                ElementsAre(folder.path() / "client-client1.cert.pem",
                            folder.path() / "client-client1.key.pem", folder.path() / "client-client1.cfg"));
    EXPECT_EQ(modeOf(written.files[1]), 0600U);
    EXPECT_EQ(written.certificate.unit, "client");
    const auto configuration = contentOf(written.files[2]);
    for (const auto& line :
         {"IceSSL.DefaultDir=" + folder.path().string() + "\n", std::string("IceSSL.CAs=ca.cert.pem\n"),
          std::string("IceSSL.CertFile=client-client1.cert.pem\n"), std::string("IceSSL.VerifyPeer=2\n"),
          std::string("IceSSL.CheckCertName=1\n")})
        EXPECT_THAT(configuration, HasSubstr(line));
    folder.issue({Kind::Server, {"lab", "127.0.0.1"}}, kNow, false);
    EXPECT_THAT(folder.certificateFiles(),
                ElementsAre(folder.path() / "ca.cert.pem", folder.path() / "client-client1.cert.pem",
                            folder.path() / "server-lab.cert.pem"));
}

TEST_F(CertificateFolder, TheFileOfIceStormAdmitsServersOnly) {
    folder.init(kNow, false);
    const auto storm = folder.issue({Kind::Storm, {"lab"}}, kNow, false);
    EXPECT_THAT(contentOf(storm.files.back()),
                HasSubstr("IceSSL.TrustOnly.Server=OU=front-end,O=Axon;OU=entity-server,O=Axon\n"));
    const auto server = folder.issue({Kind::EntityServer, {"es1", "lab"}}, kNow, false);
    EXPECT_EQ(server.files.back().filename(), "entity-server-es1.cfg");
    EXPECT_THAT(contentOf(server.files.back()), HasSubstr("#Server.Name=es1\n"));
}

TEST_F(CertificateFolder, TheFileOfIceGridAdmitsIceGridOnly) {
    folder.init(kNow, false);
    const auto registry = folder.issue({Kind::Registry, {"lab"}}, kNow, false);
    EXPECT_EQ(registry.files.back().filename(), "registry-lab.cfg");
    EXPECT_THAT(contentOf(registry.files.back()), HasSubstr("\nIceSSL.TrustOnly=OU=registry,O=Axon\n"));
}

TEST_F(CertificateFolder, TheFileOfARouterAdmitsServersOnlyBehindIt) {
    folder.init(kNow, false);
    const auto router = folder.issue({Kind::Router, {"lab"}}, kNow, false);
    const std::string servers = "OU=server,O=Axon;OU=front-end,O=Axon;OU=entity-server,O=Axon\n";
    const auto configuration = contentOf(router.files.back());
    EXPECT_THAT(configuration, HasSubstr("\nIceSSL.TrustOnly.Client=" + servers));
    EXPECT_THAT(configuration, HasSubstr("\nIceSSL.TrustOnly.Server.Glacier2.Server=" + servers));
    EXPECT_THAT(configuration, testing::Not(HasSubstr("IceSSL.TrustOnly.Server=")))
        << "clients connect to its other port";
}

TEST_F(CertificateFolder, OverwritesNothingUnlessItIsForced) {
    folder.init(kNow, false);
    const auto authority = contentOf(folder.path() / "ca.key.pem");
    EXPECT_THAT(complaint([&] { folder.init(kNow, false); }), HasSubstr("--force makes a new CA"));
    EXPECT_EQ(contentOf(folder.path() / "ca.key.pem"), authority);

    const auto written = folder.issue(kClient, kNow, false);
    const auto key = contentOf(written.files[1]);
    EXPECT_THAT(complaint([&] { folder.issue(kClient, kNow, false); }), HasSubstr("is there already"));
    EXPECT_EQ(contentOf(written.files[1]), key);
    fs::remove(written.files[1]);
    EXPECT_THAT(complaint([&] { folder.issue(kClient, kNow, false); }), HasSubstr("is there already"));
    EXPECT_FALSE(fs::exists(written.files[1])) << "all files or none";

    folder.issue(kClient, kNow, true);
    EXPECT_NE(contentOf(written.files[1]), key);
    EXPECT_EQ(modeOf(written.files[1]), 0600U);
    folder.init(kNow, true);
    EXPECT_NE(contentOf(folder.path() / "ca.key.pem"), authority);
}

TEST_F(CertificateFolder, SaysThatThereIsNoCaAndHowToMakeOne) {
    EXPECT_THAT(complaint([&] { folder.issue(kClient, kNow, false); }),
                HasSubstr("fix: axon certs init --folder " + folder.path().string()));
    EXPECT_THAT(complaint([&] { folder.certificateFiles(); }), HasSubstr("cannot be read"));
    folder.init(kNow, false);
    fs::remove(folder.path() / "ca.key.pem");
    EXPECT_THAT(complaint([&] { folder.issue(kClient, kNow, false); }),
                HasSubstr("ca.key.pem cannot be read"));
    fs::create_directory(folder.path() / "ca.key.pem");
    EXPECT_THAT(complaint([&] { folder.issue(kClient, kNow, false); }), HasSubstr("expected a regular file"));
}

TEST_F(CertificateFolder, SaysWhereItCannotWrite) {
    std::ofstream(above / "file") << "in the way";
    EXPECT_THAT(complaint([&] { Folder(above / "file").init(kNow, false); }), HasSubstr("is no folder"));
    EXPECT_THAT(complaint([&] { Folder(above / "file" / "certs").init(kNow, false); }),
                HasSubstr("cannot be made"));
    EXPECT_THAT(complaint([&] { Folder(fs::path()).init(kNow, false); }), HasSubstr("--folder DIR"));
    EXPECT_THAT(complaint([&] { Folder("a\nb").init(kNow, false); }), HasSubstr("line ends"));
}

TEST_F(CertificateFolder, RefusesAWrongNameBeforeItWritesAnything) {
    folder.init(kNow, false);
    EXPECT_THAT(complaint([&] {
                    folder.issue({Kind::Client, {"a b"}}, kNow, false);
                }),
                HasSubstr("user name"));
    EXPECT_EQ(folder.certificateFiles().size(), 1U);
}

TEST_F(CertificateFolder, NamesFilesWithoutSpacesSlashesAndTheLike) {
    EXPECT_EQ(fileStem({Kind::Entity, {"../Cyton Arm#2"}}), "entity-.._Cyton_Arm_2");
    EXPECT_EQ(fileStem({Kind::Server, {"192.168.0.5"}}), "server-192.168.0.5");
}

TEST_F(CertificateFolder, ReadsBadFilesWithAReason) {
    std::ofstream(above / "bad.pem") << "-----BEGIN CERTIFICATE-----\n!!!\n-----END CERTIFICATE-----\n";
    EXPECT_THAT(complaint([&] { readCertificateFile(above / "bad.pem"); }), HasSubstr("in PEM form"));
    EXPECT_THAT(complaint([&] { readCertificateFile(above / "none.pem"); }), HasSubstr("No such file"));
    EXPECT_THAT(complaint([&] { readCertificateFile(above); }), HasSubstr("expected a regular file"));
    std::ofstream(above / "large.pem") << std::string(1'100'000, '-');
    EXPECT_THAT(complaint([&] { readCertificateFile(above / "large.pem"); }), HasSubstr("at most 1 MiB"));
}

TEST(CertificateConfiguration, KeepsAPathAsItIs) {
    const auto text = configuration({Kind::Entity, {"left"}}, "entity-left", "/srv/lab #1/a\\b");
    EXPECT_THAT(text, HasSubstr("IceSSL.DefaultDir=/srv/lab \\#1/a\\\\b\n"));
    EXPECT_THAT(text, HasSubstr("#Axon.Server=ssl://HOST:10412"));
    EXPECT_THAT(text, Not(HasSubstr("\r")));
}

}  // namespace
}  // namespace axon::certificates
