// SPDX-License-Identifier: GPL-2.0-or-later
#include "gil.hpp"

#include <pthread.h>

#include <condition_variable>
#include <mutex>
#include <thread>

namespace axon::python {
namespace {

/// Who is asking for the GIL. Never destroyed: threads may use it until the process is gone.
struct Door {
    std::mutex mutex;
    std::condition_variable changed;
    int asking = 0;
    bool closed = false;
    std::thread::id last;  // the one that may still come in: it ends the interpreter

    /// False if the interpreter is about to end.
    bool enter() {
        const std::lock_guard lock(mutex);
        if (closed && std::this_thread::get_id() != last) return false;
        ++asking;
        return true;
    }
    void entered() {
        const std::lock_guard lock(mutex);
        if (--asking == 0) changed.notify_all();
    }
};

Door& door() {
    static Door& the = *new Door;
    return the;
}

[[noreturn]] void waitForTheEnd() {
    std::mutex mutex;
    std::unique_lock lock(mutex);
    std::condition_variable never;
    while (true) never.wait(lock);
}

}  // namespace

WithoutGil::WithoutGil() : state_(PyEval_SaveThread()) {}

WithoutGil::~WithoutGil() {
    if (!door().enter()) waitForTheEnd();
    PyEval_RestoreThread(state_);
    door().entered();
}

WithGil::WithGil() : taken_(door().enter()) {
    if (!taken_) return;
    state_ = PyGILState_Ensure();
    door().entered();
}

WithGil::~WithGil() {
    if (taken_) PyGILState_Release(state_);
}

void prepareForForks() {
    ::pthread_atfork([] { door().mutex.lock(); }, [] { door().mutex.unlock(); },
                     [] {
                         door().asking = 0;  // those who asked are threads of the parent
                         door().last = std::this_thread::get_id();
                         door().mutex.unlock();
                     });
}

void endOfInterpreter() {
    {
        const std::lock_guard lock(door().mutex);
        door().closed = true;
        door().last = std::this_thread::get_id();
    }
    auto* const state = PyEval_SaveThread();  // so that those who are asking get it
    {
        std::unique_lock lock(door().mutex);
        door().changed.wait(lock, [] { return door().asking == 0; });
    }
    PyEval_RestoreThread(state);
}

}  // namespace axon::python
