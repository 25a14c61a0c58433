// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <asio/strand.hpp>
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_manager/core/entity_manager_core.hpp"
#include "entity_manager/links/back_end/back_end_interface.hpp"
#include "entity_manager/links/datagrams/datagram_desk.hpp"
#include "entity_manager/links/direct/direct_desk.hpp"
#include "entity_manager/links/direct/direct_door.hpp"
#include "entity_manager/links/server/entity_communicator.hpp"
#include "entity_manager/strand/caller_first.hpp"
#include "entity_manager/strand/due_timer.hpp"
#include "entity_manager/strand/inbox.hpp"
#include "transport/process/service_manager.hpp"

namespace axon::entity_manager {

/// One Entity Manager as it runs: the core on a strand, the link to its robot application and the sessions
/// with the server (thesis: EntityManager). The daemon has one; a benchmark has thousands on one executor and
/// one pair of communicators.
///
/// Threads: everything is confined to the strand, which a thread that brings data or control messages takes
/// itself when it is free; but the way of a stop: the signal thread writes it to the Entity Interfacer,
/// raises the generation, and only then tells the strand (ADR 0007); it also counts the server's heartbeats,
/// and tells nobody. Nothing that the server
/// pushes on the signal lane takes a lock that data holds. Ownership: a shared object, because pushes of the
/// server may be under way while it ends. stop() before the last reference is dropped.
class EntityManager final : public ServerEvents,
                            public DirectEvents,
                            private BackEndEvents,
                            public std::enable_shared_from_this<EntityManager> {
  public:
    using Strand = asio::strand<CallerFirst>;
    /// The link to the robot application, and what begins it; a benchmark puts one in memory here.
    struct BackEnd {
        std::unique_ptr<BackEndPort> port;
        std::function<void()> start, close;
    };
    using BackEndFactory =
        std::function<BackEnd(const Strand&, const StopGenerations&, const Clock&, BackEndEvents&)>;
    /// The one over TCP.
    static BackEndFactory overTcp(BackEndSettings settings, RandomSource& random);

    /// The executor's threads run the strand; it and all references must outlive the object.
    static std::shared_ptr<EntityManager> create(asio::any_io_executor executor,
                                                 std::shared_ptr<ServerCommunicators> ice,
                                                 EntityManagerCoreSettings settings, ServerAddress server,
                                                 const BackEndFactory& back_end, const Clock& clock,
                                                 RandomSource& random, Storage& storage,
                                                 ResourceStore& resources, Journal* journal = nullptr);
    ~EntityManager() override;

    /// Before start(): stops may arrive as datagrams too, once there is a session with the server. Costs a
    /// thread.
    void receiveDatagrams(const DatagramSettings& settings, const Clock& clock);
    /// Null when they are not received.
    const DatagramDesk* datagrams() const { return datagrams_.get(); }

    /// Before start(): the holder may talk to it without the servers in between (docs/reference/direct.md).
    /// Costs three threads: that of the signal lane, one that watches its port, and one that reads data;
    /// where the way to the server is TLS, so is this one, and one more sets up its connections. Without
    /// effect where the way to the server leads through a router.
    void offerDirect(const DirectSettings& settings);
    /// Whether the holder does; any thread, as of the last event.
    bool direct() const { return direct_.load(); }

    /// Before start(): the strand calls it from then on, and again after the real time that it returns, until
    /// stop().
    void watchedBy(transport::ServiceWatchdog::Worker turned);

    void start();
    /// Stops the robot, leaves the server, closes the link. Blocks until the strand has done so (below a
    /// second).
    void stop();

    /// Copies made on the strand after each event; any thread.
    EntityState state() const { return state_.load(); }
    const std::string& uuid() const { return core_->uuid(); }

    // ServerEvents, on Ice's threads.
    void serverUp() override;
    void serverDown(const std::string& reason) override;
    void clientMsg(Lane lane, Header head, std::string bytes) override;
    void clientMsgDataSeq(Header head, std::string bytes) override;
    void stopSignal(Header head, StopCause cause) override;
    void resetSignal(Header head) override;
    void clearSignal(Header head) override;
    void clientUpdate(Header head, ClientChange change) override;
    void serverHeartbeat() override;
    void undeliverable(Lane lane, Header head, const Refusal& refusal) override;

    // DirectEvents, on the strand and on Ice's thread.
    void directOpening(DirectOpening opening) override;
    bool directMsg(const Id128& path, direct::Keeping keeping, Header& head, std::string& bytes) override;
    void directTurnEnded() override;
    void directStop(Header head, StopCause cause) override;
    void directReset(Header head) override;
    void directClear(Header head) override;
    void directPace() override;
    void directClosed(const Id128& path, const std::string& why) override;

  private:
    enum class WayToServer : std::uint8_t { Plain, Tls, Router };
    EntityManager(asio::any_io_executor executor, std::string name, const Clock& clock,
                  std::shared_ptr<ServerCommunicators> ice, WayToServer way);

    // BackEndEvents, on the strand.
    void onLinkUp() override;
    void onLinkDown(const std::string& reason, LinkEnd end) override;
    void onLinkMessage(const proto::EiToEm& message) override;
    void onLinkRefused(const Refusal& refusal) override;
    void onLinkSought(const SearchReport& report) override;
    void onLinkSlow(const std::string& what) override;
    void onLinkRelease(const std::string& note) override;

    /// To the robot, and into the inbox. The executor, whose lock everything takes, is woken after it.
    Inbox::Verdict passStop(Header head, StopCause cause);
    /// Of all others.
    Inbox::Verdict passSignal(Inbox::Signal kind, Inbox::Event event, SenderKey from = kServersOwn);
    /// On the strand, of one that came by the servers.
    void handleRelayed(direct::Keeping keeping, const Header& head, const std::string& bytes);
    /// On the strand, of one that came by the direct path. Whether afterEvents() has nothing to look at.
    bool handleDirect(const Id128& path, direct::Keeping keeping, Header& head, std::string& bytes);
    template <class Use>
    void onStrand(Use use);
    /// Where the strand's turn is taken: at once in this thread if the strand is free, or by the executor.
    /// Signal threads never do the strand's work.
    enum class RunOn : std::uint8_t { Here, Executor };
    void wake(Inbox::Verdict verdict, RunOn where = RunOn::Executor);
    /// An Ice thread may run it: what escaped here would be swallowed there, and leave a manager that hears
    /// nothing.
    void drain() noexcept;
    void afterEvents();
    /// Messages of the direct path wait for room, and there is some.
    void letDirectGoOn();
    void armTimer();
    void turn();

    Strand strand_;
    const std::string name_;
    const Clock& clock_;
    Inbox inbox_;
    std::mutex signal_mutex_;  // of the threads that bring signals: stops reach robot and inbox in the order
                               // of their generations
    StopGenerations stop_generations_;
    BackEnd back_end_;
    const std::shared_ptr<ServerCommunicators> ice_;
    const WayToServer way_;
    std::unique_ptr<EntityCommunicator> server_;
    std::unique_ptr<DirectDesk> direct_desk_;  // between it and the core
    std::unique_ptr<DirectDoors> doors_;       // null: no direct path is offered
    ResourceStore* resources_ = nullptr;
    Journal* journal_ = nullptr;
    std::unique_ptr<EntityManagerCore> core_;
    DueTimer timer_;
    transport::ServiceWatchdog::Worker turned_;  // empty: there is no ServiceWatchdog
    const SteadyClock steady_{};                 // of turned_, also where the laboratory's time stands
    DueTimer turn_timer_;                        // of turned_
    std::atomic<EntityState> state_{EntityState::UNAV};
    std::atomic<bool> direct_{false};
    std::atomic<int> openings_{0};             // that wait for the strand
    std::atomic<bool> leaving_{false};         // a control overflow on its way to the strand
    std::optional<std::size_t> direct_waits_;  // the bytes for which the direct path needs room
    int passed_on_ = 0;                        // messages of this turn that have changed nothing here
    bool direct_changed_ = false;              // by what came by the direct path in this turn
    bool latched_ = false;
    bool stopped_ = false;
    std::unique_ptr<DatagramDesk> datagrams_;  // last, so that its thread ends first
};

}  // namespace axon::entity_manager
