// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/log.hpp"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <memory>

namespace axon::client {

spdlog::logger& log() {
    static const std::shared_ptr<spdlog::logger> logger = [] {
        if (auto registered = spdlog::get("axon")) return registered;
        auto own =
            std::make_shared<spdlog::logger>("axon", std::make_shared<spdlog::sinks::stderr_sink_mt>());
        own->set_level(spdlog::level::warn);
        spdlog::register_logger(own);  // the transport below finds it by its name
        return own;
    }();
    return *logger;
}

}  // namespace axon::client
