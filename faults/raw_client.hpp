// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::faults {

/// What a check-out gave.
struct Grant {
    LeaseNumber lease;
    std::int32_t generation = 0;
    bool latched = false;
};

/// A client that speaks the contracts without the client library (docs/reference/sessions.md), and so may say
/// what a proper client never would: a lease that is not its own, a generation of long ago, the same task
/// twice.
///
/// Both lanes, and a direct path for each lease that offers one (RawPaths); a thread of its own sends
/// keepAlive. Threads: any member from any thread; `heard` is called on Ice's. Failure: the constructor
/// throws std::runtime_error when there is no session; what is sent after the connection has gone is lost
/// without a word, as on a wire.
class RawClient {
  public:
    using Heard = std::function<void(const Header&, const proto::ToClient&)>;
    /// Before anybody else hears it; messages are kept for await() as well, the newest 4,096.
    RawClient(const std::string& address, const std::string& name, Heard heard = {});
    ~RawClient();
    RawClient(const RawClient&) = delete;
    RawClient& operator=(const RawClient&) = delete;

    /// Both connections stand; false once the server has given it up.
    bool connected() const;
    const std::string& name() const;
    const std::string& id() const;
    /// The UUID of the entity of this name once it is there and free or held; empty when the time is up.
    std::string entity(const std::string& name, std::chrono::milliseconds time);
    /// Whether the server takes it for reachable: neither UNAV nor gone.
    bool available(const std::string& entity) const;

    void send(const std::string& entity, const char* type, const proto::ToEntity& body,
              LeaseNumber lease = {}, std::int32_t generation = 0);
    void stop(const std::string& entity);
    void reset(const std::string& entity);
    void clear(const std::string& entity);

    /// The first message of the entity, heard since the last forget(), for which this holds; it is taken out.
    std::optional<proto::ToClient> await(const std::string& entity,
                                         const std::function<bool(const proto::ToClient&)>& holds,
                                         std::chrono::milliseconds time = std::chrono::seconds{3});
    void forget();
    /// The lease that this session was given last, whether it is still good or not.
    std::optional<LeaseNumber> lease(const std::string& entity) const;
    /// Whether the direct path of the entity is open, within this time: what is sent from now on goes by it.
    bool awaitDirect(const std::string& entity, std::chrono::milliseconds time);
    /// How many messages have gone by direct paths.
    std::size_t sentDirectly() const;
    /// Told by the server itself: it could not deliver so many messages.
    std::size_t undelivered() const;

    // Conversations of several messages.
    Result<Grant> checkOut(const std::string& entity, bool force = false,
                           std::chrono::milliseconds time = std::chrono::seconds{8});
    bool release(const std::string& entity, LeaseNumber lease);
    Result<void> rearm(const std::string& entity, LeaseNumber lease, std::int32_t generation);
    /// Stops, and waits until the callback has returned; the generation then.
    std::optional<std::int32_t> stopAndWait(const std::string& entity);
    /// The state of the task once it runs or has ended.
    std::optional<proto::TaskEvent> run(const std::string& entity, const proto::TaskRequest& task,
                                        LeaseNumber lease, std::int32_t generation, bool until_final = false);
    /// Nothing when the question or its answer was lost: at once where the server says so, else in half a
    /// second.
    std::optional<proto::EntityStatus> status(const std::string& entity);

  private:
    class Session;
    std::shared_ptr<Session> session_;
};

/// 16 random bytes.
std::string newId();
/// As the log of motions writes a task's id.
std::string idText(const std::string& bytes);
proto::TaskRequest stepTask(const std::string& id, double seconds = 0.001, double not_after_s = 0);
proto::TaskRequest driveTask(const std::string& id);

}  // namespace axon::faults
