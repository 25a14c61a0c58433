// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/connection_limits_core.hpp"

#include <algorithm>
#include <map>
#include <utility>

namespace axon::transport {
namespace {

struct Stranger {
    std::uint64_t number;
    std::uint64_t id;
};

std::string seconds(Duration time) {
    return std::to_string(std::chrono::duration_cast<std::chrono::seconds>(time).count()) + " s";
}

}  // namespace

ConnectionLimitsCore::Verdict ConnectionLimitsCore::look(const std::vector<Seen>& connections,
                                                         TimePoint now) {
    Verdict verdict;
    std::map<std::pair<std::string, std::string>, std::size_t> closed;  // address and reason
    const auto close = [&](std::uint64_t id, const std::string& address, std::string reason) {
        known_.at(id).closed = true;
        verdict.close.push_back(id);
        ++closed[{address, std::move(reason)}];
    };

    for (auto& [id, known] : known_) known.there = false;
    std::map<std::string, std::vector<Stranger>> strangers;  // of each address
    for (const auto& one : connections) {
        const auto [at, is_new] = known_.try_emplace(one.id, Known{.since = now, .number = count_});
        count_ += is_new ? 1 : 0;
        auto& known = at->second;
        known.there = true;
        if (known.closed) continue;
        if (one.has_session) {
            if (one.silent_for > bounds_.silence)
                close(one.id, one.address,
                      "nothing has come over a session's connection for " + seconds(bounds_.silence));
        } else if (now - known.since > bounds_.to_log_in) {
            close(one.id, one.address, "no session in " + seconds(bounds_.to_log_in));
        } else {
            strangers[one.address].push_back({known.number, one.id});
        }
    }
    std::erase_if(known_, [](const auto& one) { return !one.second.there; });

    std::size_t left = 0;
    const auto closeOldest = [&](auto& its, const std::string& reason) {
        close(its.second.back().id, its.first, reason);
        its.second.pop_back();
    };
    for (auto& its : strangers) {
        auto& [address, open] = its;
        std::sort(open.begin(), open.end(),
                  [](const auto& one, const auto& other) { return one.number > other.number; });
        while (open.size() > bounds_.strangers_of_one_address)
            closeOldest(
                its, "more than " + std::to_string(bounds_.strangers_of_one_address) + " without a session");
        left += open.size();
    }
    for (; left > bounds_.strangers; --left)
        closeOldest(*std::max_element(strangers.begin(), strangers.end(),
                                      [](const auto& one, const auto& other) {
                                          return one.second.size() < other.second.size();
                                      }),
                    "more than " + std::to_string(bounds_.strangers) + " of all addresses without a session");
    verdict.strangers = left > 0;
    for (const auto& [who, count] : closed)
        verdict.notes.push_back(std::to_string(count) + (count == 1 ? " connection" : " connections") +
                                " from " + who.first + (count == 1 ? " is" : " are") +
                                " closed: " + who.second);
    return verdict;
}

}  // namespace axon::transport
