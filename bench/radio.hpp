// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>

namespace axon::faults {
class TwoSides;
}

namespace axon::bench {

/// A radio link in this process, by axon-channel's parts: two network namespaces with a channel in between
/// that loses and delays packets. This process, and what it starts, is on the wired side from now on; what is
/// started with enterWireless() is beyond the link.
///
/// Construct it before any thread; throws std::runtime_error where the machine does not permit it.
class Radio {
  public:
    Radio();
    ~Radio();
    Radio(const Radio&) = delete;
    Radio& operator=(const Radio&) = delete;
    /// For Child, between fork and exec.
    std::function<void()> enterWireless() const;
    /// The address of the wired side, from both.
    static const char* address();
    static nlohmann::json settings();

  private:
    std::unique_ptr<faults::TwoSides> sides_;
};

}  // namespace axon::bench
