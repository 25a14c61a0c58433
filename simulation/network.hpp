// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <deque>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "simulation/timeline.hpp"

namespace axon::simulation {

class Connection;

/// The way between two hosts, which many connections share. Direction 0 leads to the server's side.
struct Path {
    Duration fastest = std::chrono::microseconds{60};
    Duration slowest = std::chrono::microseconds{400};
    std::array<bool, 2> cut{};  ///< silently: nothing arrives, nobody is told
    std::array<TimePoint, 2> changed_at{};
    std::vector<Connection*> connections;
};

/// One TCP connection: what is sent arrives once and in order, or the connection ends. A silent cut holds
/// back what is sent, and what is held arrives when the cut is mended (retransmission), unless an end has
/// given up meanwhile. An end may read slowly; then what was sent is not written yet. Ends are processes; the
/// end of a dead one is closed by its kernel, or falls silent when its host lost power. Owned by Network
/// until the end of the run.
class Connection {
  public:
    Connection(Timeline& timeline, Dice& dice, Path& path, Process& client, Process& server)
        : timeline_(timeline), dice_(dice), path_(path), ends_{&client, &server} {}

    /// Called at an end when it learns that the other one, or the network, has closed the connection.
    void onClosed(Process& at, std::function<void()> told) { told_[side(at)] = std::move(told); }

    /// False: the buffers between the two are full, and onWritten() tells when there is room for it.
    template <class Deliver>
    bool send(Process& from, Deliver deliver) {
        const auto from_side = side(from);
        if (closed_[from_side]) return true;
        const auto to = 1 - from_side;
        auto arrive = [this, to, deliver = std::move(deliver)] {
            noteRead(to);
            if (!closed_[to]) deliver();
        };
        if (path_.cut[direction(from_side)])
            held_[to].push_back(std::move(arrive));
        else
            timeline_.at(arrival(to), *ends_[to], std::move(arrive));
        return ++unread_[to] <= kBuffered;
    }
    /// Called at an end, in the order of sending, for each message that send() has returned false for.
    void onWritten(Process& at, std::function<void()> written) { written_[side(at)] = std::move(written); }
    /// From now on this end takes so long for each message; zero = no time.
    void readSlowly(const Process& at, Duration each) { pace_[side(at)] = each; }
    /// A sign of life that carries nothing: over a quiet connection it arrives at once, which spares an
    /// event.
    template <class Deliver>
    void beat(Process& from, Deliver deliver) {
        const auto from_side = side(from);
        const auto to = 1 - from_side;
        if (closed_[from_side] || closed_[to]) return;
        if (!path_.cut[direction(from_side)] && last_[to] <= timeline_.now() && ends_[to]->running() &&
            extra == Duration{}) {
            deliver();
            return;
        }
        send(from, std::move(deliver));
    }

    bool openAt(const Process& at) const { return !closed_[side(at)]; }
    bool toldClosed(const Process& at) const { return closed_[side(at)]; }
    /// Ends it here; the other end learns of it after all that was sent before.
    void close(Process& by);
    /// Nobody listens at the other end: `from` is told so, if the way is whole.
    void refused(Process& from);
    /// Both ends learn that it is broken, soon: what arrives later than that is lost.
    void breakDown();
    /// The process at that end is dead. Without a notice the other end hears nothing until restarted() .
    void endDied(const Process& dead, bool notice);
    void restarted(const Process& again);
    /// The path is whole again in a direction.
    void mended(std::size_t direction);

    bool joins(const Process& process) const { return ends_[0] == &process || ends_[1] == &process; }
    std::size_t held() const { return held_[0].size() + held_[1].size(); }

    Duration extra{};  ///< at most so much is added to each message's way

  private:
    std::size_t side(const Process& process) const { return ends_[0] == &process ? 0 : 1; }
    static std::size_t direction(std::size_t from_side) { return from_side; }
    static constexpr std::size_t kBuffered = 16;  ///< messages that the sockets of both ends take
    TimePoint arrival(std::size_t to);
    void noteRead(std::size_t at);
    void notice(std::size_t to);

    Timeline& timeline_;
    Dice& dice_;
    Path& path_;
    std::array<Process*, 2> ends_;
    std::array<bool, 2> closed_{};
    std::array<bool, 2> silent_death_{};
    std::array<TimePoint, 2> last_{};  ///< when the last message to that end arrives
    std::array<std::deque<std::function<void()>>, 2> held_;
    std::array<std::function<void()>, 2> told_;
    std::array<Duration, 2> pace_{};
    std::array<std::size_t, 2> unread_{};  ///< messages under way to that end
    std::array<std::function<void()>, 2> written_;
};

/// All connections of a run.
class Network {
  public:
    Network(Timeline& timeline, Dice& dice) : timeline_(timeline), dice_(dice) {}
    Connection& connect(Path& path, Process& client, Process& server);
    void died(const Process& process, bool notice);
    void restarted(const Process& process);
    void cut(Path& path, bool up, bool down);
    void mend(Path& path);
    std::size_t held() const;

  private:
    Timeline& timeline_;
    Dice& dice_;
    std::vector<std::unique_ptr<Connection>> connections_;
};

}  // namespace axon::simulation
