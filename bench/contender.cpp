// SPDX-License-Identifier: GPL-2.0-or-later
#include "contender.hpp"

#include <algorithm>
#include <deque>
#include <exception>
#include <limits>
#include <tuple>

#include "child.hpp"

namespace axon::bench {

namespace {
constexpr std::int64_t kLookForArrivals_ns = 200'000;
/// Before a batch, when the one before it is there as a rule: thousands of paths are asked one by one.
constexpr std::int64_t kLook_ns = 20'000'000;
}  // namespace

Contender::Contender(std::string its_name, std::unique_ptr<Subject> subject)
    : name(std::move(its_name)), subject_(std::move(subject)), next_counted_(board().size(), 0) {}

Batch Contender::send(Message message, std::string& bytes, std::int64_t begin) {
    Batch batch{kindOf(message), begin, std::vector<std::int64_t>(board().size()),
                std::vector<std::uint32_t>(board().size())};
    if (subject_->numbered(batch.kind)) {
        const auto number = next_number_[batch.kind == Kind::Stop ? 0 : 1]++;
        setNumber(bytes, number);
        std::fill(batch.awaited.begin(), batch.awaited.end(), number);
    } else {
        // After a pause nothing is under way: what was lost for good must not shift those that follow.
        const bool quiet = begin > quiet_after_;
        for (std::size_t i = 0; i < board().size(); ++i) {
            if (quiet) next_counted_[i] = board()[i].of(batch.kind).next;
            batch.awaited[i] = next_counted_[i]++;
        }
    }
    try {
        subject_->send(message, bytes, batch.called);
    } catch (const std::exception& problem) {
        if (ended().empty()) ended_ = problem.what();
        for (auto& called : batch.called)
            if (called == 0)
                called = std::numeric_limits<std::int64_t>::max();  // nothing has arrived after that
    }
    quiet_after_ = nowNs() + kPatience_ns;
    return batch;
}

std::int64_t Contender::arrivedAt(const Batch& batch, std::size_t i) const {
    const auto at = subject_->board()[i].of(batch.kind).of(batch.awaited[i]);
    return at >= batch.called[i] ? at : 0;
}

std::size_t Contender::firstMissing(const Batch& batch, std::size_t from) const {
    while (from < batch.awaited.size() && arrivedAt(batch, from) != 0 &&
           (!hasRobots() || calledBackAt(batch, from) != 0))
        ++from;
    return from;
}

void Contender::await(const Batch& batch, std::int64_t until) const {
    for (std::size_t missing = 0; nowNs() < until;) {
        missing = firstMissing(batch, missing);
        if (missing == batch.awaited.size() || !sleepUntil(nowNs() + kLookForArrivals_ns)) return;
    }
}

std::int64_t Contender::calledBackAt(const Batch& batch, std::size_t i) const {
    if (arrivedAt(batch, i) == 0) return 0;
    const auto& robot = (*subject_->robots())[i];
    const auto at = batch.kind == Kind::Stop ? robot.reached(batch.awaited[i], subject_->board()[i])
                                             : robot.data.of(batch.awaited[i]);
    return at >= batch.called[i] ? at : 0;
}

void Contender::collect(const Batch& batch, std::size_t first, std::size_t end, Series& from_begin,
                        Series* from_call, Series* at_callback) const {
    for (auto i = first; i < end; ++i) {
        const auto arrived = arrivedAt(batch, i);
        for (const auto& [to, since, at] :
             {std::tuple{&from_begin, batch.begin, arrived}, std::tuple{from_call, batch.called[i], arrived},
              std::tuple{at_callback, batch.begin, at_callback != nullptr ? calledBackAt(batch, i) : 0}}) {
            if (to == nullptr) continue;
            if (at == 0 || at > batch.begin + kPatience_ns) {
                to->lose();
            } else {
                to->add(static_cast<double>(at - since) / 1e6);
            }
        }
    }
}

std::uint64_t Contender::bad() const {
    std::uint64_t sum = 0;
    auto& its = subject_->board();
    for (std::size_t i = 0; i < its.size(); ++i) sum += its[i].corrupt + its[i].misplaced;
    return sum;
}

std::uint64_t Contender::corrupt() const {
    std::uint64_t sum = 0;
    auto& its = subject_->board();
    for (std::size_t i = 0; i < its.size(); ++i) sum += its[i].corrupt;
    return sum;
}

std::uint64_t Contender::corruptAtCallback() const {
    std::uint64_t sum = 0;
    auto& its = *subject_->robots();
    for (std::size_t i = 0; i < its.size(); ++i) sum += its[i].corrupt;
    return sum;
}

const std::string& Contender::ended() {
    if (ended_.empty()) ended_ = subject_->ended();
    return ended_;
}

void measurePaced(Contender& contender, Message message, std::string& bytes, const Pace& pace,
                  std::vector<Figures>& figures) {
    std::deque<std::pair<Batch, bool>> under_way;
    const auto settle = [&](bool all) {
        for (; !under_way.empty() && (all || nowNs() > under_way.front().first.begin + kPatience_ns);
             under_way.pop_front()) {
            const auto& [batch, counts] = under_way.front();
            // The last ones have the time that the others had, and more, so that they are not in the next
            // system's way.
            if (all) contender.await(batch, batch.begin + kPatience_ns + pace.late_ns);
            if (!counts || interrupted) continue;
            for (auto& its : figures) {
                its.from_batch.beginBatch();
                its.from_call.beginBatch();
                if (contender.hasRobots()) its.at_callback.beginBatch();
                contender.collect(batch, its.first, its.end, its.from_batch, &its.from_call,
                                  contender.hasRobots() ? &its.at_callback : nullptr);
            }
        }
    };
    auto due = nowNs() + 10'000'000;
    for (int i = -pace.warm_up; i < pace.periods; ++i, due += pace.period_ns) {
        sleepUntil(due - kLook_ns);
        contender.lookAtPaths();
        if (!sleepUntil(due)) break;
        under_way.emplace_back(contender.send(message, bytes, due), i >= 0);
        settle(false);
    }
    contender.lookAtPaths();
    settle(true);  // but interrupted: what may still be under way is neither lost nor late
}

}  // namespace axon::bench
