// SPDX-License-Identifier: MIT
#pragma once

/// Stands in for a motor behind a serial line: a process of its own, which goes on turning when the program
/// that drives it has died. It prints every speed that it is given. Construct it before the program has
/// threads.
///
/// Lines to it: "SPEED deg/s", "WHERE". Every line is answered after 15 ms with "AT deg deg/s". It changes
/// its speed by 300 deg/s in a second.
class SimulatedMotor {
  public:
    SimulatedMotor();
    ~SimulatedMotor();
    SimulatedMotor(const SimulatedMotor&) = delete;
    SimulatedMotor& operator=(const SimulatedMotor&) = delete;
    /// The program's end of the line; it stays open until the destruction.
    int descriptor() const { return line_; }

  private:
    int line_ = -1;
};
