// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "board.hpp"
#include "child.hpp"
#include "client/axon/client.hpp"
#include "crowd.hpp"
#include "radio.hpp"

namespace axon::bench {

/// axon-server on ports of its own: on loopback, or for Entity Managers on the wired side of a radio link,
/// with users and passwords then.
class AxonServer {
  public:
    /// Throws std::runtime_error with the log.
    explicit AxonServer(const std::filesystem::path& folder, const Radio* radio = nullptr);
    /// For connectClient() and Entities: HOST:PORT, or a configuration file.
    const std::string& clientAddress() const { return client_; }
    const std::string& entityAddress() const { return entity_; }
    const Radio* radio() const { return radio_; }
    const Child& process() const { return child_; }

  private:
    const Radio* radio_;
    Child child_;
    std::string client_, entity_;
};

/// Servers that run already: the configuration files of a client and of an Entity Manager, as axon-cluster
/// writes them.
struct Running {
    std::string client_config, entity_config;
};

/// N Entity Managers in a process of their own (crowd.hpp), or in as few as the limit of descriptors permits,
/// named PREFIX-0 … PREFIX-N-1. With a radio link the second half is in other processes beyond it.
class Entities {
  public:
    /// `server`: HOST:PORT, or the configuration file of an Entity Manager. `scans`: as of runRobots(), where
    /// there are robot applications. Throws std::runtime_error with the log.
    Entities(const std::filesystem::path& folder, const std::string& prefix, std::size_t n,
             const std::string& server, const Radio* radio = nullptr, Variant variant = Variant::Relayed,
             std::size_t scans = 0);
    Board& board() { return board_; }
    /// Where the robot applications note; null where there are none.
    Board* robots() { return robots_ ? &*robots_ : nullptr; }
    const std::vector<std::string>& names() const { return names_; }
    /// The first of those behind the radio link.
    static std::size_t firstWireless(std::size_t n) { return n / 2; }
    /// The only one, where they are few and without a radio link.
    const Child& process() const { return *children_.front(); }
    /// As Subject::ended().
    std::string ended() const;

  private:
    Board board_;
    std::optional<Board> robots_;
    std::vector<std::unique_ptr<Child>> children_;
    std::vector<std::string> names_;
};

/// Throws std::runtime_error with the refusal.
std::unique_ptr<client::Client> connectClient(client::Options options);
/// `server`: HOST:PORT, or the configuration file of a client.
std::unique_ptr<client::Client> connectClient(const std::string& server, Variant variant = Variant::Relayed);
/// Waits until they are there, and checks them out. Throws std::runtime_error with the refusal.
std::vector<client::CheckOut> holdAll(client::Client& client, const std::vector<std::string>& names);
/// How many entities have left the server from now on, as it tells this client. Shared with the callback,
/// which the client may still call while it closes.
std::shared_ptr<std::atomic<std::size_t>> countLeft(client::Client& client);

/// A server, unless one runs already, N entities, and a client that holds all of them; by direct paths only
/// where each has opened. The constructors throw NotPermitted, before they start anything, where the client's
/// process may not have as many descriptors as its direct paths need.
class AxonCrowd {
  public:
    AxonCrowd(const std::filesystem::path& folder, std::size_t n, Variant variant = Variant::Relayed,
              const Running* running = nullptr, const Radio* radio = nullptr);
    /// Through this server, which outlives it, with entities of another name than others that it has.
    AxonCrowd(const AxonServer& server, const std::filesystem::path& folder, const std::string& prefix,
              std::size_t n, Variant variant = Variant::Relayed);
    Board& board() { return entities_->board(); }
    Board* robots() { return entities_->robots(); }
    client::Client& client() { return *client_; }
    const std::vector<std::string>& names() const { return entities_->names(); }
    const std::vector<client::CheckOut>& held() const { return held_; }
    /// There are no other entities at its server.
    bool alone() const { return server_ != nullptr; }
    /// Entities whose direct path is not open, of those that were to have one.
    std::size_t relayed() const;
    /// As Subject::ended(); of the server only where it is this one's own.
    std::string ended() const;

  private:
    void hold();
    const Variant variant_;
    std::unique_ptr<AxonServer> server_;
    std::unique_ptr<Entities> entities_;
    std::unique_ptr<client::Client> client_;
    std::vector<client::CheckOut> held_;
};

}  // namespace axon::bench
