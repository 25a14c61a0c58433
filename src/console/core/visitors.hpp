// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"

namespace axon::console {

/// Who has logged in to the console, and the tickets with which their pages open sessions.
///
/// A log-in gives a key of 128 random bits, which the browser keeps as a cookie that scripts cannot read, for
/// twelve hours, until log-out, or until the user is removed or has a new password. For each session a page
/// gets a ticket, which is good once, for half a minute: a script that was smuggled into the page cannot take
/// anything away that outlasts the visit.
///
/// They are known by their digests, so how long a look-up takes says nothing about those that there are.
///
/// Threads: any. Bounds: of one user 32 log-ins and 16 tickets, of all users 4096 and 1024; the oldest give
/// way. Nothing survives the server's end.
class Visitors {
  public:
    static constexpr std::chrono::hours kVisit{12};
    static constexpr std::chrono::seconds kTicket{30};
    static constexpr std::size_t kVisitsMax = 4096;
    static constexpr std::size_t kVisitsOfOneMax = 32;
    static constexpr std::size_t kTicketsMax = 1024;
    static constexpr std::size_t kTicketsOfOneMax = 16;

    Visitors(const Clock& clock, RandomSource& random) : clock_(clock), random_(random) {}

    /// The key of a new visit: 32 hexadecimal digits.
    std::string enter(const std::string& user);
    /// Nothing for a key that is unknown, or was once.
    std::optional<std::string> userOf(std::string_view key);
    void leave(std::string_view key);
    /// A ticket for this user: 32 hexadecimal digits.
    std::string ticket(const std::string& user);
    /// The user's keys and tickets are void: the user is another one now, or has another password.
    void forget(const std::string& user);
    /// Of all whose keys or tickets are good.
    std::vector<std::string> users();
    /// Whose ticket it was; it is no more.
    std::optional<std::string> redeem(std::string_view ticket);

  private:
    /// What is known by a key, oldest first.
    class Book {
      public:
        Book(Duration life, std::size_t most, std::size_t most_of_one)
            : life_(life), most_(most), most_of_one_(most_of_one) {}
        std::string add(const std::string& user, TimePoint now, RandomSource& random);
        std::optional<std::string> find(std::string_view key, TimePoint now);
        void remove(std::string_view key);
        void removeAll(const std::string& user);
        void addUsers(std::set<std::string>& to, TimePoint now);

      private:
        using Digest = std::array<unsigned char, 32>;
        struct Entry {
            std::string user;
            TimePoint ends;
        };
        static Digest digestOf(std::string_view key);
        void forget(const Digest& key);
        void expire(TimePoint now);

        const Duration life_;
        const std::size_t most_, most_of_one_;
        std::map<Digest, Entry> entries_;
        std::deque<Digest> order_;  // all live for the same time, so the oldest ends first
        std::map<std::string, std::deque<Digest>> of_user_;
    };

    const Clock& clock_;
    RandomSource& random_;
    std::mutex mutex_;
    Book visits_{kVisit, kVisitsMax, kVisitsOfOneMax};      // guarded by mutex_
    Book tickets_{kTicket, kTicketsMax, kTicketsOfOneMax};  // guarded by mutex_
};

}  // namespace axon::console
