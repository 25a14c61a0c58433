// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/news_desk.hpp"

#include <spdlog/logger.h>

#include <algorithm>

#include "client/base/log.hpp"
#include "client/core/content.hpp"

namespace axon::client {

void NewsDesk::tell(std::function<void()> callback, bool may_be_left_out) {
    if (callbacks_.post(std::move(callback), may_be_left_out)) {
        told_ = true;
    } else {
        overflow();
    }
}

void NewsDesk::post(std::function<void()> callback, bool may_be_left_out) {
    if (callbacks_.post(std::move(callback), may_be_left_out)) {
        callbacks_.wake();
    } else {
        overflow();
    }
}

/// The program does not return from its callbacks: it no longer knows what its robots do.
void NewsDesk::overflow() {
    log().error("client: {} callbacks wait for the program to return from one; the connection is given up",
                CallbackQueue::kMost);
    overflow_();
}

void NewsDesk::tellConnection(bool connected, const std::string& reason) {
    std::function<void(bool, const std::string&)> callback;
    {
        const std::lock_guard lock(callbacks_mutex_);
        callback = on_connection_;
    }
    if (callback) post([callback, connected, reason] { callback(connected, reason); }, false);
}

void NewsDesk::setOnEntity(std::function<void(Presence, const Entity&)> callback) {
    const std::lock_guard lock(callbacks_mutex_);
    on_entity_ = std::move(callback);
}

void NewsDesk::setOnConnection(std::function<void(bool, const std::string&)> callback) {
    const std::lock_guard lock(callbacks_mutex_);
    on_connection_ = std::move(callback);
}

void NewsDesk::onEntity(Presence presence, const Entity& entity) {
    std::function<void(Presence, const Entity&)> callback;
    {
        const std::lock_guard lock(callbacks_mutex_);
        callback = on_entity_;
    }
    if (callback)
        tell([callback, presence, entity] { callback(presence, entity); }, presence == Presence::Changed);
}

/// A new report of a task or a run, to whoever waits for it and to its callbacks.
template <class Shared, class Report>
void NewsDesk::tellReport(std::unordered_map<std::string, std::weak_ptr<Shared>>& handles,
                          const Report& report) {
    const auto found = handles.find(report.id);
    if (found == handles.end()) return;
    const auto handle = found->second.lock();
    if (isFinal(report.state)) handles.erase(found);
    if (!handle) return;
    bool listened = false;
    std::shared_ptr<void> untold;
    {
        const std::lock_guard lock(handle->mutex);
        handle->report = report;
        listened = !handle->callbacks.empty();
        if (listened && isFinal(report.state)) untold = whileUntold(handle);
    }
    handle->changed.notify_all();
    if (!listened) return;
    tell(
        [handle, report, untold = std::move(untold)] {
            std::vector<std::function<void(const Report&)>> callbacks;
            {
                const std::lock_guard lock(handle->mutex);
                callbacks = handle->callbacks;
            }
            for (const auto& callback : callbacks) callback(report);
        },
        !isFinal(report.state));
}

void NewsDesk::onTask(const TaskReport& report) {
    tellReport(tasks_, report);
}

void NewsDesk::onRun(const RunReport& report) {
    tellReport(runs_, report);
}

std::vector<std::shared_ptr<CheckOut::Shared>> NewsDesk::checkOuts() const {
    std::vector<std::shared_ptr<CheckOut::Shared>> all;
    for (const auto& [held, check_out] : check_outs_) all.push_back(check_out);
    return all;
}

template <class Tell>
void NewsDesk::withCheckOut(const Held& held, Tell&& tell) const {
    const auto found = check_outs_.find(held);
    if (found == check_outs_.end()) return;
    const auto check_out = found->second;
    const std::lock_guard lock(check_out->mutex);
    tell(*check_out);
}

void NewsDesk::onText(const Held& held, const std::string& text) {
    withCheckOut(held, [&](const CheckOut::Shared& check_out) {
        if (check_out.text) tell([callback = check_out.text, text] { callback(text); }, true);
    });
}

void NewsDesk::onRaw(const Held& held, const std::string& bytes) {
    withCheckOut(held, [&](const CheckOut::Shared& check_out) {
        if (check_out.raw) tell([callback = check_out.raw, bytes] { callback(bytes); }, true);
    });
}

void NewsDesk::onService(const Held& held, const Service& service) {
    withCheckOut(held, [&](const CheckOut::Shared& check_out) {
        if (check_out.service) tell([callback = check_out.service, service] { callback(service); }, true);
    });
}

void NewsDesk::onLost(const Held& held, const Refusal& why) {
    withCheckOut(held, [&](CheckOut::Shared& check_out) {
        check_out.lost_why = why;
        if (check_out.lost) tell([callback = check_out.lost, why] { callback(why); }, false);
    });
    check_outs_.erase(held);
}

void NewsDesk::onOrphaned(const Held& held, const std::string& reason) {
    withCheckOut(held, [&](const CheckOut::Shared& check_out) {
        if (check_out.orphaned) tell([callback = check_out.orphaned, reason] { callback(reason); }, false);
    });
}

void NewsDesk::onResumed(const Held& held) {
    withCheckOut(held, [&](const CheckOut::Shared& check_out) {
        if (check_out.resumed) tell(check_out.resumed, false);
    });
}

void NewsDesk::onHandOver(const Held& held, const HandOverRequest& request) {
    withCheckOut(held, [&](const CheckOut::Shared& check_out) {
        if (check_out.hand_over)
            tell([callback = check_out.hand_over, request] { callback(request); }, false);
    });
}

void NewsDesk::onDatagrams(const Held& held, const std::string& endpoint, const std::string& key) {
    offers_.onDatagrams(held, endpoint, key);
}

void NewsDesk::onDirect(const Held& held, const std::string& data_endpoint,
                        const std::string& signal_endpoint, const std::string& key) {
    offers_.onDirect(held, data_endpoint, signal_endpoint, key);
}

std::uint64_t NewsDesk::addWatch(const std::string& entity, const std::vector<std::string>& streams,
                                 std::function<void(const Sample&)> callback) {
    const auto id = ++next_watch_;
    watches_[id] = {entity, streams,
                    std::make_shared<const std::function<void(const Sample&)>>(std::move(callback)),
                    std::make_shared<std::atomic<bool>>(true)};
    return id;
}

std::pair<std::string, std::vector<std::string>> NewsDesk::removeWatch(std::uint64_t watch) {
    const auto found = watches_.find(watch);
    if (found == watches_.end()) return {};
    *found->second.wanted = false;
    std::pair removed{std::move(found->second.entity), std::move(found->second.streams)};
    watches_.erase(found);
    return removed;
}

void NewsDesk::onSample(Sample sample) {
    const auto shared = std::make_shared<const Sample>(std::move(sample));  // a picture is large
    for (const auto& [id, watching] : watches_) {
        if (watching.entity != shared->entity) continue;
        const auto& streams = watching.streams;
        if (!streams.empty() && std::find(streams.begin(), streams.end(), shared->stream) == streams.end())
            continue;
        tell(
            [callback = watching.callback, wanted = watching.wanted, shared] {
                if (*wanted) (*callback)(*shared);
            },
            true);
    }
}

void NewsDesk::onTransferCredit(const Id128& transfer, std::uint64_t offset, std::uint64_t limit) {
    const auto found = uploads_.find(transfer);
    if (found != uploads_.end()) found->second->credit(offset, limit);
}

void NewsDesk::onServerText(int code, const std::string& text) {
    log().info("server: {} ({})", text, code);
}

}  // namespace axon::client
