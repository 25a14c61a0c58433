// SPDX-License-Identifier: GPL-2.0-or-later
// For the tests of this folder.
#pragma once
#include <cstdint>
#include <string>
#include <string_view>

#include "front_end_server/ports/ports.hpp"

namespace axon::front_end_server {

/// The way to a client that nothing reaches, by a connection of its own or by this one.
class DeafOutbox final : public ClientOutbox {
  public:
    explicit DeafOutbox(const void* connection = nullptr) : connection_(connection) {}
    void newBasicPrflMsg(Presence, const Registration&, std::string_view) override {}
    void newStatusMsg(const EntityStatus&) override {}
    bool newEntityMsg(Lane, const Header&, std::string_view, QueueShare) override { return true; }
    void newEntityMsgDataSeq(const Header&, std::string_view) override {}
    void newRefusalMsg(const Header&, const Refusal&) override {}
    void newStopAccepted(const Header&, std::int32_t) override {}
    void newUpdateMsg(RefusalCode, const std::string&) override {}
    void newHeartbeat(std::int64_t) override {}
    void disconnect(bool, const std::string&) override {}
    const void* connection() const override { return connection_ != nullptr ? connection_ : this; }

  private:
    const void* const connection_;
};

}  // namespace axon::front_end_server
