// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/settings.hpp"

#include <fmt/format.h>

#include <system_error>

namespace axon::peoplebot {

MapPose parsePose(const std::string& text, std::string_view what) {
    const auto [x_mm, y_mm, heading_deg] =
        robots::parseThreeNumbers(text, what, "X,Y,HEADING in mm, mm, degrees, for example 1500,3000,90");
    return {x_mm, y_mm, heading_deg};
}

std::filesystem::path rulesFile(const Settings& settings, const std::string& name) {
    const auto installed = robots::installedFolder(settings.kind);
    for (const auto& folder : {settings.profiles, installed}) {
        std::error_code error;
        if (!folder.empty() && std::filesystem::is_regular_file(folder / name, error)) return folder / name;
    }
    throw BadSetting(
        fmt::format("there is no {}, neither in {} nor with --profiles", name, installed.string()));
}

}  // namespace axon::peoplebot
