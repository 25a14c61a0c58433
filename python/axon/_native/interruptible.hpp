// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <thread>
#include <type_traits>

#include "feed.hpp"
#include "gil.hpp"

namespace axon::python {

/// Asks a call that waits to give up: from another thread, or on Ctrl-C.
class GiveUp {
  public:
    void request() { source_.request_stop(); }
    std::stop_token token() const { return source_.get_token(); }

  private:
    std::stop_source source_;
};

/// For what may be lost when nobody waits for it any more.
struct NotMissed {
    template <class Out>
    void operator()(Out&) const {}
};

/// Calls `call` without the GIL and returns what it returns. On the main thread KeyboardInterrupt ends the
/// wait: `give_up` is requested, and what has not ended half a second later ends by itself, on a thread of
/// its own. So `call` owns everything that it uses. What it returns when nobody waits for it any more goes to
/// `unwanted`, which owns what it uses, too, and is called without the GIL. With the GIL.
template <class Call, class Unwanted = NotMissed>
auto interruptibly(GiveUp& give_up, Call call, Unwanted unwanted = {}) -> std::invoke_result_t<Call> {
    using Out = std::invoke_result_t<Call>;
    if (!isMainThread()) {
        const WithoutGil released;
        return call();
    }
    struct Shared {
        std::mutex mutex;
        std::condition_variable changed;
        // Guarded by mutex:
        std::optional<Out> out;
        std::exception_ptr thrown;
        bool abandoned = false;  // nobody waits any more
    };
    const auto shared = std::make_shared<Shared>();
    const auto done = [&] { return shared->out || shared->thrown; };
    std::thread([shared, unwanted, call = std::move(call)]() mutable {
        std::optional<Out> out;
        std::exception_ptr thrown;
        try {
            out.emplace(call());
        } catch (...) {
            thrown = std::current_exception();
        }
        {
            const std::lock_guard lock(shared->mutex);
            if (!shared->abandoned) {
                shared->out = std::move(out);
                shared->thrown = thrown;
                shared->changed.notify_all();
                return;
            }
        }
        if (out) unwanted(*out);
    }).detach();
    bool ended = false;
    while (!ended) {
        {
            const WithoutGil released;
            std::unique_lock lock(shared->mutex);
            ended = shared->changed.wait_for(lock, kSlice, done);
        }
        if (PyErr_CheckSignals() == 0) continue;
        pybind11::error_already_set interrupted;
        give_up.request();
        {
            const WithoutGil released;
            std::unique_lock lock(shared->mutex);
            const bool came = shared->changed.wait_for(lock, std::chrono::milliseconds(500), done);
            shared->abandoned = !came;
            lock.unlock();
            if (came && shared->out) unwanted(*shared->out);  // the thread is done with it
        }
        throw interrupted;
    }
    if (shared->thrown) std::rethrow_exception(shared->thrown);
    return std::move(*shared->out);
}

}  // namespace axon::python
