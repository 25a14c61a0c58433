// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/logging.hpp"

#include <pthread.h>
#include <spdlog/async.h>
#include <spdlog/sinks/base_sink.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <iterator>
#include <memory>
#include <mutex>

namespace axon::transport {
namespace {

constexpr std::size_t kLines = 4096;
constexpr std::chrono::milliseconds kExitWait{500};

bool isControl(char c) {
    const auto byte = static_cast<unsigned char>(c);
    return byte < 0x20 || byte == 0x7f;
}

// Writes past the C library's stream, whose lock would be held while nobody reads, and is asked for at exit.
class PlainLineSink final : public spdlog::sinks::base_sink<std::mutex> {
  public:
    void waitForFlush() {
        std::unique_lock lock(flush_mutex_);
        changed_.wait_for(lock, kExitWait, [this] { return flushed_; });
    }

  protected:
    void sink_it_(const spdlog::details::log_msg& message) override {
        auto plain = message;
        std::string line;
        if (std::any_of(message.payload.begin(), message.payload.end(), isControl)) {
            line = withoutControls({message.payload.data(), message.payload.size()});
            plain.payload = line;
        }
        spdlog::memory_buf_t text;
        formatter_->format(plain, text);
        const char* next = text.data();
        std::size_t left = text.size();
        while (left > 0) {
            const auto written = ::write(STDERR_FILENO, next, left);
            if (written < 0 && errno == EINTR) continue;
            if (written <= 0) return;  // nobody is there to be told
            next += written;
            left -= static_cast<std::size_t>(written);
        }
    }
    void flush_() override {
        {
            const std::lock_guard lock(flush_mutex_);
            flushed_ = true;
        }
        changed_.notify_all();
    }

  private:
    std::mutex flush_mutex_;
    std::condition_variable changed_;
    bool flushed_ = false;  // guarded by flush_mutex_; flushing happens at exit only
};

struct Log {
    std::shared_ptr<PlainLineSink> sink = std::make_shared<PlainLineSink>();
    std::shared_ptr<spdlog::details::thread_pool> writer = std::make_shared<spdlog::details::thread_pool>(
        kLines, 1, [] { pthread_setname_np(pthread_self(), "axon-log"); });
    std::shared_ptr<spdlog::async_logger> logger = std::make_shared<spdlog::async_logger>(
        "axon", sink, writer, spdlog::async_overflow_policy::overrun_oldest);
};
// Never destroyed: the writer's destructor joins its thread, which may wait for standard error for ever.
Log* the_log = nullptr;

}  // namespace

void logToStderr(const std::string& level) {
    if (the_log == nullptr) {
        the_log = new Log;
        spdlog::set_default_logger(the_log->logger);
        spdlog::set_pattern("%Y-%m-%d %H:%M:%S.%e %l %v");
        std::atexit(flushLog);
    }
    spdlog::set_level(spdlog::level::from_str(level));
}

bool isLogLevel(std::string_view level) {
    static constexpr std::string_view kNames[] = {"trace", "debug", "info",     "warning",
                                                  "warn",  "error", "critical", "off"};
    return std::find(std::begin(kNames), std::end(kNames), level) != std::end(kNames);
}

void flushLog() {
    if (the_log == nullptr) return;
    the_log->logger->flush();
    the_log->sink->waitForFlush();
}

std::string withoutControls(const std::string& line) {
    static constexpr char kHex[] = "0123456789abcdef";
    std::string plain;
    plain.reserve(line.size());
    for (const char c : line) {
        if (isControl(c)) {
            const auto byte = static_cast<unsigned char>(c);
            plain += "\\x";
            plain += kHex[byte >> 4U];
            plain += kHex[byte & 15U];
        } else {
            plain += c;
        }
    }
    return plain;
}

}  // namespace axon::transport
