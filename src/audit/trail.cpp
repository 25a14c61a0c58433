// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/trail.hpp"

#include <poll.h>
#include <pthread.h>
#include <sched.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <ctime>
#include <optional>
#include <system_error>
#include <utility>

namespace axon::audit {

namespace {

std::int64_t wallTimeUs() {
    return std::chrono::duration_cast<std::chrono::microseconds>(
               std::chrono::system_clock::now().time_since_epoch())
        .count();
}

Record recordOf(const Ring::Kept& kept) {
    Record record;
    record.at = utcTime(kept.at_us);
    record.kind = toString(kept.kind);
    std::size_t which = 0;
    for (auto* const to : {&record.user, &record.name, &record.client, &record.peer, &record.entity,
                           &record.what, &record.outcome})
        *to = kept.text(which++);
    return record;
}

/// It is `last` of the files: its life was killed before it could say that it has written it.
bool isWritten(const Ring::Kept& kept, const std::optional<Record>& last) {
    if (!last) return false;
    auto record = recordOf(kept);
    record.number = last->number;
    record.before = last->before;
    return lineOf(record) == lineOf(*last);
}

Record startOf(const std::string& started, std::uint64_t unfinished, std::size_t left) {
    Record record;
    record.at = utcTime(wallTimeUs());
    record.kind = toString(Kind::Started);
    record.what = started;
    if (unfinished > 0)
        record.what +=
            "; the line before this record was not finished (" + std::to_string(unfinished) + " bytes)";
    if (left > 0)
        record.what +=
            "; " + std::to_string(left) +
            (left == 1 ? " record of the life before follows" : " records of the life before follow");
    return record;
}

std::string fixOf(int error) {
    if (error == ENOSPC || error == EDQUOT) return "; fix: make room on the disk";
    if (error == EFBIG)
        return "; fix: raise the limit of this process on the size of files (LimitFSIZE=, ulimit -f)";
    if (error == EACCES || error == EPERM || error == EROFS)
        return "; fix: let this user write to the folder and its files";
    return {};
}

sigset_t sizeSignal() {
    sigset_t its;
    sigemptyset(&its);
    sigaddset(&its, SIGXFSZ);
    return its;
}

/// Nobody waits for this thread, and what starts it may not know of limits on the size of files.
void beginThread() {
    pthread_setname_np(pthread_self(), "axon-audit");
    const sched_param none{};
    ::sched_setscheduler(0, SCHED_BATCH, &none);
    const auto its = sizeSignal();
    pthread_sigmask(SIG_BLOCK, &its, nullptr);
}

}  // namespace

Trail::NoSizeSignal::NoSizeSignal() {
    const auto its = sizeSignal();
    pthread_sigmask(SIG_BLOCK, &its, &before_);
}

Trail::NoSizeSignal::~NoSizeSignal() {
    const auto its = sizeSignal();
    const timespec at_once{};
    if (sigismember(&before_, SIGXFSZ) == 0) sigtimedwait(&its, nullptr, &at_once);
    pthread_sigmask(SIG_SETMASK, &before_, nullptr);
}

Trail::Trail(const TrailSettings& settings, const std::string& name, const std::string& started,
             Report report, Files::Write write, const Clock* clock, Files::Sync sync)
    : settings_(settings),
      report_(std::move(report)),
      clock_(clock != nullptr ? *clock : steady_),
      shares_(settings.shares),
      files_(settings.folder, name, settings.files, std::move(write), std::move(sync)),
      slots_(settings.folder, name, settings.waiting),
      ring_(slots_.all()),
      pause_(settings.retry_first) {
    if (files_.unfinished() > 0)
        report_("audit: the last record of the trail in " + files_.folder().string() +
                " was not finished: the program was killed, or the machine lost its power");
    // Where a life that was killed has left them, but behind the record of this one's start.
    auto left = slots_.takeLeft();
    if (!left.empty() && isWritten(left.front(), files_.last())) left.erase(left.begin());
    for (const auto& kept : left) ring_.push(kept);
    if (!slots_.whyNot().empty())
        report_("audit: a kill of this process would lose the records that wait for the disk: " +
                slots_.whyNot());
    thread_ = std::thread([this, first = startOf(started, files_.unfinished(), left.size())] {
        beginThread();
        if (this->write(first)) run();
    });
    starting_.reset();
}

Trail::~Trail() {
    ending_ = true;
    wake_up_.wake();
    thread_.join();
    if (ring_.front() == nullptr) slots_.forget();
}

void Trail::note(const Note& note) {
    if ((note.kind == Kind::Command || note.kind == Kind::Refusal) && !shares_.admit(note, clock_.now())) {
        left_out_.fetch_add(1, std::memory_order_relaxed);
    } else if (!ring_.push(note, wallTimeUs())) {
        lost_.fetch_add(1, std::memory_order_relaxed);
    }
}

void Trail::run() {
    while (true) {
        // Before it looks into the queue: what was noted before the end is found.
        const bool ending = ending_;
        if (!writeWaiting()) return;
        if (const auto now = clock_.now(); ending || now >= losses_again_) {
            losses_again_ = now + kTellLosses;
            if (!writeLosses()) return;
        }
        if (const auto now = clock_.now(); ending || now >= sync_again_) {
            sync_again_ = now + kSync;
            files_.sync();
        }
        if (ending) return;
        // The rest of a record that fitted in part does not wait for the next one.
        const bool whole = files_.finish();
        waitFor(static_cast<int>((whole ? kLook : std::max(kLook, settings_.retry_first)).count()));
    }
}

/// False: the program ends, and the disk does not take it.
bool Trail::writeWaiting() {
    // No more than fit at once: what a flood costs is told while it lasts.
    for (std::size_t i = 0; i < ring_.slots(); ++i) {
        const auto* const oldest = ring_.front();
        if (oldest == nullptr) return true;
        if (!write(recordOf(*oldest))) return false;
        ring_.drop();  // a kill before this: the next life sees that it is written
    }
    return true;
}

bool Trail::writeLosses() {
    const auto tell = [this](std::atomic<std::uint64_t>& count, const char* why) {
        const auto many = count.load();
        if (many == 0) return true;
        Record record;
        record.at = utcTime(wallTimeUs());
        record.kind = toString(Kind::Lost);
        record.what = std::to_string(many) + why;
        if (!write(record)) return false;
        count.fetch_sub(many);
        return true;
    };
    return tell(lost_, " records before this one are lost: the disk did not take them in time") &&
           tell(left_out_,
                " commands and refusals before this one are left out: there were too many in a second");
}

/// Tries until it is written. False: the program ends, and the disk does not take it.
bool Trail::write(const Record& record) {
    while (!files_.append(record)) {
        if (!failed()) return false;
    }
    if (std::exchange(failing_, false)) report_("audit: records are written again");
    pause_ = settings_.retry_first;
    return true;
}

bool Trail::failed() {
    if (!std::exchange(failing_, true))
        report_("audit: the trail in " + files_.folder().string() + " cannot be written (" +
                std::generic_category().message(files_.error()) + "); " + std::to_string(settings_.waiting) +
                " records are kept, and further ones counted, until it can" + fixOf(files_.error()));
    if (ending_) {
        report_(slots_.whyNot().empty() ? "audit: what was not written waits for the next start of the "
                                          "program, unless the machine is "
                                          "restarted before"
                                        : "audit: what was not written is lost");
        return false;
    }
    waitFor(static_cast<int>(pause_.count()));
    pause_ = std::clamp(2 * pause_, settings_.retry_first, settings_.retry_most);
    return true;
}

/// Or until the end.
void Trail::waitFor(int milliseconds) {
    pollfd wanted{wake_up_.fd(), POLLIN, 0};
    ::poll(&wanted, 1, milliseconds);
}

}  // namespace axon::audit
