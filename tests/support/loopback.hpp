// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <unistd.h>

#include <chrono>
#include <functional>
#include <string>
#include <thread>

namespace axon::test {

/// A loopback address of this process's own (127.x.y.z from its process id), so that tests run in parallel.
inline std::string loopbackAddress() {
    const auto pid = static_cast<unsigned>(::getpid());
    return "127." + std::to_string(1 + (pid >> 16U) % 250) + "." + std::to_string((pid >> 8U) & 255U) + "." +
           std::to_string(1 + (pid & 255U) % 254);
}

/// Waits until the condition holds, or the deadline passes; returns whether it holds. For effects of real
/// threads, sockets and processes only: everything that can be is tested on a ManualClock.
inline bool waitUntil(const std::function<bool()>& holds,
                      std::chrono::milliseconds deadline = std::chrono::seconds{10}) {
    const auto end = std::chrono::steady_clock::now() + deadline;
    while (!holds()) {
        if (std::chrono::steady_clock::now() >= end) return holds();
        std::this_thread::yield();
        std::this_thread::sleep_for(std::chrono::milliseconds{1});
    }
    return true;
}

}  // namespace axon::test
