// SPDX-License-Identifier: MIT
#pragma once
#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "bounded_job.hpp"

namespace axon::python {

/// What brings a robot to rest without the interpreter.
///
/// carryOut() runs on the stop thread of the Entity Interfacer, which has no interpreter lock and takes none.
/// Its own mutex is held for a change of a descriptor and for the bounded writing, and never by a thread that
/// waits for the interpreter. It is carried out again while a stop is not complete, so it must be harmless
/// when it is repeated.
class StopAction {
  public:
    virtual ~StopAction() = default;
    StopAction(const StopAction&) = delete;
    StopAction& operator=(const StopAction&) = delete;

    /// Throws std::runtime_error with what failed, for a person.
    void carryOut();
    virtual std::string describe() const = 0;
    std::uint64_t runs() const { return runs_; }
    std::uint64_t failures() const { return failures_; }

  protected:
    StopAction() = default;

  private:
    virtual void act() = 0;
    std::atomic<std::uint64_t> runs_{0}, failures_{0};
};

/// Which open file a descriptor means. Its number can come to mean another one.
struct FileIdentity {
    dev_t device = 0, special = 0;
    ino_t inode = 0;
    bool operator==(const FileIdentity&) const = default;
};

/// Closes the connection to the device: discards what a serial line has not sent yet, shuts a socket down,
/// and puts a dead connection in the place of the descriptor. So its number cannot come to mean another file,
/// writing to it fails (EPIPE), and reading from it finds the end.
///
/// If the number means another file than the one that was given, nothing is closed and the stop has failed.
/// If it means no file, the program has ended the connection itself, and there is nothing to close.
class CloseDescriptor : public StopAction {
  public:
    /// Throws std::invalid_argument if the descriptor is not open.
    explicit CloseDescriptor(int descriptor);
    ~CloseDescriptor() override;
    std::string describe() const override;
    /// The connection that was opened again after a stop.
    void watch(int descriptor);
    /// Nothing is closed from now on.
    void release();
    bool closed() const;

  private:
    void act() override;
    mutable std::mutex mutex_;
    int descriptor_ = -1;    // guarded by mutex_; not owned
    FileIdentity identity_;  // guarded by mutex_: what descriptor_ must mean
    int dead_ = -1;          // constant after construction
    bool closed_ = false;    // guarded by mutex_
};

/// Writes bytes to a device. Never waits longer than `within`.
///
/// A terminal and a pipe are opened again, which gives a descriptor that does not block, and a socket can be
/// told not to. Any other file is duplicated, because opening it again would be another device (the master of
/// a pseudo-terminal) or lose what was set (an I2C address). Writing to it may block, and happens on a thread
/// of its own.
class WriteBytes : public StopAction {
  public:
    /// Keeps a duplicate of the descriptor. Throws std::invalid_argument if it is not open, or for no bytes.
    WriteBytes(int descriptor, std::string bytes, std::chrono::duration<double> within);
    /// Opens the file at every stop. Throws std::invalid_argument if it is not there.
    WriteBytes(std::filesystem::path path, std::string bytes, std::chrono::duration<double> within);
    std::string describe() const override;
    void watch(int descriptor);
    /// Closes the duplicate; nothing is written from now on.
    void release();
    /// Writes an order of a task, unless a stop of the task is requested; then returns false. No order
    /// follows the bytes of a stop: `stopped` becomes true before the action is carried out, and both take
    /// turns. An order that a device does not take gives up as soon as a stop waits, and returns false; a
    /// part of it may be written. An order that comes during a stop does not wait for its end.
    bool order(const std::function<bool()>& stopped, const std::string& bytes);

  private:
    struct Line;
    void act() override;
    /// False if a stop waits and may interrupt it.
    bool write(const std::shared_ptr<Line>& line, const std::string& bytes, bool is_order);
    bool writeDirectly(const Line& line, const std::string& bytes, bool is_order) const;
    bool onThread(BoundedJob::Job job, bool is_order);
    bool giveUp(bool is_order) const { return is_order && stops_waiting_ > 0; }
    void setLine(std::shared_ptr<Line> line);
    const std::filesystem::path path_;
    const std::string bytes_;
    const std::chrono::nanoseconds within_;
    std::atomic<int> stops_waiting_{0};
    std::timed_mutex mutex_;
    std::shared_ptr<Line> line_;        // guarded by mutex_
    std::shared_ptr<BoundedJob> jobs_;  // guarded by jobs_mutex_; none while no line needs it
    std::mutex jobs_mutex_;
};

/// Runs a program and waits at most `within` for its end. A program that takes longer goes on; until it has
/// ended, no second one is started. A program whose status another part of this process has collected counts
/// as failed, because nobody knows whether it has stopped the robot.
class RunCommand : public StopAction {
  public:
    /// `words` begins with the path of the program.
    RunCommand(std::vector<std::string> words, std::chrono::duration<double> within);
    ~RunCommand() override;
    std::string describe() const override;

  private:
    void act() override;
    void start();
    void forget();
    std::string statusIsUnknown() const;
    const std::vector<std::string> words_;
    const std::chrono::nanoseconds within_;
    std::mutex mutex_;
    int child_ = -1;  // guarded by mutex_: a pidfd, which cannot come to mean another process; -1 = none runs
};

}  // namespace axon::python
