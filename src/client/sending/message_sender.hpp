// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "client/base/lanes.hpp"
#include "client/base/server_link.hpp"
#include "client/connection/send_queue.hpp"
#include "client/direct/direct_links.hpp"
#include "client/direct/direct_sending.hpp"
#include "common/clock.hpp"
#include "common/refusal.hpp"
#include "common/snapshot.hpp"

namespace axon::client {

/// The largest message that shares a system call with others: a larger one gains nothing by it. With the
/// overhead that admission counts.
inline constexpr std::size_t kTogetherBytes = 4 * 1024 + kMessageOverhead;
/// Messages that follow each other sooner than this are a burst: sending one takes 10 to 20 us.
inline constexpr Duration kFast = std::chrono::microseconds{100};
/// What the sending thread is left before callers send for themselves again: about thirty small messages.
inline constexpr std::size_t kLeftToSender = 32 * 1024;

/// Sends the messages of SessionCore in the core's order, over the direct path of an entity or through the
/// servers. It sends from the caller's thread or, in a burst, from the sending thread.
///
/// Where in the flow: between SessionCore and the connections. Its owner uses the core under a lock
/// (Departure): then the core calls the functions of ServerLink, which put messages in order. After the use
/// collect() says, still under that lock, what is to leave, and depart() sends it without the lock.
///
/// A burst: a thread that sends again within kFast, while nothing has come from the servers or an entity and
/// nobody waits for an answer (breakBurst), leaves what is small to the sending thread. That thread takes all
/// messages that have come until then and writes consecutive small ones as one batch. From kLeftToSender on
/// the callers write again.
///
/// Threads: the functions of the first two groups under the lock of the core; the others on any thread. One
/// thread at a time sends, under this object's own lock, so that the core's order is the order on the wire; a
/// thread sends no further than its own message, and waits for no server. Failure: what is sent without a
/// session is dropped. Bound: that of admit().
class MessageSender final : public ServerLink {
  public:
    /// `wake`: the sending thread is to call sendAll(). `lively`: a direct path was idle and is not; let it
    /// beat.
    MessageSender(const Clock& clock, const DirectLinks& links, std::function<void()> wake,
                  std::function<void()> lively);

    // What the core gives to send.
    void sendToEntity(const Header& head, std::string bytes) override;
    void sendToEntityDataSeq(const Header& head, std::string bytes) override;
    void sendRequest(const Header& head, std::string bytes) override;
    void sendReset(const Header& head) override;
    void sendClear(const Header& head) override;
    void keepAlive(std::int64_t sequence, bool busy) override { beat_ = Beat{sequence, busy}; }

    // Under the core's lock, too.
    /// The mark of a direct path: what its entity is sent after it goes by the path.
    void sendMark(const Header& head, std::string bytes, std::shared_ptr<DirectLink> link,
                  std::shared_ptr<DirectPath> path);
    /// Something has come, or somebody waits for the answer to what is being put: the next message is no
    /// burst.
    void breakBurst() { sent_at_ = {}; }
    /// Forgets what has not been sent: the session is lost.
    void forget() { queue_.clear(); }
    /// The sign of life that the core wants sent, once. It goes by the signal lane, so it is not this
    /// object's.
    struct Beat {
        std::int64_t sequence;
        bool busy;
    };
    std::optional<Beat> takeBeat() { return std::exchange(beat_, std::nullopt); }
    /// What has been put since the last collect(). `here`: the thread may send it itself.
    struct Leaving {
        std::uint64_t last = 0;  ///< number of the last message; 0 = there is none
        bool here = false;       ///< by this thread
    };
    Leaving collect(bool here);

    // Without it.
    void depart(Leaving leaving);
    /// The turn of the sending thread: what ended direct paths have left, and all that there is.
    void sendAll();
    /// All that has been put, without looking for ended paths.
    void flush() { send(queue_.last()); }
    /// The session whose data lane takes what is put from now on; null: none. What was put before does not go
    /// by it.
    void connect(std::shared_ptr<const DataLane> lane) { lane_.store(std::move(lane)); }

    /// OVERLOADED while the server does not read, TOO_LARGE for what no message holds. Binding under the
    /// core's lock, in one with the sending, so that several threads do not share the last place.
    Refusal admit(std::size_t bytes) const;
    /// Until little waits for the server, or the session ends, or `wait` is over.
    void awaitRoom(Duration wait) const;

  private:
    void put(Operation kind, const Header& head, std::string bytes);
    bool leavesToSender();
    void send(std::uint64_t ticket);

    const Clock& clock_;
    const DirectLinks& links_;
    const std::function<void()> wake_;

    // Guarded by the core's lock:
    std::uint64_t put_ = 0;      // number of the message that was put last, until it is collected
    std::size_t put_bytes_ = 0;  // and its size
    TimePoint sent_at_{};        // of the last one that a caller sent, unless the burst was broken since
    std::optional<Beat> beat_;

    SendQueue<Outgoing> queue_;  // put into under the core's lock
    Snapshot<DataLane> lane_{nullptr};
    std::mutex mutex_;      // the order of queue_ is that on the wire
    DirectSending direct_;  // guarded by mutex_
};

}  // namespace axon::client
