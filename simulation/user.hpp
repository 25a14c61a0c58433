// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <functional>
#include <string>
#include <vector>

#include "simulation/client_station.hpp"

namespace axon::simulation {

/// Somebody at a client who does this and that: checks out, waits, asks the holder and is asked, takes by
/// force (an administrator), runs tasks, pauses, cancels, stops, rearms, resets, clears, releases; and after
/// the death of the client's process resumes what it held, with the tickets it has on its disk. From
/// `retires_at` on only releases.
class User {
  public:
    User(Timeline& timeline, ClientStation& client, std::uint64_t seed, TimePoint retires_at);
    /// Questions that nobody has answered; a client that died has none.
    int open() const { return open_; }
    /// Leases that a later life of the client has resumed.
    std::uint64_t ticketsResumed() const { return tickets_resumed_; }
    /// Somebody lies in wait: called once, when this user next checks something out or runs a task.
    std::function<void()> ambush;
    /// Called when a request was answered later than the library promises.
    std::function<void(const std::string&)> complain;

  private:
    void comeBack(Duration in);
    void act();
    void retire();
    void spring();
    void checkOut();
    void useTickets();
    void answerHandOver(const client::Held& held);
    void work(const client::Held& held);
    client::Done answered();

    Timeline& timeline_;
    ClientStation& client_;
    Dice dice_;
    const TimePoint retires_at_;
    int open_ = 0;
    std::uint64_t life_ = 0;
    std::deque<Id128> tasks_;
    std::vector<client::LeaseTicket> tickets_;
    std::uint64_t tickets_resumed_ = 0;
};

/// The one who comes when all faults are over, and must be able to use everything: each entity is there, can
/// be checked out, rearmed where it is latched, runs a task to its end, and is released.
class Visitor {
  public:
    Visitor(Timeline& timeline, ClientStation& client, std::size_t entities);
    bool content() const { return done_ == wanted_; }
    /// What is still wrong.
    std::string complaint() const;

  private:
    void look();
    struct Visit {
        std::string entity;
        bool asked = false;
        bool done = false;
        std::optional<client::Held> held;
        std::optional<Id128> task;
        std::string last;
    };
    Timeline& timeline_;
    ClientStation& client_;
    const std::size_t wanted_;
    std::size_t done_ = 0;
    std::vector<Visit> visits_;
};

}  // namespace axon::simulation
