// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <sys/uio.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/descriptor.hpp"

/// Plain TCP on loopback, for the peers whose protocol is spoken here: NATS and the raw router. What fails
/// throws std::system_error.
namespace axon::bench::tcp {

/// A connection with TCP_NODELAY; closed with this object.
class Connection {
  public:
    explicit Connection(std::uint16_t port);
    explicit Connection(Descriptor accepted) : fd_(std::move(accepted)) { prepare(); }

    int fd() const { return fd_.get(); }
    /// All of them in one system call where the socket takes that; waits while it does not.
    void write(std::initializer_list<std::string_view> parts) const;
    /// What is there, at most this much; with `wait` at least one byte. 0 = nothing there; throws when the
    /// peer has closed.
    std::size_t read(char* to, std::size_t most, bool wait) const;
    /// Waits for all of it.
    void readAll(char* to, std::size_t size) const;

  private:
    void prepare() const;
    Descriptor fd_;
};

bool listens(std::uint16_t port);
/// Listens on a free port of 127.0.0.1.
Descriptor listen(std::uint16_t& port);

/// Takes whole messages from the beginning of what was received, and returns how many bytes they were.
using Consume = std::function<std::size_t(std::string_view)>;

/// A connection's input, cut into messages. What is left of a message waits for its rest.
class Inbox {
  public:
    /// Reads once, into `buffer`, which connections may share, and consumes. The buffer grows where a message
    /// is longer.
    void take(const Connection& from, std::vector<char>& buffer, const Consume& consume);

  private:
    std::string rest_;
};

}  // namespace axon::bench::tcp
