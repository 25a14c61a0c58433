// SPDX-License-Identifier: MIT
#pragma once
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>

namespace axon::testing {

/// An expectation of a test that was not met. It is an exception, so that every test framework reports it;
/// what() says what was expected and what happened instead.
class __attribute__((visibility("default"))) Failure : public std::runtime_error {
  public:
    enum class Kind : std::uint8_t {
        NotInTime,  ///< it has not happened within the patience of the test
        Otherwise,  ///< something else has happened, so that it can no longer happen
        Refused,    ///< the request was refused, and would be in a laboratory
        LinkLost,   ///< the other side is gone
        Misuse      ///< the test itself asks for something that there is not
    };

    Failure(Kind kind, std::string expected, std::string happened)
        : std::runtime_error("expected " + expected + ", but " + happened),
          kind_(kind),
          expected_(std::move(expected)),
          happened_(std::move(happened)) {}

    Kind kind() const { return kind_; }
    const std::string& expected() const { return expected_; }
    const std::string& happened() const { return happened_; }

  private:
    Kind kind_;
    std::string expected_, happened_;
};

}  // namespace axon::testing
