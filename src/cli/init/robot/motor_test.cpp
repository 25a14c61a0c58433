// SPDX-License-Identifier: MIT
#include "motor.hpp"

#include <iostream>

namespace {
int failures = 0;

void expect(bool holds, const char* claim) {
    if (holds) return;
    ++failures;
    std::cerr << "failed: " << claim << '\n';
}
}  // namespace

int main() {
    Motor motor;
    motor.moveTo(100, 50);
    motor.advance(1);
    expect(motor.position() == 50 && !motor.arrived(), "it moves with its speed");
    motor.advance(10);
    expect(motor.position() == 100 && motor.arrived(), "it does not move beyond its target");
    motor.moveTo(0, 50);
    motor.advance(1);
    motor.stop();
    motor.advance(1);
    expect(motor.position() == 50, "it stands still after a stop");
    return failures;
}
