// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>

#include "client/direct/direct_links.hpp"
#include "client/direct/network_path.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"

namespace axon::faults {

/// The direct paths of a raw client, one for each lease that offers one: made of the client library's
/// connections and rules (docs/reference/direct.md), so that what the raw client says wrongly (a lease, a
/// generation, the same task twice) arrives by them as it does by the servers. Where no path is open,
/// everything goes by the servers.
///
/// Threads: any member from any thread; one of its own opens paths, beats and notices their end. `relay` is
/// called under its lock and calls nothing back; `hear` on the threads of LaneReaders and of Ice, one message
/// at a time and in the order of sending, but for receipts, which come on the signal lane's.
class RawPaths final : public client::DirectPathEvents, public std::enable_shared_from_this<RawPaths> {
  public:
    using Relay = std::function<void(const Header&, const std::string& bytes)>;
    using Hear = std::function<void(const Header&, std::string_view bytes)>;
    RawPaths(const client::LaneHome& signal, Relay relay, Hear hear);
    ~RawPaths() override;
    RawPaths(const RawPaths&) = delete;
    RawPaths& operator=(const RawPaths&) = delete;

    /// Once; `client` is the id that the server gave.
    void start(const std::string& client);
    /// Ends every path and the thread.
    void close();

    void offer(const std::string& entity, LeaseNumber lease, const std::string& key,
               const std::string& data_endpoint, const std::string& signal_endpoint);
    void withdraw(const std::string& entity, LeaseNumber lease);
    void left(const std::string& entity);
    void sessionLost();
    void markRefused(const std::string& entity);

    /// Gives it its number, and sends it by the path where one is open, else by the servers.
    void send(Header head, const std::string& bytes);
    /// To the Entity Managers that have a path; `order` is called with each of them.
    void signal(const std::string& entity, const std::function<void(const client::DirectPath&)>& order) const;
    /// Came by the servers on the data lane.
    void relayed(Header head, std::string_view bytes);

    bool awaitOpen(const std::string& entity, std::chrono::milliseconds time);
    /// The newest number, and how many messages have gone by a path.
    std::int64_t sequence() const { return sequence_; }
    std::size_t sent() const { return sent_; }

    void newDirectMsg(const client::DirectPath& path, direct::Keeping keeping, Header head,
                      std::string_view bytes) override;
    void newDirectReceipt(const client::DirectPath& path, const Header& head,
                          std::string_view bytes) override;
    void directChanged() override;

  private:
    void run();
    TimePoint turn();
    bool sendByPath(client::DirectLink& link, const Header& head, const std::string& bytes);
    void fallBack(const std::shared_ptr<client::DirectLink>& link);
    void fallBackFromEnded();
    void close(const client::DirectLinks::Closing& closing, const char* why);

    const client::LaneHome signal_;
    const Relay relay_;
    const Hear hear_;
    const SteadyClock clock_{};
    const std::shared_ptr<client::LaneReaders> readers_ = std::make_shared<client::LaneReaders>(clock_);
    const std::shared_ptr<client::Backlog> backlog_ = std::make_shared<client::Backlog>();
    SystemRandom random_;
    std::string client_;
    std::atomic<std::int64_t> sequence_{0};
    std::atomic<std::size_t> sent_{0};
    std::mutex order_;  ///< of what is heard; taken before mutex_
    mutable std::mutex mutex_;
    // Guarded by mutex_:
    client::DirectLinks links_;
    std::map<std::string, std::shared_ptr<client::DirectLink>> by_path_;  ///< those that are open
    std::mutex wake_mutex_;
    std::condition_variable woken_;
    // Guarded by wake_mutex_:
    bool changed_ = false, closing_ = false;
    std::thread thread_;
};

}  // namespace axon::faults
