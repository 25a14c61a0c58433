// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/ids.hpp"
#include "common/routed.hpp"
#include "common/snapshot.hpp"
#include "datagrams/stop_datagram.hpp"

namespace axon::datagrams {

/// Decides which datagram is a stop that the Entity Manager obeys.
///
/// Where in the flow: between the Entity Manager's datagram socket and the way that every stop takes. A
/// datagram is accepted when its MAC is right under the key of the *present* lease and its sender has held
/// that lease: a resume makes another session the holder of the same lease and key, so the last few holders
/// count, each with a window of its own. A stop is *new* once; its copies are *again*, to be acknowledged and
/// not executed; what is older than the window is refused, since nobody knows any more whether it was
/// executed. States: nobody holds the lease (everything is refused), held. A new lease begins with empty
/// windows: nothing is accepted under two keys. Threads: hold() and end() on the strand, they leave an
/// immutable snapshot; judge() on the datagram thread alone. Failure: refused, without an answer, and
/// counted.
class StopSentry {
  public:
    static constexpr std::size_t kHoldersKept = 4;
    static constexpr std::int64_t kWindow = 64;  ///< sequence numbers behind the newest

    enum class Verdict : std::uint8_t { Refused, New, Again };
    struct Judged {
        Verdict verdict = Verdict::Refused;
        StopDatagram datagram;
        Sender sender;    ///< as the servers vouched for it when the lease was granted
        std::string key;  ///< to answer under
    };
    struct Counters {
        std::uint64_t accepted = 0;
        std::uint64_t again = 0;
        std::uint64_t unreadable = 0;  ///< not a datagram of this version
        std::uint64_t foreign = 0;  ///< of another lease, another key, or somebody who has not held this one
        std::uint64_t old = 0;      ///< behind the window
    };

    /// Granted, or resumed by another session. Repeating it changes nothing.
    void hold(LeaseNumber lease, std::string_view key, const Sender& holder);
    /// The lease has ended.
    void end();

    Judged judge(std::string_view bytes);
    /// Any thread.
    Counters counters() const;

  private:
    struct Holder {
        Id128 id;
        Sender sender;
    };
    struct Authority {
        LeaseNumber lease;
        std::string key;
        std::vector<Holder> holders;  // newest first
    };
    struct Window {
        Id128 sender;
        std::int64_t newest = 0;
        std::uint64_t seen = 0;  // bit n: newest - n has been
    };
    Window& windowOf(const Authority& authority, const Id128& sender);

    Snapshot<Authority> authority_{nullptr};
    // Confined to the strand.
    std::shared_ptr<const Authority> told_;
    // Confined to the datagram thread.
    LeaseNumber windows_of_;
    std::vector<Window> windows_;

    std::atomic<std::uint64_t> accepted_{0}, again_{0}, unreadable_{0}, foreign_{0}, old_{0};
};

}  // namespace axon::datagrams
