// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <asio/thread_pool.hpp>
#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "client/connection/communicators.hpp"
#include "client/connection/server_connection.hpp"
#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "entity_manager/links/server/entity_communicator.hpp"
#include "entity_manager/strand/due_timer.hpp"
#include "partner/partner_core.hpp"
#include "partner/ports.hpp"
#include "partner/queues.hpp"
#include "partner/signal_relay.hpp"
#include "transport/process/service_manager.hpp"

namespace axon::partner {

/// How to reach the partner's laboratory and this one.
struct GatewaySettings {
    PartnerCoreSettings core;
    client::Options there;               ///< server, user, password and properties, as a client has them
    entity_manager::ServerAddress home;  ///< as an Entity Manager has it; its secret is made for each entity
    std::map<std::string, std::string>
        home_properties;  ///< Ice.* and IceSSL.*, as an Entity Manager has them
    std::string secret;   ///< 32 bytes, kept: from it are made the UUIDs of the entities at home
};

/// The rim of PartnerCore and SignalRelay: the sessions in both laboratories, over the connections that
/// clients and Entity Managers have, and the threads.
///
/// Threads: one runs the strand of the core; two open visitors' sessions there, which waits for the server,
/// two the session that watches and that for stops, and one leaves them; Ice's are those of a client and of
/// an Entity Manager, where signals and data have each their own. A signal is passed on by the thread on
/// which it comes. Bounds: kWaitingControl and kWaitingData wait for the strand. Droppable data beyond is
/// dropped; a control message too many ends all sessions there (PartnerCore::onOverflow). Of one client of
/// home, what is in its StrandShares; the rest of it is refused or dropped. Of one session there, likewise;
/// beyond it this session ends. Of the session that watches, only receipts have a share, and are dropped
/// beyond it. Ends of sessions are not counted.
class Gateway final : public HomePort, public TherePort, public std::enable_shared_from_this<Gateway> {
  public:
    static constexpr std::size_t kWaitingData = std::size_t{8} * 1024 * 1024;
    static constexpr std::size_t kWaitingControl = std::size_t{128} * 1024 * 1024;
    static constexpr std::size_t kOfClients = std::size_t{20} * 1024 * 1024;
    static constexpr std::size_t kOfSessions = std::size_t{64} * 1024 * 1024;
    static_assert(
        kOfClients + kOfSessions + StrandShares::kAllRefusals + (4096 + 2 * 202) * StrandShares::kLeast <
            kWaitingControl,
        "what all clients of a server and the sessions of 200 visitors may take does not end all sessions");

    /// Throws std::runtime_error for settings that Ice does not accept.
    static std::shared_ptr<Gateway> create(GatewaySettings settings, const Clock& clock);
    ~Gateway() override;

    /// Before start(): the strand calls it from then on, and again after the real time that it returns, until
    /// stop().
    void watchedBy(transport::ServiceWatchdog::Worker turned);

    void start();
    /// Ends all sessions in order and joins the threads; blocks.
    void stop();

  private:
    class HomeLink;
    class Session;

    Gateway(GatewaySettings settings, const Clock& clock);

    /// On the strand. `bytes`: what it takes while it waits.
    void post(std::function<void(PartnerCore&)> event);
    /// False: it was dropped.
    bool postBounded(std::size_t bytes, bool droppable, std::function<void(PartnerCore&)> event);
    /// The same, of what the share of this client, or session there, has taken.
    void postShare(StrandShares& shares, const std::string& client, StrandShares::Verdict verdict,
                   std::size_t bytes, bool droppable, std::function<void(PartnerCore&)> event);
    void turn();
    void feed();

    // On the threads of signals.
    void stopSignal(const ShownEntity& entity, const Header& head, StopCause cause);
    void command(client::Operation operation, const ShownEntity& entity, const Header& head);
    std::shared_ptr<const client::ServerConnection> connectionOf(const std::string& client) const;
    void leaveSoon(std::shared_ptr<const client::ServerConnection> connection);

    // HomePort, on the strand.
    std::string uuidAtHome(std::string_view there) override;
    std::string strangerAtHome(std::string_view id) override;
    void join(const ShownEntity& entity) override;
    void leave(const std::string& home) override;
    void renew(const std::string& home) override;
    void show(const Registration& registration, const proto::BasicProfile& profile) override;
    void tellStatus(const EntityStatus& status) override;
    void toClient(Lane lane, const Header& head, const std::string& bytes) override;
    void toClientDataSeq(const Header& head, const std::string& bytes) override;

    // TherePort, on the strand.
    void open(SessionNumber session, const std::string& display_name, Use use) override;
    void stopsBy(SessionNumber session, bool shared) override;
    void visits(SessionNumber session, const Sender& client) override;
    bool send(SessionNumber session, client::Operation operation, const Header& head,
              std::string bytes) override;
    void keepAlive(SessionNumber session, std::int64_t sequence) override;
    void leave(SessionNumber session) override;
    void drop(SessionNumber session) override;

    std::string derived(std::string_view what, std::string_view id) const;
    std::shared_ptr<const client::ServerConnection> connectionOf(SessionNumber session) const;
    std::shared_ptr<Session> forget(SessionNumber session);
    void openNext();
    void logIn(asio::thread_pool& threads, SessionNumber session, const std::shared_ptr<Session>& its);
    void closed(SessionNumber session, const std::string& reason);

    // Constant after construction.
    const GatewaySettings settings_;
    const Clock& clock_;
    asio::thread_pool executor_{1}, openers_{Openings::kAtOnce}, standing_{2}, leavers_{1};
    const asio::any_io_executor strand_;
    const std::shared_ptr<entity_manager::ServerCommunicators> home_ice_;
    client::Communicators there_ice_;
    SignalRelay signals_;
    RateLimit warnings_{10};                  // of stops that were not passed on
    std::atomic<std::size_t> waiting_{0};     // bytes
    StrandShares shares_{kOfClients};         // of clients at home
    StrandShares there_shares_{kOfSessions};  // of sessions there; of that which watches, receipts
    std::atomic<std::size_t> leaving_{0};
    std::atomic<bool> overflown_{false};
    std::atomic<bool> stopping_{false};
    transport::ServiceWatchdog::Worker
        turned_;  // empty: there is no ServiceWatchdog; constant from start() on

    // Confined to the strand.
    PartnerCore core_;
    entity_manager::DueTimer timer_;
    const SteadyClock steady_{};           // of turned_, also where the laboratory's time stands
    entity_manager::DueTimer feed_timer_;  // of turned_
    std::map<std::string, std::shared_ptr<HomeLink>> links_;  // by UUID at home
    std::map<SessionNumber, std::shared_ptr<Session>> sessions_;
    Openings openings_;

    mutable std::mutex visitors_mutex_;
    /// By client at home. Guarded by visitors_mutex_.
    std::map<std::string, std::shared_ptr<const client::ServerConnection>> visitors_;
};

}  // namespace axon::partner
