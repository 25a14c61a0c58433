// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/device.hpp"

#include <fmt/format.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <stdexcept>

namespace axon::lab {

DeviceParts partsOf(const DeviceModel& described, const mjModel* model, mjData* data) {
    const auto id = [model](mjtObj type, const char* what, const std::string& name) {
        const int found = mj_name2id(model, type, name.c_str());
        if (found < 0)
            throw std::invalid_argument(std::string("the model has no ") + what + " " + name +
                                        ", which its description names");
        return found;
    };
    const auto ids = [&id](mjtObj type, const char* what, const std::vector<std::string>& names) {
        std::vector<int> found;
        for (const auto& name : names) found.push_back(id(type, what, name));
        return found;
    };
    return {.model = model,
            .data = data,
            .root = id(mjOBJ_BODY, "body", described.root),
            .joints = ids(mjOBJ_JOINT, "joint", described.joints),
            .actuators = ids(mjOBJ_ACTUATOR, "actuator", described.actuators),
            .geoms = ids(mjOBJ_GEOM, "geom", described.geoms),
            .sites = ids(mjOBJ_SITE, "site", described.sites),
            .cameras = ids(mjOBJ_CAMERA, "camera", described.cameras)};
}

std::vector<DeviceKind> distinct(std::vector<DeviceKind> kinds) {
    const auto refuse = [](const DeviceKind& kind, std::string_view member, std::string_view value,
                           const std::string& clash, std::string_view why) {
        throw std::invalid_argument(
            fmt::format("the device kind {}: {} \"{}\" is {} already, {}; fix: choose another {} in {}Kind()",
                        kind.label, member, value, clash, why, member, kind.word));
    };
    constexpr auto kWord = "and a line of a world's file begins with it";
    constexpr auto kNoun = "and it is an option of axon-lab and, with an s, a list of ground truth";
    constexpr auto kPort = "where the first robot of the kind listens";
    for (auto kind = kinds.begin(); kind != kinds.end(); ++kind) {
        if (std::find(kOtherWords.begin(), kOtherWords.end(), kind->word) != kOtherWords.end())
            refuse(*kind, "word", kind->word, "a word of the laboratory", kWord);
        if (std::find(kOtherOptions.begin(), kOtherOptions.end(), kind->noun) != kOtherOptions.end())
            refuse(*kind, "noun", kind->noun, "an option of the laboratory", kNoun);
        for (auto other = kinds.begin(); other != kind; ++other) {
            const auto that = "that of " + other->label;
            if (kind->word == other->word) refuse(*kind, "word", kind->word, that, kWord);
            if (kind->noun == other->noun) refuse(*kind, "noun", kind->noun, that, kNoun);
            if (kind->first_port == other->first_port)
                refuse(*kind, "first_port", std::to_string(kind->first_port), that, kPort);
        }
    }
    return kinds;
}

const DeviceKind* deviceKind(std::string_view word) {
    const auto& kinds = deviceKinds();
    const auto found = std::find_if(kinds.begin(), kinds.end(),
                                    [word](const DeviceKind& kind) { return kind.word == word; });
    return found == kinds.end() ? nullptr : &*found;
}

}  // namespace axon::lab
