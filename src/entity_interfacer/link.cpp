// SPDX-License-Identifier: MIT
#include "entity_interfacer/link.hpp"

#include <axon/link.pb.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "common/message_frame.hpp"

namespace axon {
namespace {
constexpr std::size_t kFramesMax = 1024;
constexpr std::size_t kBytesMax = 4 * 1024 * 1024;
constexpr std::size_t kDroppableMax = 256;
}  // namespace

Link::Link(Descriptor signal, FrameReader from_signal, Descriptor data, FrameReader from_data,
           std::string who, const WakeUp& data_thread)
    : manager(std::move(who)),
      signal_reader(std::move(from_signal)),
      data_reader(std::move(from_data)),
      signal_(std::move(signal)),
      data_(std::move(data)),
      data_thread_(data_thread) {
    signal_reader.setLimit(kFrameMax);
    data_reader.setLimit(kFrameMax);
}

void Link::condemn(const std::string& reason) {
    {
        const std::lock_guard lock(reason_mutex_);
        if (reason_.empty()) reason_ = reason;
    }
    lost_.store(true, std::memory_order_release);
}

void Link::cut(const std::string& reason, bool stopped) {
    condemn(reason);
    if (!closed_.exchange(true, std::memory_order_acq_rel)) {
        // Best effort: it is lost where the other side has gone or the socket is full.
        proto::EiToEm last;
        last.mutable_end()->set_reason(this->reason());
        last.mutable_end()->set_stopped(stopped);
        std::string frame;
        if (appendFrameOf(frame, last))
            static_cast<void>(::send(signal_.get(), frame.data(), frame.size(), MSG_DONTWAIT | MSG_NOSIGNAL));
    }
    ::shutdown(signal_.get(), SHUT_RDWR);
    ::shutdown(data_.get(), SHUT_RDWR);
}

std::string Link::reason() const {
    const std::lock_guard lock(reason_mutex_);
    return reason_;
}

void Link::sendSignal(const proto::EiToEm& message) {
    std::string frame;
    if (!appendFrameOf(frame, message)) return;
    const auto sent = ::send(signal_.get(), frame.data(), frame.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent != static_cast<ssize_t>(frame.size()) && !lost())
        cut(sent < 0 && errno != EAGAIN ? std::string("signal connection: ") + std::strerror(errno)
                                        : "the Entity Manager does not read its signal connection");
}

bool Link::sendData(const proto::EiToEm& message, Kind kind) {
    std::string frame;
    if (!appendFrameOf(frame, message)) return false;
    if (closed_.load(std::memory_order_acquire)) return true;
    const std::lock_guard lock(data_mutex_);
    bytes_ += frame.size();
    if (kind == Kind::Droppable) ++droppable_;
    waiting_.push_back({std::move(frame), kind});
    writeLocked();
    // The first may be half written, so it stays.
    while (droppable_ > kDroppableMax || (droppable_ > 0 && bytes_ > kBytesMax)) {
        const auto oldest = std::find_if(waiting_.begin() + (written_ > 0 ? 1 : 0), waiting_.end(),
                                         [](const Waiting& w) { return w.kind == Kind::Droppable; });
        if (oldest == waiting_.end()) break;
        bytes_ -= oldest->bytes.size();
        --droppable_;
        waiting_.erase(oldest);
    }
    if (waiting_.size() > kFramesMax || bytes_ > kBytesMax + kFrameMax)
        cut("the Entity Manager does not read its data connection: the queue to it is full");
    return true;
}

void Link::flush() {
    const std::lock_guard lock(data_mutex_);
    writeLocked();
}

void Link::writeLocked() {
    while (!waiting_.empty()) {
        const auto& first = waiting_.front();
        const auto sent = ::send(data_.get(), first.bytes.data() + written_, first.bytes.size() - written_,
                                 MSG_DONTWAIT | MSG_NOSIGNAL);
        if (sent < 0) {
            if (errno == EINTR) continue;
            if (errno != EAGAIN && !lost()) cut(std::string("data connection: ") + std::strerror(errno));
            break;
        }
        written_ += static_cast<std::size_t>(sent);
        if (written_ < first.bytes.size()) continue;
        bytes_ -= first.bytes.size();
        if (first.kind == Kind::Droppable) --droppable_;
        waiting_.pop_front();
        written_ = 0;
    }
    const bool now = !waiting_.empty() && !lost();
    if (pending_.exchange(now, std::memory_order_acq_rel) != now && now) data_thread_.wake();
}

}  // namespace axon
