// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/settings.hpp"

namespace axon::cyton {

std::array<double, 3> parsePlace(const std::string& text) {
    return robots::parseThreeNumbers(text, "--at", "X,Y,Z in mm, for example 600,3000,700");
}

std::string withSpeed(const std::string& arm) {
    return arm.starts_with('/') && arm.find(':') == std::string::npos ? arm + ":115200" : arm;
}

}  // namespace axon::cyton
