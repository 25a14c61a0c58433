// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "cli/fake_station.hpp"
#include "cli/verbs/docs_place.hpp"

using namespace axon;
using namespace axon::cli;

namespace {

namespace fs = std::filesystem;

struct Docs : testing::Test {
    Docs() {
        std::string name = (fs::temp_directory_path() / "axon-docs-XXXXXX").string();
        root = ::mkdtemp(name.data());
    }
    ~Docs() override { fs::remove_all(root); }
    fs::path page(const fs::path& path) const {
        fs::create_directories((root / path).parent_path());
        std::ofstream(root / path) << "<html>";
        return root / path;
    }
    fs::path root;
};

}  // namespace

TEST_F(Docs, AreFoundInThePrefixOfTheProgram) {
    const auto first = page("usr/share/doc/axon/html/index.html");
    EXPECT_EQ(docsPage(root / "usr/bin/axon", {}), first);
}

TEST_F(Docs, AreFoundWhereTheyWereBuilt) {
    const auto first = page("build/docs-site/index.html");
    EXPECT_EQ(docsPage(root / "build/dev/bin/axon", {}), first);
}

TEST_F(Docs, OfThePrefixComeBeforeThoseOfTheBuild) {
    page("build/docs-site/index.html");
    const auto installed = page("build/dev/share/doc/axon/html/index.html");
    EXPECT_EQ(docsPage(root / "build/dev/bin/axon", {}), installed);
}

TEST_F(Docs, HaveAPageByItsPath) {
    page("usr/share/doc/axon/html/index.html");
    const auto known = page("usr/share/doc/axon/html/folder/known.html");
    EXPECT_EQ(docsPage(root / "usr/bin/axon", "folder/known.html"), known);
    EXPECT_EQ(docsPage(root / "usr/bin/axon", fs::path("folder/known").concat(".md").string()), known)
        << "as the page is called in the sources";
    EXPECT_EQ(docsPage(root / "usr/bin/axon", "folder/unknown.html"), std::nullopt);
    EXPECT_EQ(docsPage(root / "usr/bin/axon", "folder"), std::nullopt) << "a folder is no page";
}

TEST_F(Docs, ThatAreNotThereAreNotFound) {
    EXPECT_EQ(docsPage(root / "usr/bin/axon", {}), std::nullopt);
}

TEST_F(Docs, TheCommandSaysHowToGetAPageThatIsNotThere) {
    Recorded seen;
    Settings settings;
    Session session{{{"page", "no/such/page.html"}, {"path", true}},
                    seen,
                    std::make_shared<Mailbox>(),
                    nullptr,
                    settings};
    EXPECT_EQ(findVerb("docs")->perform(session), kUsage);
    ASSERT_NE(seen.last("error"), nullptr);
    EXPECT_THAT(
        seen.last("error")->at("fix").get<std::string>(),
        testing::AnyOf(testing::HasSubstr("tools/make_docs"), testing::HasSubstr("docs/questions.md")));
}
