// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/base/log.hpp"

#include <pthread.h>
#include <spdlog/async.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <cstdlib>
#include <memory>
#include <thread>

namespace axon::client {
namespace {

constexpr std::size_t kLines = 1024;
constexpr int kExitWait_ms = 200;

/// Never destroyed: the writer's destructor joins its thread, which may wait for standard error for ever.
struct OwnLog {
    std::shared_ptr<spdlog::details::thread_pool> writer = std::make_shared<spdlog::details::thread_pool>(
        kLines, 1, [] { pthread_setname_np(pthread_self(), "axon-log"); });
    std::shared_ptr<spdlog::async_logger> logger =
        std::make_shared<spdlog::async_logger>("axon", std::make_shared<spdlog::sinks::stderr_sink_mt>(),
                                               writer, spdlog::async_overflow_policy::overrun_oldest);
};
OwnLog* own = nullptr;

std::shared_ptr<spdlog::logger> make() {
    if (auto registered = spdlog::get("axon")) return registered;
    own = new OwnLog;
    own->logger->set_level(spdlog::level::warn);
    spdlog::register_logger(own->logger);  // the transport below finds it by its name
    std::atexit([] {
        for (int i = 0; i < kExitWait_ms && own->writer->queue_size() > 0; ++i)
            std::this_thread::sleep_for(std::chrono::milliseconds(1));
    });
    return own->logger;
}

}  // namespace

spdlog::logger& log() {
    static const std::shared_ptr<spdlog::logger> logger = make();
    return *logger;
}

}  // namespace axon::client
