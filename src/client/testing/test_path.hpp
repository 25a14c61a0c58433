// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "client/direct/direct_path.hpp"

namespace axon::client::test {

/// A path that notes what goes, and opens when it is told to.
class NotedPath final : public DirectPath {
  public:
    NotedPath(const DirectOffer& offer, Id128 number, const Clock& clock)
        : DirectPath(offer, number, clock) {}
    void open(Duration) override {}
    std::string reason() const override { return reason_; }
    void close(const std::string& why) override {
        if (!ended_) reason_ = why;
        ended_ = true;
    }
    void send(direct::Keeping, const Header& head, std::shared_ptr<const std::string>) const override {
        sent.push_back(head.sequence);
        sent_types.push_back(head.msg_type);
    }
    void sendStopSignal(const Header& head, StopCause) const override { stops.push_back(head.sequence); }
    void sendResetSignal(const Header&) const override {}
    void sendClearSignal(const Header&) const override {}
    void beat() const override { ++beats; }
    void stand() {
        liveness.heard(clock_.now());
        open_ = true;
    }
    mutable std::vector<std::int64_t> sent, stops;
    mutable std::vector<std::string> sent_types;
    mutable int beats = 0;

  private:
    std::string reason_;
};

}  // namespace axon::client::test
