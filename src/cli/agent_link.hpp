// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <filesystem>
#include <mutex>
#include <optional>
#include <string>

#include "cli/session.hpp"
#include "common/descriptor.hpp"

// The way to an agent: where it is, and how lines of JSON go to and fro. README.md describes the protocol.
namespace axon::cli {

/// The longest line on the agent's socket; who sends a longer one is cut off.
inline constexpr std::size_t kLongestLine = std::size_t{1} << 20U;

/// The files of the agent of one server address, in a directory that is only this user's.
struct AgentPlace {
    std::filesystem::path directory, socket, lock, log;
};

/// $XDG_RUNTIME_DIR/axon, or /tmp/axon-UID.
std::filesystem::path runtimeDirectory();
/// PERMISSION_DENIED with the fix when it is not a directory of this user with mode 0700: in /tmp anybody
/// may have made it first. NOT_FOUND is no refusal: `exists` tells.
Refusal checkRuntimeDirectory(const std::filesystem::path& directory, bool& exists);
/// Where the agent for this server is, or would be. Makes the directory.
Result<AgentPlace> agentPlace(const std::string& server);

/// Sends one line; false when the peer is gone or does not read for the socket's time-out.
bool sendLine(int fd, const Json& json);

/// Collects what arrives until it is a line. Not thread-safe.
class LineReader {
  public:
    /// Adds what recv gave. False when the line is too long.
    bool feed(const char* bytes, std::size_t count);
    std::optional<std::string> next();

  private:
    std::string buffer_;
};

/// A connection to an agent that runs.
class AgentLink {
  public:
    /// Nothing when there is none; its process must be of the same user.
    static std::optional<AgentLink> open(const std::filesystem::path& socket);
    explicit AgentLink(Descriptor fd) : fd_(std::move(fd)) {}

    enum class Ending {
        Done,       ///< see exit
        Elsewhere,  ///< the agent does not hold that entity
        NoAnswer,   ///< it did not take the request in time; nothing was begun that can still be seen
        Broken,     ///< it went away in the middle
    };
    struct Outcome {
        Ending ending;
        int exit = kDone;
    };
    Outcome request(const std::string& verb, const Json& args, Events& events,
                    std::chrono::milliseconds accepted_within);
    /// The agent's process; 0 when the kernel does not say.
    int process() const;
    /// Any thread: what Ctrl-C is to a verb in this process.
    void interrupt() const;

  private:
    Descriptor fd_;
    LineReader reader_;
};

}  // namespace axon::cli
