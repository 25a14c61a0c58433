// SPDX-License-Identifier: GPL-2.0-or-later
// What comes over a robot's serial line, at either end: however the bytes are cut, the robot's reader finds
// the same packets; what a client makes of them survives writing and reading; the virtual robot and the
// client's session take anything, and the virtual robot does not move its wheels before a session was open.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "lab/arcos_server.hpp"
#include "robots/arcos/client_session.hpp"
#include "robots/arcos/vcc4.hpp"

namespace {

using namespace axon;
using arcos::Bytes;
using std::chrono::milliseconds;

void require(bool holds) {
    if (!holds) std::abort();
}

struct Ignored final : lab::ArcosServer::Port, arcos::ClientSession::Port {
    void send(const Bytes& /*bytes*/) override {}
    void onOnline(const arcos::RobotIdentity& /*identity*/) override {}
    void onState(const arcos::RobotState& state) override {
        require(std::isfinite(state.x_mm) && std::isfinite(state.heading_deg));
    }
    void onLost(const std::string& /*reason*/) override {}
};

template <class Contents, class Parse>
void survives(const arcos::Packet& packet, const Parse& parse) {
    const std::optional<Contents> read = parse(packet);
    if (!read) return;
    const auto again = parse(toPacket(*read));
    require(again && *again == *read);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    if (size == 0) return 0;
    const std::span<const std::uint8_t> stream(bytes + 1, size - 1);
    const std::size_t piece = 1 + bytes[0];

    arcos::PacketReader whole, cut;
    const auto packets = whole.feed(stream, TimePoint{});
    std::vector<arcos::Packet> pieces;
    for (std::size_t at = 0; at < stream.size(); at += piece)
        for (auto& packet : cut.feed(stream.subspan(at, std::min(piece, stream.size() - at)), TimePoint{}))
            pieces.push_back(std::move(packet));
    require(packets == pieces);

    arcos::LaserScanAssembler scans;
    for (const auto& packet : packets) {
        arcos::PacketReader reader;
        require(reader.feed(arcos::encode(packet), TimePoint{}) == std::vector{packet});
        (void)arcos::parseArgument(packet);
        survives<arcos::ServerInformation>(packet, arcos::parseServerInformation);
        survives<arcos::RobotConfig>(packet, arcos::parseRobotConfig);
        survives<arcos::InputsOutputs>(packet, arcos::parseInputsOutputs);
        survives<arcos::GripperPacket>(packet, arcos::parseGripperPacket);
        survives<arcos::LaserPacket>(packet, arcos::parseLaserPacket);
        if (const auto laser = arcos::parseLaserPacket(packet)) (void)scans.add(*laser);
    }

    Ignored ignored;
    lab::ArcosServer robot({}, ignored);
    arcos::ClientSession client(ignored);
    TimePoint now{};
    bool opened = false;
    robot.clientConnected(now);
    client.begin(now);
    for (std::size_t at = 0; at < stream.size(); at += piece) {
        const auto part = stream.subspan(at, std::min(piece, stream.size() - at));
        robot.receive(part, now);
        client.receive(part, now);
        client.tick(now);
        const auto speeds = robot.step(milliseconds{4}, {}, now);
        require(std::isfinite(speeds.left_mm_s) && std::isfinite(speeds.right_mm_s));
        opened = opened || robot.state() == lab::ArcosServer::State::Open;
        require(opened || (speeds.left_mm_s == 0 && speeds.right_mm_s == 0));
        require(robot.laser().readings() <= lab::LaserSettings::kMaximumReadings);
        now += milliseconds{4};
    }
    return 0;
}
