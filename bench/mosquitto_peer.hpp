// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <memory>
#include <string>

namespace axon::bench {

/// N receivers, each with an MQTT connection and a topic of its own, in one process with one epoll loop; notes
/// arrivals on the board until it is killed or its parent dies.
int runMosquittoReceivers(const std::string& board_file, std::size_t receivers, std::uint16_t port);

/// The publishing side: one connection, QoS 0, TCP_NODELAY. Throws std::runtime_error.
class MosquittoSender {
  public:
    explicit MosquittoSender(std::uint16_t port);
    ~MosquittoSender();
    /// To receiver i; the topic says whether it counts as stop or as data.
    void send(std::size_t receiver, bool stop, const std::string& bytes);

  private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace axon::bench
