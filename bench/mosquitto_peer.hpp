// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <memory>
#include <string>

#include "subject.hpp"

struct mosquitto;

namespace axon::bench {

/// N receivers, each with an MQTT connection and two topics of its own, in one process with one epoll loop;
/// notes arrivals on the board until it is killed or its parent dies. Numbers from `first` on.
int runMosquittoReceivers(const std::string& board_file, std::size_t receivers, std::uint16_t port, int qos,
                          std::size_t first = 0);

/// A broker on a port of its own, with TCP_NODELAY.
class MosquittoBroker {
  public:
    /// Bounded: it drops what waits for a receiver beyond its default of 1000 messages; otherwise it keeps
    /// everything.
    MosquittoBroker(const std::filesystem::path& folder, bool bounded);
    std::uint16_t port() const { return port_; }
    const Child& process() const { return child_; }

  private:
    std::uint16_t port_;
    Child child_;
};

/// The publishing side: one connection, TCP_NODELAY. QoS 0: the caller's thread writes, as with the other
/// peers; QoS 1: a thread of the library does, which reads the acknowledgements. Throws std::runtime_error.
class MosquittoSender {
  public:
    MosquittoSender(std::uint16_t port, int qos);
    ~MosquittoSender();
    /// To receiver i; the topic says whether it counts as stop or as data. QoS 0: waits while the socket does
    /// not take it.
    void send(std::size_t receiver, Kind kind, const std::string& bytes);

  private:
    const int qos_;
    mosquitto* client_;
};

std::unique_ptr<Subject> startMosquitto(const std::filesystem::path& folder, std::size_t n, int qos);

}  // namespace axon::bench
