// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/robot_entity.hpp"

#include <tuple>

#include "robots/common/guarded_streams.hpp"

namespace axon::robots {

EntityInterfacer::Options interfacerOptions(const RobotSettings& settings,
                                            std::shared_ptr<const Clock> clock) {
    EntityInterfacer::Options options;
    options.application = settings.application;
    options.reports_standstill = true;
    options.instance = settings.instance;
    options.resource_folders = settings.resources;
    options.clock = std::move(clock);
    if (std::filesystem::exists(settings.ports)) {
        options.ports_file = settings.ports;
    } else if (!settings.ports.empty()) {
        std::tie(options.first_port, options.last_port) = parsePortRange(settings.ports);
    }
    return options;
}

std::unique_ptr<TemporaryFile> uploadProfiles(EntityInterfacer& entity, const RobotSettings& settings) {
    const auto folder = profileFolder(settings);
    std::unique_ptr<TemporaryFile> renamed;
    if (settings.name.empty()) {
        entity.uploadBasicProfile(folder / "basic_profile.xml");
    } else {
        renamed = std::make_unique<TemporaryFile>(
            withEntityName(contentOf(folder / "basic_profile.xml"), settings.name));
        entity.uploadBasicProfile(renamed->path());
    }
    entity.uploadServiceProfile(folder / "services_profile.xml");
    return renamed;
}

StreamOpener robotLink(const RobotSettings& settings, const std::string& address, std::string stop) {
    auto open = robotStreams(address);
    if (settings.guard_silence == std::chrono::milliseconds::zero()) return open;
    return guardedStreams(std::move(open),
                          {.device = address, .stop = std::move(stop), .silence = settings.guard_silence});
}

}  // namespace axon::robots
