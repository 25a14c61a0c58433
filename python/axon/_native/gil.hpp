// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Python.h>

/// How native code and the interpreter take turns.
///
/// The interpreter's lock (GIL) is never taken while a native lock is held. When the interpreter ends, a
/// thread that asks for the GIL would be ended in the middle of C++ code, which ends the process. So from
/// endOfInterpreter() on no thread of this module asks for it any more.
namespace axon::python {

/// Releases the GIL for a native call that may block. Made and destroyed by a thread that has it.
class WithoutGil {
  public:
    WithoutGil();
    ~WithoutGil();
    WithoutGil(const WithoutGil&) = delete;
    WithoutGil& operator=(const WithoutGil&) = delete;

  private:
    PyThreadState* state_;
};

/// Takes the GIL on a thread of this module. False if the interpreter is about to end: then it was not taken.
class WithGil {
  public:
    WithGil();
    ~WithGil();
    WithGil(const WithGil&) = delete;
    WithGil& operator=(const WithGil&) = delete;
    explicit operator bool() const { return taken_; }

  private:
    bool taken_;
    PyGILState_STATE state_{};
};

/// Makes a child of fork() able to use WithoutGil: no other thread of its parent lives on in it. Called once,
/// before anything else of this file.
void prepareForForks();

/// Called once, with the GIL, by the thread that is about to end the interpreter. Returns when no other
/// thread is asking for the GIL. Threads that come back from a native call later wait for the end of the
/// process.
void endOfInterpreter();

}  // namespace axon::python
