// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/device.hpp"

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

const DeviceKind* deviceKind(std::string_view word) {
    const auto& kinds = deviceKinds();
    const auto found = std::find_if(kinds.begin(), kinds.end(),
                                    [word](const DeviceKind& kind) { return kind.word == word; });
    return found == kinds.end() ? nullptr : &*found;
}

}  // namespace axon::lab
