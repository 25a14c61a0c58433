// SPDX-License-Identifier: MIT
#pragma once
#include <poll.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/descriptor.hpp"
#include "common/frame.hpp"
#include "common/refusal.hpp"
#include "host/port_range.hpp"

namespace axon::proto {
class Hello;
class Refusal;
}  // namespace axon::proto

namespace axon {

/// The connections whose peer has not yet proved to be our Entity Manager: from the listening socket until
/// both lanes of one Entity Manager are welcome (docs/reference/ei-link.md).
///
/// States of a connection: silent; half, once its Hello for the signal lane is welcome; gone, as part of a
/// link or because it was refused or dropped. One at most is half, and while it is, other Entity Managers are
/// refused. Threads: the watch thread; listen() before that has started. No lock. Failure: whoever is refused
/// is told why, as far as the socket takes it at once, and the connection closes. Bounded: kMax connections,
/// each for a second; when there are more, the oldest silent one is dropped.
class Handshakes {
  public:
    static constexpr std::size_t kMax = 32;
    static constexpr std::uint32_t kProtocol = 1;

    /// The two connections of an Entity Manager that is welcome on both lanes, and what it has said of
    /// itself.
    struct Pair {
        Descriptor signal;
        FrameReader signal_reader;
        Descriptor data;
        FrameReader data_reader;
        std::string manager;
        std::string release;  ///< that it has told, whatever that is; bounded by its frame
        std::chrono::milliseconds watchdog_busy, watchdog_idle;
    };
    /// What it asks of whoever owns the links.
    class Others {
      public:
        virtual ~Others() = default;
        /// Whether the last call of the stop callback threw: whoever links takes it that the robot has
        /// stopped.
        virtual bool stopFailed() const = 0;
        /// The Entity Manager that is linked now.
        virtual std::optional<std::string> linkedWith() const = 0;
        virtual void linkWith(Pair pair) = 0;
    };

    /// `application` and `instance` are those that a Hello must name.
    Handshakes(const Clock& clock, Others& others, std::string application, std::string instance)
        : clock_(clock),
          others_(others),
          application_(std::move(application)),
          instance_(std::move(instance)) {}

    /// Listens on the first free port of the range, which it returns. Throws Misconfiguration where there is
    /// none, or the address is not of this machine.
    std::uint16_t listen(const LinkPorts& where);
    /// Appends what poll(2) is to wait for; returns the time at which handle() is to be called at the latest,
    /// TimePoint::max() = not as things are.
    TimePoint awaitAt(TimePoint now, std::vector<pollfd>& wait) const;
    /// `waited` is what awaitAt() has appended since the last call. True: more connections may wait than were
    /// accepted, so poll again at once.
    bool handle(std::span<const pollfd> waited);
    /// Drops all of them, and listens no longer.
    void close();

  private:
    struct Pending {
        Descriptor socket;
        FrameReader reader{kHelloMax};
        TimePoint deadline;
        std::string nonce, manager, release;  // once its Hello for the signal lane is accepted
        std::chrono::milliseconds busy{0}, idle{0};
    };
    static constexpr std::size_t kHelloMax = 4096;

    bool accept();
    /// True when the connection is to be forgotten here: dropped, or part of a link.
    bool readHello(Pending& pending);
    bool onHello(Pending& pending, const proto::Hello& hello);
    void refuse(Pending& pending, RefusalCode code, const std::string& message);
    void welcome(Pending& pending, const proto::Hello& hello, const proto::Refusal* refusal);

    const Clock& clock_;
    Others& others_;
    const std::string application_, instance_;
    LinkUsers users_;
    Descriptor listener_;
    std::deque<Pending> pending_;
    TimePoint accept_again_{};
};

}  // namespace axon
