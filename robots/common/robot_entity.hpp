// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/entity_interfacer.hpp>
#include <memory>
#include <string>

#include "robots/common/byte_stream.hpp"
#include "robots/common/robot_settings.hpp"

/// From the settings of a robot application to its two ends: the Entity Interfacer, and the robot's link.
namespace axon::robots {

/// Of an application that tells when its robot stands still. `clock`: as in the options, none is this
/// machine's. Throws BadSetting.
EntityInterfacer::Options interfacerOptions(const RobotSettings& settings,
                                            std::shared_ptr<const Clock> clock);

/// Gives both profiles to the entity, the basic one under the settings' name where there is one. Keep what is
/// returned as long as the entity, which reads the renamed file again; it is empty where nothing was renamed.
/// Throws BadSetting and Misconfiguration.
[[nodiscard]] std::unique_ptr<TemporaryFile> uploadProfiles(EntityInterfacer& entity,
                                                            const RobotSettings& settings);

/// The robot's link at `address` (host:port or a serial line), watched by a guard that writes `stop` should
/// this process freeze or die; unguarded where the settings say so. The rules of guardedStreams() hold.
/// Throws std::invalid_argument for an address that is none, and as DeviceGuard does.
StreamOpener robotLink(const RobotSettings& settings, const std::string& address, std::string stop);

}  // namespace axon::robots
