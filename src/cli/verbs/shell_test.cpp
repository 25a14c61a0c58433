// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "cli/verbs/shell_place.hpp"

using namespace axon::cli;

namespace {

namespace fs = std::filesystem;

struct Shell : testing::Test {
    Shell() {
        std::string name = (fs::temp_directory_path() / "axon-shell-XXXXXX").string();
        root = ::mkdtemp(name.data());
    }
    ~Shell() override { fs::remove_all(root); }
    fs::path packages(const fs::path& folder) const {
        fs::create_directories(root / folder / "axon");
        std::ofstream(root / folder / "axon/shell.py") << "\n";
        return root / folder;
    }
    fs::path root;
};

}  // namespace

TEST_F(Shell, IsFoundInThePrefixOfTheProgramAndWhereItWasBuilt) {
    const auto built = packages("build/dev/python");
    EXPECT_EQ(pythonFolder(root / "build/dev/bin/axon"), built);
    const auto installed = packages("usr/lib/python3/dist-packages");
    EXPECT_EQ(pythonFolder(root / "usr/bin/axon"), installed);
}

TEST_F(Shell, ThatIsNotInstalledIsNotFound) {
    EXPECT_EQ(pythonFolder(root / "usr/bin/axon"), std::nullopt);
    EXPECT_EQ(pythonFolder({}), std::nullopt);
}
