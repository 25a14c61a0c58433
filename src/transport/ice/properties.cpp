// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/properties.hpp"

#include <Ice/Ice.h>

#include <fstream>
#include <stdexcept>

namespace axon::transport {

std::map<std::string, std::string> readProperties(const std::filesystem::path& file) {
    if (!std::filesystem::is_regular_file(file) || !std::ifstream(file))
        throw std::runtime_error(file.string() + ": cannot be read; expected a file with lines KEY=VALUE");
    const auto properties = Ice::createProperties();
    try {
        properties->load(file.string());
    } catch (const Ice::Exception& error) {
        throw std::runtime_error(file.string() + ": not understood (" + error.ice_id() +
                                 "); expected lines KEY=VALUE");
    }
    return properties->getPropertiesForPrefix("");
}

}  // namespace axon::transport
