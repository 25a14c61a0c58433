// SPDX-License-Identifier: MIT
#include "simulated_motor.hpp"

#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <iostream>
#include <string>
#include <system_error>
#include <thread>

namespace {

using namespace std::chrono_literals;
using SteadyClock = std::chrono::steady_clock;

void turn(int line) {
    constexpr double kChange_deg_s2 = 300;
    double angle_deg = 0, speed_deg_s = 0, wanted_deg_s = 0;
    auto then = SteadyClock::now();
    std::string received;
    char bytes[256];
    for (ssize_t count = 0; (count = read(line, bytes, sizeof bytes)) > 0;) {
        received.append(bytes, std::size_t(count));
        for (std::size_t end; (end = received.find('\n')) != std::string::npos; received.erase(0, end + 1)) {
            std::this_thread::sleep_for(15ms);
            const double passed_s = std::chrono::duration<double>(SteadyClock::now() - then).count();
            then = SteadyClock::now();
            const double change = kChange_deg_s2 * passed_s;
            speed_deg_s += std::clamp(wanted_deg_s - speed_deg_s, -change, change);
            angle_deg += speed_deg_s * passed_s;
            double ordered_deg_s = 0;
            if (std::sscanf(received.c_str(), "SPEED %lf", &ordered_deg_s) == 1) {
                if (ordered_deg_s != wanted_deg_s)
                    std::cout << "motor: " << ordered_deg_s << " deg/s" << std::endl;
                wanted_deg_s = ordered_deg_s;
            }
            const auto answer = "AT " + std::to_string(angle_deg) + " " + std::to_string(speed_deg_s) + "\n";
            (void)!send(line, answer.data(), answer.size(), MSG_NOSIGNAL);
        }
    }
}

}  // namespace

SimulatedMotor::SimulatedMotor() {
    int ends[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0)
        throw std::system_error(errno, std::generic_category(), "socketpair");
    const auto child = fork();
    if (child < 0) throw std::system_error(errno, std::generic_category(), "fork");
    if (child == 0) {
        setsid();  // Ctrl-C at the terminal is not for the motor
        close(ends[0]);
        turn(ends[1]);
        _exit(0);
    }
    close(ends[1]);
    line_ = ends[0];
}

SimulatedMotor::~SimulatedMotor() {
    close(line_);
}
