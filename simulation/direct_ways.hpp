// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "client/direct/direct_path.hpp"
#include "common/result.hpp"
#include "simulation/network.hpp"
#include "simulation/timeline.hpp"

namespace axon::simulation {

/// The client's end of one connection of a direct path, as the other end calls it. As the client's process.
class DirectCaller {
  public:
    virtual ~DirectCaller() = default;
    /// Whose path ends with its lease and not before, where nothing fails.
    virtual bool honest() const { return true; }
    virtual void challenged(Lane lane, const Id128& nonce) = 0;
    virtual void opened(Lane lane, const std::string& proof) = 0;
    virtual void refused(Lane lane, const Refusal& refusal) = 0;
    virtual void newEntityMsg(Lane lane, direct::Keeping keeping, const Header& head,
                              const std::string& bytes) = 0;
    virtual void newHeartbeat(std::int64_t received, bool asks) = 0;
};

/// What a client says to open a lane. The nonce is not in it: that of the connection counts.
struct SaidOpening {
    direct::Claim claim;
    std::string proof;
};

/// Who listens for direct paths, in place of the two doors (data_door.cpp, direct_door.cpp). As its
/// process. `connection` is who calls.
class DirectListener {
  public:
    virtual ~DirectListener() = default;
    virtual Process& listeningProcess() = 0;
    virtual void challenge(Connection& connection, Lane port, std::weak_ptr<DirectCaller> caller) = 0;
    virtual void open(Connection& connection, Lane port, const SaidOpening& said,
                      std::weak_ptr<DirectCaller> caller) = 0;
    virtual void sendToEntity(Connection& connection, direct::Keeping keeping, const Header& head,
                              const std::string& bytes) = 0;
    virtual void sendStopSignal(Connection& connection, const Header& head, StopCause cause) = 0;
    virtual void sendResetSignal(Connection& connection, const Header& head) = 0;
    virtual void sendClearSignal(Connection& connection, const Header& head) = 0;
    virtual void keepAlive(Connection& connection, std::int64_t received, bool busy) = 0;
};

/// "left:data" and "left:signal", the endpoints of the listener "left".
std::string endpointOf(const std::string& listener, Lane lane);

/// What leads from one client to one listener, whose name is that of its endpoints.
struct Road {
    std::string to;
    DirectListener* listener = nullptr;
    bool honest = true;
    Path path = {};
    int open = 0;  ///< paths that stand
};

/// A direct path over two connections of the simulated network: what src/client/direct/network_path.cpp has
/// in the real one. Its outboxes have no bound.
class SimulatedPath final : public client::DirectPath,
                            public DirectCaller,
                            public std::enable_shared_from_this<SimulatedPath> {
  public:
    struct Place {
        Timeline& timeline;
        Network& network;
        Process& client;
        client::DirectPathEvents& events;
        std::function<Road*(const std::string& endpoint)> road;  ///< null: nobody listens there
        std::function<Duration()> reading;  ///< how long it takes to read a message of data
        std::function<void(const SimulatedPath&, const std::string& why)> ended;  ///< one that stood
    };
    SimulatedPath(Place place, client::DirectOffer offer, Id128 number);
    ~SimulatedPath() override;

    void open(Duration timeout) override;
    std::string reason() const override { return reason_; }
    void close(const std::string& why) override;
    void send(direct::Keeping keeping, const Header& head,
              std::shared_ptr<const std::string> message) const override;
    void sendStopSignal(const Header& head, StopCause cause) const override;
    void sendResetSignal(const Header& head) const override;
    void sendClearSignal(const Header& head) const override;
    void beat() const override;
    void readSlowly(Duration each);
    bool toHonest() const { return data_.road->honest && signal_.road->honest; }

    void challenged(Lane lane, const Id128& nonce) override;
    void opened(Lane lane, const std::string& proof) override;
    void refused(Lane lane, const Refusal& refusal) override;
    void newEntityMsg(Lane lane, direct::Keeping keeping, const Header& head,
                      const std::string& bytes) override;
    void newHeartbeat(std::int64_t received, bool asks) override;

  private:
    struct End {
        Road* road = nullptr;
        Connection* connection = nullptr;
        std::uint32_t life = 0;  ///< of the listener: another one is not who was connected to
    };
    void openLane(Lane lane);
    void await(int step);
    template <class Deliver>
    void toListener(const End& end, Deliver deliver) const;
    End& end(Lane lane) { return lane == Lane::Data ? data_ : signal_; }

    const Place place_;
    Duration timeout_{};
    int step_ = 0;  ///< of the four calls
    End data_, signal_;
    std::string reason_;
};

}  // namespace axon::simulation
