// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/network.hpp"

#include <algorithm>

namespace axon::simulation {

TimePoint Connection::arrival(std::size_t to) {
    auto way = dice_.between(path_.fastest, path_.slowest);
    if (extra > Duration{}) way += dice_.between(Duration{}, extra);
    const auto when = std::max(timeline_.now() + way, last_[to] + std::max(pace_[to], Duration{1}));
    last_[to] = when;
    return when;
}

void Connection::noteRead(std::size_t at) {
    const auto from = 1 - at;
    if (unread_[at]-- <= kBuffered || !written_[from]) return;
    timeline_.after(Duration{}, *ends_[from], [this, from] {
        if (!closed_[from]) written_[from]();
    });
}

void Connection::notice(std::size_t to) {
    if (closed_[to]) return;
    const auto learn = [this, to] {
        if (std::exchange(closed_[to], true)) return;
        if (told_[to]) told_[to]();
    };
    if (path_.cut[direction(1 - to)])
        held_[to].push_back(learn);
    else
        timeline_.at(arrival(to), *ends_[to], learn);
}

void Connection::close(Process& by) {
    const auto here = side(by);
    if (std::exchange(closed_[here], true)) return;
    notice(1 - here);
}

void Connection::refused(Process& from) {
    const auto here = side(from);
    closed_[1 - here] = true;
    if (path_.cut[0] || path_.cut[1]) return;
    notice(here);
}

void Connection::breakDown() {
    for (const std::size_t to : {0U, 1U}) {
        if (closed_[to]) continue;
        // What is still under way then is lost.
        timeline_.after(dice_.between(path_.fastest, path_.slowest), *ends_[to], [this, to] {
            if (std::exchange(closed_[to], true)) return;
            if (told_[to]) told_[to]();
        });
    }
}

void Connection::endDied(const Process& dead, bool with_notice) {
    const auto here = side(dead);
    if (std::exchange(closed_[here], true)) return;
    if (with_notice)
        notice(1 - here);
    else
        silent_death_[here] = true;
}

void Connection::restarted(const Process& again) {
    const auto here = side(again);
    if (std::exchange(silent_death_[here], false)) notice(1 - here);
}

void Connection::mended(std::size_t mended_direction) {
    const auto to = 1 - mended_direction;
    for (auto& deliver : std::exchange(held_[to], {}))
        timeline_.at(arrival(to), *ends_[to], std::move(deliver));
}

Connection& Network::connect(Path& path, Process& client, Process& server) {
    connections_.push_back(std::make_unique<Connection>(timeline_, dice_, path, client, server));
    path.connections.push_back(connections_.back().get());
    return *connections_.back();
}

void Network::died(const Process& process, bool notice) {
    for (const auto& connection : connections_)
        if (connection->joins(process)) connection->endDied(process, notice);
}

void Network::restarted(const Process& process) {
    for (const auto& connection : connections_)
        if (connection->joins(process)) connection->restarted(process);
}

void Network::cut(Path& path, bool up, bool down) {
    if (up) path.cut[0] = true;
    if (down) path.cut[1] = true;
    for (const std::size_t direction : {0U, 1U})
        if (path.cut[direction]) path.changed_at[direction] = timeline_.now();
}

void Network::mend(Path& path) {
    for (const std::size_t direction : {0U, 1U}) {
        if (!std::exchange(path.cut[direction], false)) continue;
        path.changed_at[direction] = timeline_.now();
        for (auto* connection : path.connections) connection->mended(direction);
    }
}

std::size_t Network::held() const {
    std::size_t all = 0;
    for (const auto& connection : connections_) all += connection->held();
    return all;
}

}  // namespace axon::simulation
