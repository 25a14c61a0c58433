// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <signal.h>

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "board.hpp"
#include "client/axon/client.hpp"

namespace axon::bench {

/// Ctrl-C.
extern volatile sig_atomic_t interrupted;

/// A child process, killed by its own id when this goes out of scope.
class Child {
  public:
    Child(const std::vector<std::string>& words, const std::filesystem::path& log);
    ~Child();
    Child(const Child&) = delete;
    Child& operator=(const Child&) = delete;
    bool running() const;

  private:
    int pid_ = -1;
};

/// Servers that run already: the configuration files of a client and of an Entity Manager, as axon-cluster writes them.
struct Running {
    std::string client_config, entity_config;
};

/// A server, unless one runs already, N entities in a process of their own (crowd.hpp), and a client that holds all of
/// them. Throws std::runtime_error with the log where something does not start.
class AxonCrowd {
  public:
    AxonCrowd(const std::filesystem::path& programs, const std::filesystem::path& folder, std::size_t n,
              const Running* running = nullptr);
    Board& board() { return board_; }
    client::Client& client() { return *client_; }
    const std::vector<std::string>& names() const { return names_; }
    const std::vector<client::CheckOut>& held() const { return held_; }

  private:
    Board board_;
    std::unique_ptr<Child> server_, crowd_;
    std::unique_ptr<client::Client> client_;
    std::vector<std::string> names_;
    std::vector<client::CheckOut> held_;
};

/// For the results: what they were measured on.
nlohmann::json machine();

}  // namespace axon::bench
