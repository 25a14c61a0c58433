// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/heard_streams.hpp"

#include <chrono>
#include <map>
#include <memory>
#include <mutex>

namespace axon::cli {
namespace {

/// A stream is known when a sample of it comes.
constexpr std::chrono::milliseconds kListen{250};

/// The streams that an entity sends now: [name, kind], by name. Takes kListen. Threads: heard() any.
class Streams {
  public:
    void heard(const Sample& sample) {
        const auto content = Json::parse(sample.json(), nullptr, false);
        std::string kind;
        if (content.is_object()) {
            for (const auto& [name, value] : content.items())
                if (value.is_object() || name == "raw") kind = name;
        }
        const std::lock_guard lock(mutex_);
        if (kinds_.size() < kMost) kinds_.emplace(sample.stream, kind);
    }
    Json list() const {
        const std::lock_guard lock(mutex_);
        auto all = Json::array();
        for (const auto& [name, kind] : kinds_) all.push_back({{"name", name}, {"kind", kind}});
        return all;
    }

  private:
    static constexpr std::size_t kMost = 256;
    mutable std::mutex mutex_;
    std::map<std::string, std::string> kinds_;  // guarded by mutex_
};

}  // namespace

Json streamsOf(Session& session, const std::string& entity) {
    const auto streams = std::make_shared<Streams>();
    const auto watching =
        session.station->watch(entity, {}, [streams](const Sample& sample) { streams->heard(sample); });
    if (!watching) return Json::array();
    Mailbox nothing;
    nothing.wait(std::chrono::steady_clock::now() + kListen);
    return streams->list();
}

}  // namespace axon::cli
