// SPDX-License-Identifier: GPL-2.0-or-later
#include "beside_console.hpp"

#include <atomic>
#include <iostream>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <sstream>
#include <vector>

#include "axon_crowd.hpp"
#include "report.hpp"

namespace axon::bench {

namespace {

constexpr client::Seconds kConfirmed{2};

/// Counts the samples of streams, and the gaps in their numbers.
class Count {
  public:
    void take(std::size_t entity, std::uint64_t sequence) {
        const std::lock_guard lock(mutex_);
        ++arrived_;
        auto& before = newest_[entity];
        if (before != 0 && sequence > before + 1) left_out_ += sequence - before - 1;
        before = sequence;
    }
    nlohmann::json take() {
        const std::lock_guard lock(mutex_);
        return {{"arrived", std::exchange(arrived_, 0)}, {"left_out", std::exchange(left_out_, 0)}};
    }

  private:
    std::mutex mutex_;
    std::uint64_t arrived_ = 0, left_out_ = 0;
    std::map<std::size_t, std::uint64_t> newest_;
};

struct Stops {
    std::size_t first = 0, count = 1, n = 0;
    std::int64_t period_ns = 0;
};

nlohmann::json stop(client::Client& client, Entities& entities, const Stops& wish) {
    nlohmann::json receipts = nlohmann::json::array(), robots = nlohmann::json::array();
    auto due = nowNs();
    for (std::size_t k = 0; k < wish.n && sleepUntil(due); ++k, due += wish.period_ns) {
        const auto i = wish.first + k % wish.count;
        const auto& name = entities.names().at(i);
        const auto begin = nowNs();
        const auto answer = client.stop({name}, kConfirmed);
        const auto end = nowNs();
        if (!answer || answer->size() != 1 || !answer->front().confirmed()) {
            receipts.push_back(nullptr);
            robots.push_back(nullptr);
            if (!answer) std::cerr << "stop of " << name << ": " << answer.refusal().message << "\n";
            continue;
        }
        receipts.push_back(static_cast<double>(end - begin) / 1e6);
        const auto reached =
            (*entities.robots())[i].stops.of(static_cast<std::uint32_t>(answer->front().stop_generation));
        robots.push_back(reached < begin ? nlohmann::json()
                                         : nlohmann::json(static_cast<double>(reached - begin) / 1e6));
    }
    return {{"receipt_ms", receipts}, {"robot_ms", robots}};
}

nlohmann::json reached(Entities& entities, std::size_t i) {
    const auto& stops = (*entities.robots())[i].stops;
    const auto next = stops.next.load();
    return {{"at_ns", next == 0 ? nlohmann::json() : nlohmann::json(stops.of(next - 1))}};
}

}  // namespace

int runBesideConsole(const BesideConsole& wish) {
    Entities entities(wish.folder, "lab", wish.entities, wish.entity_server, nullptr, Variant::Robots,
                      wish.scans);
    Count count;
    const auto client = connectClient(wish.client_server);
    std::vector<std::shared_ptr<void>> watches;
    for (std::size_t i = 0; i < wish.entities; ++i)
        if (const auto there = client->waitFor(entities.names()[i], client::Seconds{10}); !there)
            throw std::runtime_error(there.refusal().message);
    for (std::size_t i = 0; i < wish.scans; ++i) {
        auto watched = client->watch(entities.names()[i], {}, [&count, i](const client::Sample& sample) {
            count.take(i, sample.sequence);
        });
        if (!watched) throw std::runtime_error(watched.refusal().message);
        watches.push_back(std::move(watched).value());
    }
    std::cout << "ready" << std::endl;

    for (std::string line; !interrupted && std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string what;
        words >> what;
        if (what == "stop") {
            Stops stops;
            double period_ms = 0;
            words >> stops.first >> stops.count >> stops.n >> period_ms;
            if (!words || stops.count == 0 || stops.first + stops.count > wish.entities)
                throw std::runtime_error("'" + line + "': expected stop FIRST COUNT N PERIOD_MS");
            stops.period_ns = static_cast<std::int64_t>(period_ms * 1e6);
            std::cout << stop(*client, entities, stops) << std::endl;
        } else if (what == "reached") {
            std::size_t i = 0;
            words >> i;
            if (!words || i >= wish.entities) throw std::runtime_error("'" + line + "': expected reached I");
            std::cout << reached(entities, i) << std::endl;
        } else if (what == "scans") {
            std::cout << count.take() << std::endl;
        } else {
            throw std::runtime_error("'" + line + "': expected stop, reached or scans");
        }
        if (const auto ended = entities.ended(); !ended.empty()) throw std::runtime_error(ended);
    }
    watches.clear();
    client->close();
    return 0;
}

}  // namespace axon::bench
