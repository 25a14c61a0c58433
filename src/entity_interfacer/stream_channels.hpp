// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <string_view>

namespace axon {

/// The application's streams by name, and which of them the Entity Manager wants: all, until it says
/// otherwise.
///
/// Threads: any; a sender reads `wanted` of its channel without a lock. The mutex is held for a look or a
/// change, never while anything is sent or user code runs; the stop thread takes it only where onStop itself
/// asks for a stream. Bounded: kMax wanted names; more are not wanted by name. Channels are bounded by the
/// names that the application uses.
///
/// `Channel` is Stream::Channel; a test has its own, with an atomic `wanted`.
template <class Channel>
class StreamChannels {
  public:
    static constexpr std::size_t kMax = 4096;

    /// The one channel of this name; `make` makes it where there is none yet.
    template <class Make>
    std::shared_ptr<Channel> channel(const std::string& name, Make make) {
        const std::lock_guard lock(mutex_);
        auto& channel = channels_[name];
        if (!channel) {
            channel = make();
            channel->wanted = isWanted(name);
        }
        return channel;
    }
    /// A link begins with all of them wanted.
    void linkBegins() {
        const std::lock_guard lock(mutex_);
        all_ = true;
        by_name_.clear();
        tellChannels();
    }
    /// The Entity Manager wants a stream from now on, or no longer; the name "" stands for all.
    void switchTo(bool on, const std::string& stream) {
        const std::lock_guard lock(mutex_);
        if (stream.empty())
            all_ = on;
        else if (!on)
            by_name_.erase(stream);
        else if (by_name_.size() < kMax)
            by_name_.insert(stream);
        tellChannels();
    }

  private:
    bool isWanted(const std::string& name) const { return all_ || by_name_.contains(name); }
    void tellChannels() {
        for (const auto& [name, channel] : channels_) channel->wanted = isWanted(name);
    }

    std::mutex mutex_;
    std::map<std::string, std::shared_ptr<Channel>, std::less<>> channels_;  // these three guarded by mutex_
    bool all_ = true;
    std::set<std::string, std::less<>> by_name_;
};

}  // namespace axon
