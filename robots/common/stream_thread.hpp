// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <span>
#include <string>

#include "robots/common/byte_stream.hpp"

namespace axon::robots {

/// The thread that keeps one link to a device: opens it, gives what arrives to a session, ticks the session,
/// and after the session has closed opens the link again, for ever (after 100 ms, doubling up to 2 s).
///
/// Between a protocol's session, which does no I/O, and a ByteStream. Threads: one of its own, on which all
/// of Session is called; write() may be called from any. Failure: the session's end() or unreachable(), with
/// the reason. A link that does not take bytes at once is given up.
class StreamThread {
  public:
    class Session {
      public:
        virtual ~Session() = default;
        /// There is a link. Its speed can be asked for and changed.
        virtual void begin(TimePoint now) = 0;
        virtual void receive(std::span<const std::uint8_t> bytes, TimePoint now) = 0;
        /// At least every 25 ms while there is a link.
        virtual void tick(TimePoint now) = 0;
        /// The session is over, and the link is to be closed.
        virtual bool closed() const = 0;
        /// The link is gone; nothing to do for a session that is over.
        virtual void end(const std::string& reason) = 0;
        /// The link could not be opened.
        virtual void unreachable(const std::string& reason) = 0;
    };

    /// `peer` is the word for the device in reasons: "the robot". `session` must outlive finish().
    StreamThread(StreamOpener open, Session& session, std::string peer, std::shared_ptr<const Clock> clock);
    ~StreamThread();
    StreamThread(const StreamThread&) = delete;
    StreamThread& operator=(const StreamThread&) = delete;

    /// Once.
    void start();
    /// Ends the session and joins the thread; nothing of Session is called any more. Not from within Session.
    void finish();
    bool finishing() const;

    /// Any thread: written by the caller, one write that does not wait, under a lock. False without a link,
    /// and for a link that does not take the bytes.
    bool write(std::span<const std::uint8_t> bytes);
    /// The session reached the device: the next loss is followed by the shortest pause again. From within
    /// Session.
    void succeeded();
    /// As in ByteStream, of the present link. From within Session.
    LineSpeed speed() const;
    bool setSpeed(int baud);

  private:
    class Loop;
    std::unique_ptr<Loop> loop_;
};

}  // namespace axon::robots
