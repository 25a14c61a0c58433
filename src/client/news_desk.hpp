// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "axon/client.hpp"
#include "client/base/session_observer.hpp"
#include "client/callback_queue.hpp"
#include "client/handles.hpp"
#include "client/upload.hpp"

namespace axon::client {

/// Passes what the core reports on to the program: to its handles, watches, uploads and callbacks.
///
/// Where in the flow: between SessionCore, which calls it as its SessionObserver under its lock, and the
/// callbacks, by which the program is told. Ownership: it knows tasks and runs weakly, as long as they
/// are not final, and check-outs as long as they are held. Threads: the first three groups of functions under
/// the core's lock, which may be held while a handle's own is taken; the rest on any thread. Nothing here
/// waits, and no callback runs under a lock. Failure: what a full queue leaves out is in callback_queue.hpp;
/// where even that is not enough, `overflow` is called.
class NewsDesk final : public SessionObserver {
  public:
    /// `offers`: for what a lease offers besides messages, which is not for the program. `overflow`: the
    /// program does not return from its callbacks; called on any thread, under the core's lock or not.
    NewsDesk(LeaseOffers& offers, std::function<void()> overflow)
        : offers_(offers), overflow_(std::move(overflow)) {}

    // SessionObserver.
    void onEntity(Presence presence, const Entity& entity) override;
    void onTask(const TaskReport& report) override;
    void onRun(const RunReport& report) override;
    void onText(const Held& held, const std::string& text) override;
    void onRaw(const Held& held, const std::string& bytes) override;
    void onService(const Held& held, const Service& service) override;
    void onLost(const Held& held, const Refusal& why) override;
    void onDatagrams(const Held& held, const std::string& endpoint, const std::string& key) override;
    void onDirect(const Held& held, const std::string& data_endpoint, const std::string& signal_endpoint,
                  const std::string& key) override;
    void onOrphaned(const Held& held, const std::string& reason) override;
    void onResumed(const Held& held) override;
    void onHandOver(const Held& held, const HandOverRequest& request) override;
    void onSample(Sample sample) override;
    void onTransferCredit(const Id128& transfer, std::uint64_t offset, std::uint64_t limit) override;
    void onServerText(int code, const std::string& text) override;

    // Who is to be told.
    void add(const std::shared_ptr<Task::Shared>& task) { tasks_[task->text] = task; }
    void add(const std::shared_ptr<Run::Shared>& run) { runs_[run->text] = run; }
    void add(const std::shared_ptr<CheckOut::Shared>& check_out) { check_outs_[check_out->held] = check_out; }
    void remove(const Held& held) { check_outs_.erase(held); }
    std::vector<std::shared_ptr<CheckOut::Shared>> checkOuts() const;
    void add(const Id128& transfer, std::shared_ptr<UploadWindow> upload) {
        uploads_[transfer] = std::move(upload);
    }
    void removeUpload(const Id128& transfer) { uploads_.erase(transfer); }
    /// Returns the number of the watch.
    std::uint64_t addWatch(const std::string& entity, const std::vector<std::string>& streams,
                           std::function<void(const Sample&)> callback);
    /// Returns the watch's entity and streams; the entity is empty if there is no such watch, or no longer.
    /// Its callback is not called again, apart from a call that is under way.
    std::pair<std::string, std::vector<std::string>> removeWatch(std::uint64_t watch);

    // From a use of the core.
    /// Like post(). It runs when the lock is free: a callback may use the core, and would only wait for it.
    void tell(std::function<void()> callback, bool may_be_left_out);
    /// Whether tell() has been called since; then wake() is to be called without the lock.
    bool takeTold() { return std::exchange(told_, false); }

    void wake() { callbacks_.wake(); }
    /// Runs by the CallbackQueue, in order.
    void post(std::function<void()> callback, bool may_be_left_out);
    void tellConnection(bool connected, const std::string& reason);
    void setOnEntity(std::function<void(Presence, const Entity&)> callback);
    void setOnConnection(std::function<void(bool, const std::string&)> callback);
    /// What was told runs on this thread, if no other one runs callbacks; without any lock.
    void runHere() { callbacks_.runHere(); }
    /// More waits than runHere() runs.
    bool crowded() const { return callbacks_.crowded(); }
    bool insideCallback() const { return callbacks_.isThisThread(); }
    /// No callback runs after it has returned. Must not be called from a callback.
    void close() { callbacks_.close(); }

  private:
    struct Watching {
        std::string entity;
        std::vector<std::string> streams;
        std::shared_ptr<const std::function<void(const Sample&)>> callback;
        std::shared_ptr<std::atomic<bool>> wanted;
    };
    template <class Shared, class Report>
    void tellReport(std::unordered_map<std::string, std::weak_ptr<Shared>>& handles, const Report& report);
    /// Calls `tell` with the handle's lock held, where the handle is known.
    template <class Tell>
    void withCheckOut(const Held& held, Tell&& tell) const;
    void overflow();

    LeaseOffers& offers_;
    const std::function<void()> overflow_;

    // Guarded by the core's lock:
    std::unordered_map<std::string, std::weak_ptr<Task::Shared>> tasks_;
    std::unordered_map<std::string, std::weak_ptr<Run::Shared>> runs_;
    std::map<Held, std::shared_ptr<CheckOut::Shared>> check_outs_;
    std::unordered_map<Id128, std::shared_ptr<UploadWindow>> uploads_;
    std::map<std::uint64_t, Watching> watches_;
    std::uint64_t next_watch_ = 0;
    bool told_ = false;

    std::mutex callbacks_mutex_;
    // Guarded by callbacks_mutex_:
    std::function<void(Presence, const Entity&)> on_entity_;
    std::function<void(bool, const std::string&)> on_connection_;

    CallbackQueue callbacks_;
};

}  // namespace axon::client
