// SPDX-License-Identifier: MIT
#include "device_thread.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <utility>

using namespace std::chrono_literals;

// [construct]
DeviceThread::DeviceThread(int line, std::function<void()> stands)
    : line_(line),
      wake_(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)),
      stands_(std::move(stands)),
      guard_({.device = "motor", .stop = "\nSPEED 0\n"}) {
    lost_ = !guard_.watch(line_);  // without a guard nothing may move
    thread_ = std::thread([this] { serve(); });
}
// [end]

DeviceThread::~DeviceThread() {
    stop();
    end_ = true;
    eventfd_write(wake_, 1);
    thread_.join();
    guard_.release();
    close(wake_);
}

// [pass]
DeviceThread::Pass DeviceThread::pass() const {
    const std::lock_guard lock(mutex_);
    return stops_;
}

bool DeviceThread::turn(Pass pass, double deg_s) {
    const std::lock_guard lock(mutex_);
    if (pass != stops_) return false;
    wanted_deg_s_ = deg_s;
    eventfd_write(wake_, 1);
    return true;
}

void DeviceThread::stop() {
    const std::lock_guard lock(mutex_);
    ++stops_;
    wanted_deg_s_ = 0;
    stopping_ = true;
    eventfd_write(wake_, 1);
}
// [end]

// [serve]
void DeviceThread::serve() {
    while (!end_ && !lost_) {
        order();
        wait();
        read();
        if (!guard_.beat() || std::chrono::steady_clock::now() - heard_ > 500ms) lost_ = true;
    }
    (void)!send(line_, "SPEED 0\n", 8, MSG_NOSIGNAL);
}

void DeviceThread::order() {
    double wanted_deg_s = 0;
    {
        const std::lock_guard lock(mutex_);
        wanted_deg_s = wanted_deg_s_;
    }
    std::string line;
    if (wanted_deg_s != ordered_deg_s_)
        line = "SPEED " + std::to_string(wanted_deg_s) + "\n";
    else if (unanswered_ == 0)
        line = "WHERE\n";
    ordered_deg_s_ = wanted_deg_s;
    if (line.empty() || guard_.stopped()) return;
    if (send(line_, line.data(), line.size(), MSG_NOSIGNAL) != ssize_t(line.size())) lost_ = true;
    ++unanswered_;
}

/// Until the motor answers, or somebody has a wish, or it is time for a heartbeat of the guard.
void DeviceThread::wait() {
    pollfd both[] = {{line_, POLLIN, 0}, {wake_, POLLIN, 0}};
    poll(both, 2, 20);
    eventfd_t wishes = 0;
    eventfd_read(wake_, &wishes);
}
// [end]

void DeviceThread::read() {
    char bytes[256];
    const auto count = recv(line_, bytes, sizeof bytes, MSG_DONTWAIT);
    if (count == 0) lost_ = true;
    if (count <= 0) return;
    received_.append(bytes, std::size_t(count));
    for (std::size_t end; (end = received_.find('\n')) != std::string::npos; received_.erase(0, end + 1)) {
        double angle_deg = 0;
        if (std::sscanf(received_.c_str(), "AT %lf %lf", &angle_deg, &speed_deg_s_) != 2) continue;
        angle_deg_ = angle_deg;
        heard_ = std::chrono::steady_clock::now();
        --unanswered_;
    }
    // [standstill]
    bool stands = false;
    {
        const std::lock_guard lock(mutex_);
        stands = stopping_ && unanswered_ == 0 && ordered_deg_s_ == 0 && speed_deg_s_ == 0;
        if (stands) stopping_ = false;
    }
    if (stands) stands_();
    // [end]
}
