// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/trail.hpp"

#include <poll.h>
#include <pthread.h>

#include <algorithm>
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

Record startOf(const std::string& started, std::uint64_t unfinished) {
    Record record;
    record.at = utcTime(wallTimeUs());
    record.kind = toString(Kind::Started);
    record.what = started;
    if (unfinished > 0)
        record.what +=
            "; the line before this record was not finished (" + std::to_string(unfinished) + " bytes)";
    return record;
}

}  // namespace

Trail::Trail(const TrailSettings& settings, const std::string& name, const std::string& started,
             Report report, Files::Write write)
    : settings_(settings),
      report_(std::move(report)),
      ring_(settings.waiting),
      limit_(settings.per_second),
      files_(settings.folder, name, settings.files, std::move(write)),
      pause_(settings.retry_first) {
    if (files_.unfinished() > 0)
        report_("audit: the last record of the trail in " + files_.folder().string() +
                " was not finished: the program was killed, or the machine lost its power");
    thread_ = std::thread([this, first = startOf(started, files_.unfinished())] {
        pthread_setname_np(pthread_self(), "axon-audit");
        if (this->write(first)) run();
    });
}

Trail::~Trail() {
    ending_ = true;
    wake_up_.wake();
    thread_.join();
}

void Trail::note(const Note& note) {
    if ((note.kind == Kind::Command || note.kind == Kind::Refusal) && !limit_.admit(clock_.now())) {
        left_out_.fetch_add(1, std::memory_order_relaxed);
    } else if (!ring_.push(note, wallTimeUs())) {
        lost_.fetch_add(1, std::memory_order_relaxed);
    }
    if (note.kind == Kind::Stop) return;  // the thread finds it within kLook; waking it costs a stop too much
    // A system call only where its thread sleeps. The exchange orders this after the push, and the thread
    // looks into the queue after its own exchange: one of the two sees the other.
    if (sleeping_.exchange(false)) wake_up_.wake();
}

void Trail::run() {
    Ring::Kept kept;
    while (true) {
        if (ring_.pop(kept)) {
            if (!write(recordOf(kept))) return;
            continue;
        }
        if (!writeLosses()) return;
        sleeping_.exchange(true);
        if (ring_.pop(kept)) {
            sleeping_.exchange(false);
            if (!write(recordOf(kept))) return;
            continue;
        }
        if (ending_) return;
        // The rest of a record that fitted in part does not wait for the next one.
        const bool whole = files_.finish();
        waitFor(static_cast<int>((whole ? kLook : std::max(kLook, settings_.retry_first)).count()));
        sleeping_.exchange(false);
    }
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
                " records are kept, and further ones counted, until it can; fix: make room on the disk");
    if (ending_) {
        report_("audit: what was not written is lost");
        return false;
    }
    waitFor(static_cast<int>(pause_.count()));
    pause_ = std::clamp(2 * pause_, settings_.retry_first, settings_.retry_most);
    return true;
}

/// Or until it is woken.
void Trail::waitFor(int milliseconds) {
    pollfd wanted{wake_up_.fd(), POLLIN, 0};
    ::poll(&wanted, 1, milliseconds);
    if (!ending_) wake_up_.drain();
}

}  // namespace axon::audit
