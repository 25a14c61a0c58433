// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <utility>

#include "entity_manager/core/entity_manager_core.hpp"
#include "entity_manager/links/direct/direct_desk.hpp"
#include "entity_manager/strand/inbox.hpp"
#include "simulation/direct_ways.hpp"
#include "simulation/network.hpp"
#include "simulation/observer.hpp"
#include "simulation/server_station.hpp"

namespace axon::simulation {

class RobotApplication;

/// What survives the death of an Entity Manager's process.
class Disk final : public entity_manager::Storage,
                   public entity_manager::ResourceStore,
                   public entity_manager::Journal {
  public:
    std::optional<std::string> load(std::string_view key) override;
    void save(std::string_view key, std::string_view value) override;
    void forget(std::string_view key) override;
    entity_manager::Later<Result<std::uint64_t>> begin(const proto::ResourceOffer&,
                                                       const std::string&) override;
    Result<void> write(std::string_view, std::uint64_t, std::string_view) override { return {}; }
    entity_manager::Later<Result<std::string>> check(std::string_view) override;
    entity_manager::Later<Result<std::string>> place(std::string_view) override;
    void suspend(std::string_view) override {}
    void drop(std::string_view) override {}
    void remove(std::string_view, std::string_view) override {}
    std::optional<std::string> find(std::string_view, std::string_view) override { return std::nullopt; }
    bool append(const entity_manager::JournalRecord& record) override;
    void replay(const std::function<void(const entity_manager::JournalRecord&)>& each) override;

    std::function<void(const entity_manager::JournalRecord&)> noted;

  private:
    std::map<std::string, std::string, std::less<>> values_;
    std::vector<entity_manager::JournalRecord> records_;
};

/// An Entity Manager's process: EntityManagerCore, DirectDesk, StopGenerations and Inbox as the daemon has
/// them. In place of Ice, of the TCP link and of the strand: connections of the simulated network, and an
/// event in which the strand comes some microseconds after something was put into the inbox, while a stop
/// passes at once.
class EntityManagerStation final : public entity_manager::BackEndPort,
                                   public entity_manager::ServerPort,
                                   public DirectListener {
  public:
    struct Mischief {        ///< what the network does to messages of clients and to stops on their way here
        double repeats = 0;  ///< part of the messages that come once more
        Duration repeats_within{};
    };

    EntityManagerStation(Timeline& timeline, Network& network, Dice& dice, Observer& observer,
                         ServerStation& server, Process& outside, RobotApplication& application,
                         std::size_t entity, std::uint64_t seed);
    ~EntityManagerStation() override;

    Process& process() { return process_; }
    Path& serverPath() { return server_path_; }
    Path& loopback() { return loopback_; }
    Mischief& mischief() { return mischief_; }
    void start();
    void kill();
    /// The application's process has been frozen or goes on.
    void applicationFrozen();
    const entity_manager::EntityManagerCore* core() const;
    /// What the holder said last to open a path, for whoever listens on the wire; nothing there is encrypted.
    const std::optional<SaidOpening>& overheard() const { return overheard_; }

    // From the application, as this process.
    void linkAnswered(std::uint64_t attempt, std::uint64_t link);
    void linkMessage(std::uint64_t link, const std::string& bytes);
    void stopDone(std::uint64_t link, std::uint32_t generation);
    void drillDone(std::uint64_t link, std::uint32_t number);

    // From the server, as this process.
    void welcomed(std::uint64_t attempt, ServerStation::EntitySession& session, const std::string& token);
    void attached(std::uint64_t attempt);
    void registered(std::uint64_t attempt, bool ok);
    void newClientMsg(std::uint64_t attempt, const Header& head, const std::string& bytes,
                      bool repeated = false);
    void newClientMsgDataSeq(std::uint64_t attempt, const Header& head, const std::string& bytes);
    void stopSignal(std::uint64_t attempt, const Header& head, StopCause cause, bool repeated = false);
    void resetSignal(std::uint64_t attempt, const Header& head);
    void clearSignal(std::uint64_t attempt, const Header& head);
    void newClientUpdate(std::uint64_t attempt, const Header& head, ClientChange change);
    void newHeartbeat(std::uint64_t attempt);

    // DirectListener.
    Process& listeningProcess() override { return process_; }
    void challenge(Connection& connection, Lane port, std::weak_ptr<DirectCaller> caller) override;
    void open(Connection& connection, Lane port, const SaidOpening& said,
              std::weak_ptr<DirectCaller> caller) override;
    void sendToEntity(Connection& connection, direct::Keeping keeping, const Header& head,
                      const std::string& bytes) override;
    void sendStopSignal(Connection& connection, const Header& head, StopCause cause) override;
    void sendResetSignal(Connection& connection, const Header& head) override;
    void sendClearSignal(Connection& connection, const Header& head) override;
    void keepAlive(Connection& connection, std::int64_t received, bool busy) override;

    // BackEndPort.
    bool send(const proto::EmToEi& message) override;
    void stop(std::uint32_t generation, StopCause cause) override;
    void setBusy(bool busy) override;
    // ServerPort.
    void wantConnection(bool wanted) override;
    void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) override;
    void sendStatus(const EntityStatus& status) override;
    void sendToClient(Lane lane, const Header& head, const proto::ToClient& message) override;
    void sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) override;
    void sendToClientDataSeq(const Header& head, const proto::ToClient& message) override;

  private:
    struct Life;
    class Servers;
    class BackLane;
    bool hears(std::uint64_t attempt) const;
    void wakeStrand(entity_manager::Inbox::Verdict verdict);
    void drain();
    void settle();
    void handleRelayed(direct::Keeping keeping, const Header& head, const std::string& bytes, bool repeated);
    void handleClientMsg(const Header& head, const std::string& bytes);
    void passStop(const Header& head, StopCause cause);
    void passReset(const Header& head);
    void passClear(const Header& head);
    void armAlarm();
    /// On the strand, as EntityManager::onStrand does it.
    template <class Use>
    void onStrand(Use use);
    std::shared_ptr<entity_manager::DirectLane> admit(
        Connection& connection, Lane lane, const Id128& path, const Sender& sender,
        const std::shared_ptr<entity_manager::DirectSigns>& signs, const std::string& proof,
        const std::weak_ptr<DirectCaller>& caller);
    std::optional<Header> properHead(const Connection& connection, Lane lane, const Header& said) const;
    void pathEnds(const std::string& why, bool honest);
    void closed(const Connection& connection);
    // The link.
    void look();
    void lookIn(Duration time);
    void linkLost(std::uint64_t link, const char* reason,
                  entity_manager::LinkEnd end = entity_manager::LinkEnd::Closed);
    void judgeSilence();
    void beat();
    // The server.
    void login();
    void serverLost(std::uint64_t attempt, const char* reason);
    void dropServer();
    void keepAlive();

    Timeline& timeline_;
    Network& network_;
    Dice& dice_;
    Observer& observer_;
    ServerStation& server_;
    Process& outside_;
    RobotApplication& application_;
    const std::size_t entity_;
    Process process_;
    Path server_path_;
    Path loopback_;
    Mischief mischief_;
    SeededRandom random_;
    Disk disk_;
    std::optional<SaidOpening> overheard_;
    Alarm alarm_, beat_;
    std::uint64_t attempts_ = 0;
    bool signal_thread_ = false;  ///< whose stop is being written
    std::unique_ptr<Life> life_;
};

}  // namespace axon::simulation
