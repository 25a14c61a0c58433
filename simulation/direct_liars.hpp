// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "simulation/direct_ways.hpp"
#include "simulation/entity_manager_station.hpp"
#include "simulation/observer.hpp"
#include "simulation/server_station.hpp"
#include "simulation/timeline.hpp"

namespace axon::proto {
class CheckOutReply;
}  // namespace axon::proto

namespace axon::simulation {

/// Who lies about direct paths, in three parts. A *stranger* knocks at honest doors with guessed and
/// overheard proofs, those of leases that have ended and of other robots, and nonces that were used; none may
/// be let in. A *holder* checks honest robots out as anybody may, and lies to them on its own path: numbers
/// that go backwards or jump, acknowledgements of what was never sent, what goes by the servers. A
/// *listener*, to which a lying entity's grants lead, lies to its holder likewise. Whom they lie to may lose
/// what is between the two; nobody else may lose anything.
class DirectLiars final : public DirectListener {
  public:
    static constexpr const char* kName = "liar";
    struct Robot {
        std::string name;
        EntityManagerStation* manager;
    };
    /// From `from` to `until`; what is held is released before.
    DirectLiars(Timeline& timeline, Network& network, Process& outside, ServerStation& server,
                Observer& observer, std::uint64_t seed, TimePoint from, TimePoint until,
                std::vector<Robot> robots);
    ~DirectLiars() override;

    /// A lying grant: where a path to this lease can be opened, or to somebody else's.
    void sayEndpoints(proto::CheckOutReply& reply);
    /// A number of a path that an honest holder has, or anything.
    std::string anyPath();

    // DirectListener: the lying one.
    Process& listeningProcess() override { return outside_; }
    void challenge(Connection& connection, Lane port, std::weak_ptr<DirectCaller> caller) override;
    void open(Connection& connection, Lane port, const SaidOpening& said,
              std::weak_ptr<DirectCaller> caller) override;
    void sendToEntity(Connection&, direct::Keeping, const Header&, const std::string&) override {}
    void sendStopSignal(Connection& connection, const Header& head, StopCause cause) override;
    void sendResetSignal(Connection&, const Header&) override {}
    void sendClearSignal(Connection&, const Header&) override {}
    void keepAlive(Connection& connection, std::int64_t received, bool busy) override;

  private:
    class Knock;
    class OwnPath;
    struct Ears;
    struct Back {  ///< a lane at the lying listener
        Lane lane;
        std::weak_ptr<DirectCaller> caller;
        std::string holder;
        std::vector<std::string> stops;
    };
    void knock();
    void knockOnce();
    void hold();
    void beat();
    void logIn();
    void checkOut();
    void release();
    void lieToHolder(Connection& connection);
    std::int64_t anyNumber(std::int64_t last);

    Timeline& timeline_;
    Network& network_;
    Process& outside_;
    ServerStation& server_;
    Observer& observer_;
    Dice dice_;
    SeededRandom random_;
    const TimePoint until_;
    const std::vector<Robot> robots_;
    Path road_;
    std::vector<std::shared_ptr<DirectCaller>> callers_;
    // The listener.
    std::map<LeaseNumber, std::string> keys_;  ///< of grants that were lies
    std::unordered_map<const Connection*, Id128> nonces_;
    std::unordered_map<const Connection*, Back> backs_;
    std::int64_t said_ = 0;
    // The holder.
    std::shared_ptr<Ears> ears_;
    front_end_server::FrontEndCore::ClientRef client_;
    std::optional<std::size_t> wants_;  ///< of robots_
    std::optional<std::string> entity_;
    LeaseNumber lease_;
    std::shared_ptr<OwnPath> path_;
    TimePoint releases_at_{};
    std::int64_t sequence_ = 0;
};

}  // namespace axon::simulation
