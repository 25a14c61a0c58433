// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "axon_crowd.hpp"
#include "board.hpp"

namespace axon::bench {

/// What is sent to each receiver of a batch.
enum class Message : std::uint8_t {
    Stop,   ///< 60 bytes where a peer sends it; of Axon the call
    Small,  ///< 60 bytes of data
    Data,   ///< chapter 5's 35,000 bytes of data
};
inline constexpr Kind kindOf(Message message) {
    return message == Message::Stop ? Kind::Stop : Kind::Data;
}
inline constexpr std::size_t bytesOf(Message message) {
    return message == Message::Data ? kDataBytes : kSmallBytes;
}
const char* nameOf(Message message);

/// One system under test, started by its constructor with N receivers: all of them in one process, but Axon's
/// with direct paths, with robot applications, behind a radio link, or where descriptors are few.
class Subject {
  public:
    virtual ~Subject() = default;
    virtual Board& board() = 0;
    /// Where robot applications behind the receivers note what reaches their callbacks; null where there are
    /// none.
    virtual Board* robots() { return nullptr; }
    /// A message to each receiver, back to back. `bytes` is content(bytesOf(message)) with its number set.
    /// called[i] becomes the time at which the call for receiver i began.
    virtual void send(Message message, const std::string& bytes, std::vector<std::int64_t>& called) = 0;
    /// Whether what arrives carries that number. If not, arrivals are counted.
    virtual bool numbered(Kind) const { return true; }
    /// How many receivers have lost their connection since the start, as far as the system tells.
    virtual std::size_t disconnected() const { return 0; }
    /// How many receivers are reached another way now than the system's name says.
    virtual std::size_t relayed() const { return 0; }
    /// What of it has ended by itself and why; empty while its server and its receivers run.
    virtual std::string ended() const { return {}; }
};

/// A system by its name: how to start it, or why it is skipped here.
struct Peer {
    std::string name, package;
    std::string missing;  ///< the program that is not there; empty when it can be started
    std::unique_ptr<Subject> (*start)(const std::filesystem::path& folder, std::size_t n);
    std::string what;  ///< for people
};
/// In the order in which they are measured; the first is Axon.
const std::vector<Peer>& peers();

class Report;
/// "versions" and "skipped" of a report, of the peers (and cyclonedds) that an experiment is to have; says
/// which are skipped and how to fix that. Every experiment calls it, with none too.
void reportPeers(Report& report, const std::vector<std::string>& wanted);
/// One more in "skipped", which was to be there and gave nothing.
void reportSkipped(Report& report, const std::string& peer, const std::string& package,
                   const std::string& reason);

/// Axon through servers that run already.
std::unique_ptr<Subject> axonThrough(const Running& running, const std::filesystem::path& folder,
                                     std::size_t n);

/// Axon relayed, each entity with a robot application and a real Entity Interfacer: in peers() it is not, for
/// the others would be measured beside thousands of applications that beat.
const Peer& axonRobots();
/// Which of Axon's variants a peer of this name is; nothing of another system's.
std::optional<Variant> variantOf(const std::string& name);
/// Axon with the second half of its entities behind a radio link.
std::unique_ptr<Subject> axonWithRadio(const Radio& radio, const std::filesystem::path& folder, std::size_t n,
                                       Variant variant);
/// Axon through a server of this run (and its radio link, likewise), with entities PREFIX-0 … besides others.
std::unique_ptr<Subject> axonOf(const AxonServer& server, const std::filesystem::path& folder,
                                const std::string& prefix, std::size_t n, Variant variant);

}  // namespace axon::bench
