// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "client/base/server_link.hpp"
#include "client/connection/reconnection.hpp"
#include "client/core/session_core.hpp"
#include "client/direct/direct_links.hpp"
#include "client/direct/direct_sending.hpp"
#include "client/stops/stop_desk.hpp"
#include "common/backoff.hpp"
#include "simulation/direct_ways.hpp"
#include "simulation/network.hpp"
#include "simulation/observer.hpp"
#include "simulation/server_station.hpp"

namespace axon::simulation {

/// A client's process: SessionCore, StopDesk, DirectLinks and DirectSending as the library has them, and in
/// place of its sockets and threads connections of the simulated network and two alarms. Its user is User
/// (user.hpp).
class ClientStation final : public client::ServerLink,
                            public client::StopLink,
                            public client::SessionObserver,
                            public client::DirectPathEvents {
  public:
    ClientStation(Timeline& timeline, Network& network, Observer& observer, ServerStation& server, int number,
                  Role role, std::uint64_t seed);
    ~ClientStation() override;

    Process& process() { return process_; }
    Path& path() { return path_; }
    /// Whoever listens for direct paths under this name can be reached from here.
    void addRoad(const std::string& name, DirectListener& listener, bool honest = true) {
        roads_.push_back({name, &listener, honest});
    }
    std::deque<Road>& roads() { return roads_; }
    Role role() const { return role_; }
    void start();
    void kill();

    /// Null while the process is dead.
    client::SessionCore* core() { return life_ ? &life_->core : nullptr; }
    client::StopDesk* desk() { return life_ ? &life_->desk : nullptr; }
    /// After calls of core() and desk(): their deadlines.
    void settle();
    bool connected() const { return life_ && life_->up; }
    /// From now on it takes so long to read a message on the data lane; zero = no time.
    void readSlowly(Duration each);

    /// Called at each start, as this process; and before it is killed, for what it has on its disk by then.
    std::function<void()> on_start, on_kill;
    std::function<void(const client::Held&)> on_hand_over;
    std::function<void(const client::TaskReport&)> on_task;

    // From the server, as this process.
    void welcomed(std::uint64_t attempt, ServerStation::ClientSession& session, const Sender& me,
                  const std::string& token, int told);
    void attached(std::uint64_t attempt);
    void newBasicPrflMsg(std::uint64_t attempt, Presence presence, const Registration& registration,
                         const std::string& profile);
    void newStatusMsg(std::uint64_t attempt, const EntityStatus& status);
    void newEntityMsg(std::uint64_t attempt, Lane lane, direct::Keeping keeping, const Header& head,
                      const std::string& bytes);
    void newRefusalMsg(std::uint64_t attempt, const Header& head, const Refusal& refusal);
    void newStopAccepted(std::uint64_t attempt, std::int64_t sequence, const std::string& entity,
                         int entities);
    void newHeartbeat(std::uint64_t attempt);

    // ServerLink and StopLink.
    void sendToEntity(const Header& head, std::string bytes) override;
    void sendToEntityDataSeq(const Header& head, std::string bytes) override;
    void sendRequest(const Header& head, std::string bytes) override;
    void sendReset(const Header& head) override;
    void sendClear(const Header& head) override;
    void keepAlive(std::int64_t sequence, bool busy) override;
    void sendStopSignal(Lane lane, const Header& head, StopCause cause) override;
    void sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                         StopCause cause) override;

    // DirectPathEvents.
    void newDirectMsg(const client::DirectPath& path, direct::Keeping keeping, Header head,
                      std::string_view message) override;
    void newDirectReceipt(const client::DirectPath& path, const Header& head,
                          std::string_view message) override;
    void directChanged() override;

    // SessionObserver.
    void onDirect(const client::Held& held, const std::string& data_endpoint,
                  const std::string& signal_endpoint, const std::string& key) override;
    void onEntity(Presence, const client::Entity&) override {}
    void onTask(const client::TaskReport& report) override {
        if (on_task) on_task(report);
    }
    void onText(const client::Held&, const std::string&) override {}
    void onRaw(const client::Held&, const std::string&) override {}
    void onService(const client::Held&, const client::Service&) override {}
    void onLost(const client::Held& held, const Refusal& why) override;
    void onOrphaned(const client::Held& held, const std::string& reason) override;
    void onResumed(const client::Held& held) override;
    void onHandOver(const client::Held& held, const client::HandOverRequest& request) override;
    void onSample(client::Sample) override {}
    void onTransferCredit(const Id128&, std::uint64_t, std::uint64_t) override {}
    void onServerText(int, const std::string&) override {}

  private:
    /// What goes by the servers in place of a path: marks, and what a path has not acknowledged.
    class ServersForPaths final : public client::DataLane {
      public:
        explicit ServersForPaths(ClientStation& station) : station_(station) {}
        void send(client::Operation kind, const Header& head, std::string bytes) const override {
            station_.relayForPaths(kind, head, std::move(bytes));
        }
        void add(client::Operation kind, const Header& head, std::string bytes) const override {
            send(kind, head, std::move(bytes));
        }
        void write() const override {}
        std::size_t waiting() const override { return 0; }
        std::size_t waitingBytes() const override { return 0; }
        void awaitRoom(Duration) const override {}

      private:
        ClientStation& station_;
    };
    struct Life {
        Life(ClientStation& station, SeededRandom& random)
            : core({}, station.process_, random, station, station, marks),
              desk(station.process_, station, marks),
              links(station.process_, kPathsMost,
                    [&station](const client::DirectOffer& offer) { return station.makePath(offer); }),
              ways([&station] { station.wakeBeat(); }) {}
        client::SignalMarks marks;
        client::SessionCore core;
        client::StopDesk desk;
        client::DirectLinks links;
        client::DirectSending ways;
        TimePoint direct_at = TimePoint::max();  ///< when something is due of the direct paths
        TimePoint path_beats_at = TimePoint::max();
        Connection* data = nullptr;
        Connection* signal = nullptr;
        ServerStation::ClientSession* session = nullptr;
        Sender me;
        std::string token;
        int told = 0;
        bool up = false;
        std::uint64_t listening = 0;
        TimePoint retry_at = TimePoint::max();
        Backoff backoff{client::Reconnection::kFirst, client::Reconnection::kLast};
    };
    const std::shared_ptr<const client::DataLane> servers_ = std::make_shared<ServersForPaths>(*this);
    bool hears(std::uint64_t attempt) const { return life_ && life_->listening == attempt; }
    static constexpr std::size_t kPathsMost = 64;
    std::shared_ptr<client::DirectPath> makePath(const client::DirectOffer& offer);
    void put(client::Operation kind, const Header& head, std::string bytes);
    void relay(client::Operation kind, const Header& head, std::string bytes);
    void relayForPaths(client::Operation kind, const Header& head, std::string bytes);
    void directTurn();
    void wakeBeat();
    void close(const client::DirectLinks::Closing& closing, const char* why);
    void pathEnds(const std::string& entity, const std::string& why);
    void establish();
    void lost(std::uint64_t attempt, const char* reason);
    void onAlarm();
    void onBeat();
    template <class Deliver>
    void toServer(Connection* connection, Deliver deliver);

    Timeline& timeline_;
    Network& network_;
    Observer& observer_;
    ServerStation& server_;
    Process process_;
    Path path_;
    std::deque<Road> roads_;
    const Role role_;
    SeededRandom random_;
    Alarm alarm_, beat_;
    std::uint64_t attempts_ = 0;
    Duration reading_{};  ///< of each message on the data lane
    std::unique_ptr<Life> life_;
};

}  // namespace axon::simulation
