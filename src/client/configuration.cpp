// SPDX-License-Identifier: GPL-2.0-or-later
#include <sys/stat.h>

#include "axon/client.hpp"
#include "transport/ice/properties.hpp"

namespace axon::client {

Result<Options> readConfiguration(const std::filesystem::path& file, Options options) {
    const auto refuse = [&](RefusalCode code, const std::string& why) {
        return Refusal{code, file.string() + ": " + why, {}};
    };
    const std::map<std::string, std::string*> known = {{"Ice.Default.Router", &options.server},
                                                       {"Axon.Server", &options.server},
                                                       {"Axon.User", &options.user},
                                                       {"Axon.Password", &options.password}};
    std::set<std::string> keys;
    for (const auto& [key, to] : known) keys.insert(key);
    transport::Properties read;
    try {
        read = transport::readProperties(file, keys);
    } catch (const std::exception& error) {
        return Refusal{RefusalCode::Malformed, error.what(), {}};
    }
    if (read.own.contains("Ice.Default.Router") && read.own.contains("Axon.Server"))
        return refuse(
            RefusalCode::Malformed,
            "Ice.Default.Router and Axon.Server are both there; expected one of them: the way to the servers "
            "is either through a router or without one");
    struct stat facts {};
    if (read.own.contains("Axon.Password") && ::stat(file.c_str(), &facts) == 0 &&
        (facts.st_mode & 077U) != 0)
        return refuse(RefusalCode::PermissionDenied,
                      "others may read it, and it holds a password: chmod 600 " + file.string() +
                          ", and change the password");
    for (const auto& [key, setting] : read.own) *known.at(key) = setting.value;
    for (auto& [key, value] : read.ice) options.properties[key] = std::move(value);
    return options;
}

}  // namespace axon::client
