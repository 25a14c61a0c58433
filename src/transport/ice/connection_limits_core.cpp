// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/connection_limits_core.hpp"

#include <algorithm>

namespace axon::transport {
namespace {

constexpr std::chrono::seconds kTellAgain{10};
constexpr std::size_t kAddressesTold = 8;
constexpr const char* kOtherAddresses = "other addresses";

struct Stranger {
    std::uint64_t number;
    std::uint64_t id;
    const std::string* address;
};

std::string seconds(Duration time) {
    return std::to_string(std::chrono::duration_cast<std::chrono::seconds>(time).count()) + " s";
}

/// Whoever is on this machine may come from any address of 127.0.0.0/8.
std::string groupOf(const std::string& address) {
    return address.rfind("127.", 0) == 0 ? "127.0.0.0/8" : address;
}

}  // namespace

ConnectionBounds ConnectionBounds::fittingInto(std::size_t descriptors) const {
    auto its = *this;
    its.strangers = std::max<std::size_t>(1, std::min(strangers, descriptors / 4));
    its.strangers_of_one_address =
        std::max<std::size_t>(1, std::min(strangers_of_one_address, its.strangers / 2));
    return its;
}

ConnectionLimitsCore::Verdict ConnectionLimitsCore::look(const std::vector<Seen>& connections, TimePoint now,
                                                         const Close& close) {
    Verdict verdict;
    const auto count = [&](const std::string& reason, const std::string& address) {
        const bool room = untold_.size() < kAddressesTold || untold_.contains({reason, address});
        ++untold_[{reason, room ? address : kOtherAddresses}];
    };
    const auto closeOne = [&](std::uint64_t id, const std::string& address, const std::string& reason) {
        if (!close(id)) return;
        known_.at(id).closed = true;
        count(reason, address);
    };

    for (auto& [id, known] : known_) known.there = false;
    std::map<std::string, std::vector<Stranger>> strangers;  // of each address, the oldest last
    for (const auto& one : connections) {
        const auto [at, is_new] = known_.try_emplace(one.id, Known{.since = now, .number = count_});
        count_ += is_new ? 1 : 0;
        auto& known = at->second;
        known.there = true;
        if (known.closed || one.peer == Peer::Exempt) continue;
        if (one.peer == Peer::HasSession) {
            if (one.silent_for <= bounds_.silence) continue;
            known.closed = true;
            verdict.silent.push_back(one.id);
            count("nothing has come over a session's connection for " + seconds(bounds_.silence),
                  one.address);
        } else if (now - known.since > bounds_.to_log_in) {
            closeOne(one.id, one.address, "no session in " + seconds(bounds_.to_log_in));
        } else {
            strangers[groupOf(one.address)].push_back({known.number, one.id, &one.address});
        }
    }
    std::erase_if(known_, [](const auto& one) { return !one.second.there; });

    std::size_t left = 0;
    const auto closeOldest = [&](std::vector<Stranger>& of, const std::string& reason) {
        closeOne(of.back().id, *of.back().address, reason);
        of.pop_back();
    };
    for (auto& [address, open] : strangers) {
        std::sort(open.begin(), open.end(),
                  [](const auto& one, const auto& other) { return one.number > other.number; });
        while (open.size() > bounds_.strangers_of_one_address)
            closeOldest(open, "more than " + std::to_string(bounds_.strangers_of_one_address) +
                                  " of one address without a session");
        left += open.size();
    }
    // Of two addresses with as many, the one whose oldest is older.
    const auto hasLess = [](const auto& one, const auto& other) {
        const auto& [a, its] = one;
        const auto& [b, others] = other;
        return its.size() != others.size() ? its.size() < others.size()
                                           : !its.empty() && its.back().number > others.back().number;
    };
    for (; left > bounds_.strangers; --left)
        closeOldest(std::max_element(strangers.begin(), strangers.end(), hasLess)->second,
                    "more than " + std::to_string(bounds_.strangers) + " of all addresses without a session");
    verdict.strangers = left > 0;
    tell(verdict, now);
    return verdict;
}

void ConnectionLimitsCore::tell(Verdict& verdict, TimePoint now) {
    if (untold_.empty() || now < tell_from_) return;
    tell_from_ = now + kTellAgain;
    for (const auto& [what, count] : untold_)
        verdict.notes.push_back(std::to_string(count) + (count == 1 ? " connection" : " connections") +
                                " from " + what.second + (count == 1 ? " was" : " were") +
                                " closed: " + what.first);
    untold_.clear();
}

}  // namespace axon::transport
