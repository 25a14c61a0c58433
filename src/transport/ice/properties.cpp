// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/properties.hpp"

#include <algorithm>
#include <stdexcept>

namespace axon::transport {
namespace {

bool isKnown(const std::string& key, const std::set<std::string>& known) {
    return std::any_of(known.begin(), known.end(), [&](const std::string& one) {
        return one.ends_with('.') ? key.starts_with(one) && key.size() > one.size() : key == one;
    });
}

}  // namespace

Properties readProperties(const std::filesystem::path& file, const std::set<std::string>& known) {
    auto settings = readSettings(file);
    if (!settings) throw std::runtime_error(settings.refusal().message);
    Properties properties;
    for (auto& setting : settings.value()) {
        const auto key = setting.key;
        if (isKnown(key, known)) {
            properties.own.erase(key);
            if (!setting.value.empty()) properties.own.emplace(key, std::move(setting));
        } else if (key.starts_with("Ice.") || key.starts_with("IceSSL.")) {
            properties.ice.erase(key);
            if (!setting.value.empty()) properties.ice.emplace(key, std::move(setting.value));
        } else {
            std::string names;
            for (const auto& name : known) names += name + (name.ends_with('.') ? "*, " : ", ");
            throw std::runtime_error(setting.where + ": unknown property '" + key + "'; expected one of " +
                                     names + "or a property of Ice (Ice.*, IceSSL.*); fix: correct the name");
        }
    }
    return properties;
}

}  // namespace axon::transport
