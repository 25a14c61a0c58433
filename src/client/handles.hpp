// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "axon/client.hpp"
#include "client/base/session_observer.hpp"
#include "common/ids.hpp"

namespace axon::client {

/// What copies of a Task, or of a Run, share. The report is the core's newest; the callbacks run
/// by the CallbackQueue.
template <class Report>
struct ReportShared {
    ReportShared(Id128 task_or_run, std::weak_ptr<Client::Session> owner, Report first)
        : id(task_or_run), text(id.toString()), session(std::move(owner)), report(std::move(first)) {}

    const Id128 id;
    const std::string text;
    const std::weak_ptr<Client::Session> session;

    std::mutex mutex;
    std::condition_variable changed;
    // Guarded by mutex:
    Report report;
    std::vector<std::function<void(const Report&)>> callbacks;
    int untold = 0;  // calls of callbacks with the final report that have not returned

    bool over() const { return isFinal(report.state) && untold == 0; }
};

/// For callbacks that are to be called with the final report: wait() does not return while the result exists.
/// It ends with the callback, whether that runs or is discarded. Called with handle->mutex held; the last
/// copy is destroyed without it.
template <class Shared>
std::shared_ptr<void> whileUntold(const std::shared_ptr<Shared>& handle) {
    ++handle->untold;
    return {nullptr, [handle](void*) {
                const std::lock_guard lock(handle->mutex);
                --handle->untold;
                handle->changed.notify_all();
            }};
}

struct Task::Shared : ReportShared<TaskReport> {
    using ReportShared::ReportShared;
};

struct Run::Shared : ReportShared<RunReport> {
    using ReportShared::ReportShared;
};

/// What copies of one CheckOut share.
struct CheckOut::Shared {
    Shared(Held granted, std::weak_ptr<Client::Session> owner, Entity first)
        : held(std::move(granted)), session(std::move(owner)), last(std::move(first)) {}

    const Held held;
    const std::weak_ptr<Client::Session> session;

    std::mutex mutex;
    // Guarded by mutex:
    Entity last;  // for entity() when it has left
    std::function<void(const std::string&)> text, raw;
    std::function<void(const Service&)> service;
    std::function<void(const Refusal&)> lost;
    std::function<void(const std::string&)> orphaned;
    std::function<void()> resumed;
    std::function<void(const HandOverRequest&)> hand_over;
    std::optional<Refusal> lost_why;
};

}  // namespace axon::client
