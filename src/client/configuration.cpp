// SPDX-License-Identifier: GPL-2.0-or-later
#include <sys/stat.h>

#include "axon/client.hpp"
#include "transport/ice/properties.hpp"

namespace axon::client {

Result<Options> readConfiguration(const std::filesystem::path& file, Options options) {
    const auto refuse = [&](RefusalCode code, const std::string& why) {
        return Refusal{code, file.string() + ": " + why, {}};
    };
    std::map<std::string, std::string> values;
    try {
        values = transport::readProperties(file);
    } catch (const std::exception& error) {
        return Refusal{RefusalCode::Malformed, error.what(), {}};
    }
    const std::map<std::string, std::string*> known = {{"Ice.Default.Router", &options.server},
                                                       {"Axon.Server", &options.server},
                                                       {"Axon.User", &options.user},
                                                       {"Axon.Password", &options.password}};
    if (values.contains("Ice.Default.Router") && values.contains("Axon.Server"))
        return refuse(
            RefusalCode::Malformed,
            "Ice.Default.Router and Axon.Server are both there; expected one of them: the way to the servers "
            "is either through a router or without one");
    struct stat facts {};
    if (values.contains("Axon.Password") && ::stat(file.c_str(), &facts) == 0 && (facts.st_mode & 077U) != 0)
        return refuse(RefusalCode::PermissionDenied,
                      "others may read it, and it holds a password: chmod 600 " + file.string() +
                          ", and change the password");
    for (const auto& [key, value] : values) {
        if (const auto found = known.find(key); found != known.end()) {
            *found->second = value;
        } else if (key.rfind("Ice.", 0) == 0 || key.rfind("IceSSL.", 0) == 0) {
            options.properties[key] = value;
        } else {
            std::string names;
            for (const auto& [name, to] : known) names += name + ", ";
            return refuse(RefusalCode::Malformed, "'" + key + "' is not known; expected one of " + names +
                                                      "or a property Ice.* or IceSSL.*");
        }
    }
    return options;
}

}  // namespace axon::client
