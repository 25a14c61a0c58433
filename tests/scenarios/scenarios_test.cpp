// SPDX-License-Identifier: GPL-2.0-or-later
// Every *.txt here is an executable specification of the Entity Manager (README.md in this folder).
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "tests/support/core_rig.hpp"

namespace axon::test {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> scenarioNames() {
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator("tests/scenarios"))
        if (entry.path().extension() == ".txt" && entry.path().stem() != "CMakeLists")
            names.push_back(entry.path().stem());
    std::sort(names.begin(), names.end());
    return names;
}

class Scenario : public testing::TestWithParam<std::string> {};

TEST_P(Scenario, PlaysAsRecorded) {
    const auto path = fs::path("tests/scenarios") / (GetParam() + ".txt");
    std::ifstream file(path, std::ios::binary);
    std::stringstream recorded;
    recorded << file.rdbuf();
    const auto played = playScenario(recorded.str());
    if (std::getenv("AXON_RERECORD") != nullptr) {
        std::ofstream(path, std::ios::binary) << played;
        return;
    }
    EXPECT_EQ(played, recorded.str())
        << path << ": when the new behaviour is meant, run with AXON_RERECORD=1 and read the diff";
}

INSTANTIATE_TEST_SUITE_P(EntityManager, Scenario, testing::ValuesIn(scenarioNames()),
                         [](const auto& which) { return which.param; });

}  // namespace
}  // namespace axon::test
