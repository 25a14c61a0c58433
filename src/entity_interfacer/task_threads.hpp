// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <deque>
#include <iterator>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "common/refusal.hpp"
#include "host/wake_up.hpp"

namespace axon {

/// The threads that run the handlers of tasks, one for each, from the start of a task until its thread has
/// been joined; and the ids of the last tasks, none of which starts twice.
///
/// Threads: wasStarted(), start(), find() and reap() belong to the data thread, or to who ends it; the others
/// may be called from any thread. The mutex is held while the list is changed or read and while a thread is
/// created, never while a handler runs or a thread is joined. A stop reaches the tasks by the StopLevel: the
/// stop thread takes the mutex only where onStop itself gives feedback. Failure: what cannot start is
/// refused; its id may come again, unless only its thread could not be made. Bounded: kMax tasks, kRecentMax
/// ids; the oldest id is forgotten.
///
/// `Running` is Task::Running; a test has its own, with `id`, `id_bytes` and `service`.
template <class Running>
class TaskThreads {
  public:
    static constexpr std::size_t kMax = 64;
    static constexpr std::size_t kRecentMax = 256;

    /// `data_thread` is woken when a thread has ended and can be joined.
    explicit TaskThreads(const WakeUp& data_thread) : data_thread_(data_thread) {}

    // Data thread

    /// Whether a task of this id is among the last that were to start.
    bool wasStarted(const std::string& id) const {
        return std::find(recent_.begin(), recent_.end(), id) != recent_.end();
    }
    /// Calls `body` on a thread of its own, and keeps the task until that has returned. OK, or why it does
    /// not start.
    template <class Body>
    Refusal start(std::shared_ptr<Running> task, Body body) {
        const std::lock_guard lock(mutex_);
        if (ending_) return {RefusalCode::Unavailable, "the robot application is shutting down", {}};
        if (tasks_.size() >= kMax)
            return {RefusalCode::QueueFull, std::to_string(kMax) + " tasks are running already", {}};
        recent_.push_back(task->id);
        if (recent_.size() > kRecentMax) recent_.pop_front();
        Entry entry{std::move(task), {}, std::make_shared<bool>(false)};
        try {
            entry.thread = std::thread([this, run = std::move(body), done = entry.done]() mutable {
                run();
                {
                    const std::lock_guard ended(mutex_);
                    *done = true;
                }
                ended_.notify_all();
                data_thread_.wake();
            });
        } catch (const std::system_error&) {
            return {RefusalCode::Overloaded, "the task gets no thread: the machine is out of resources", {}};
        }
        tasks_.push_back(std::move(entry));
        return {};
    }
    /// Null where there is none.
    std::shared_ptr<Running> find(const std::string& id_bytes) const {
        const std::lock_guard lock(mutex_);
        for (const auto& one : tasks_)
            if (one.task->id_bytes == id_bytes) return one.task;
        return nullptr;
    }
    /// Joins the threads that have ended, and forgets their tasks. Not from a task's thread. Also for the
    /// end, when the data thread has ended.
    void reap() {
        std::vector<Entry> ended;
        {
            const std::lock_guard lock(mutex_);
            const auto first =
                std::partition(tasks_.begin(), tasks_.end(), [](const Entry& one) { return !*one.done; });
            std::move(first, tasks_.end(), std::back_inserter(ended));
            tasks_.erase(first, tasks_.end());
        }
        for (auto& one : ended) one.thread.join();
    }

    // Any thread

    std::vector<std::shared_ptr<Running>> ofService(std::string_view service) const {
        std::vector<std::shared_ptr<Running>> found;
        const std::lock_guard lock(mutex_);
        for (const auto& one : tasks_)
            if (one.task->service == service) found.push_back(one.task);
        return found;
    }
    /// From now on none starts.
    void startNoMore() {
        const std::lock_guard lock(mutex_);
        ending_ = true;
    }
    /// Until every handler has returned, but no longer than this; whether they have.
    bool waitForAll(std::chrono::milliseconds time) {
        std::unique_lock lock(mutex_);
        return ended_.wait_for(lock, time, [this] {
            return std::all_of(tasks_.begin(), tasks_.end(), [](const Entry& one) { return *one.done; });
        });
    }
    /// The services of the handlers that have not returned.
    std::vector<std::string> services() const {
        std::vector<std::string> running;
        const std::lock_guard lock(mutex_);
        for (const auto& one : tasks_)
            if (!*one.done) running.push_back(one.task->service);
        return running;
    }

  private:
    struct Entry {
        std::shared_ptr<Running> task;
        std::thread thread;
        std::shared_ptr<bool> done;  // guarded by mutex_
    };

    const WakeUp& data_thread_;
    std::deque<std::string> recent_;  // data thread
    mutable std::mutex mutex_;
    std::condition_variable ended_;
    std::vector<Entry> tasks_;  // these two guarded by mutex_
    bool ending_ = false;
};

}  // namespace axon
