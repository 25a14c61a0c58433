// SPDX-License-Identifier: GPL-2.0-or-later
#include <memory>

#include "beside_console.hpp"
#include "crowd.hpp"
#include "experiment.hpp"
#include "herd.hpp"
#include "mosquitto_peer.hpp"
#include "nats_peer.hpp"
#include "raw_router.hpp"
#include "robots.hpp"
#include "streams.hpp"

namespace axon::bench {

namespace {

struct Arguments {
    std::string board, server, prefix, mode;
    std::size_t count = 0, first = 0, other = 0, scans = 0;
    std::uint64_t seed = 1;
    std::uint16_t port = 0;
    int qos = 0;
    Variant variant = Variant::Relayed;
};

CLI::App* hidden(CLI::App& app, const char* name, const char* what) {
    return app.add_subcommand(name, what)->group("");
}

}  // namespace

std::vector<Experiment> declareProcesses(CLI::App& app) {
    const auto its = std::make_shared<Arguments>();
    std::vector<Experiment> all;
    const auto begin = [&](const char* name, const char* what) {
        auto* command = hidden(app, name, what);
        command->add_option("board", its->board)->required();
        return command;
    };
    // Of PREFIX-0 … those of one process, with their slots on the board of all.
    const auto beginPart = [&](const char* name, const char* what) {
        auto* command = begin(name, what);
        command->add_option("slots", its->other)->required();
        command->add_option("first", its->first)->required();
        command->add_option("count", its->count)->required();
        command->add_option("prefix", its->prefix)->required();
        return command;
    };
    auto* crowd = beginPart("crowd", "Entity Managers that receive");
    crowd->add_option("server", its->server)->required();
    crowd->add_option("variant", its->variant)->required();
    all.push_back({crowd, [its] {
                       return runCrowd({its->board, its->other, its->first, its->count, its->server,
                                        its->prefix, its->variant});
                   }});

    auto* robots = beginPart("robots", "robot applications");
    robots->add_option("scans", its->scans)->required();
    all.push_back({robots, [its] {
                       return runRobots(its->board, its->other, its->first, its->count, its->prefix,
                                        its->scans);
                   }});

    auto* herd = begin("herd", "standard clients");
    herd->add_option("count", its->count)->required();
    herd->add_option("server", its->server)->required();
    herd->add_option("prefix", its->prefix)->required();
    herd->add_option("entities", its->other)->required();
    herd->add_option("seed", its->seed)->required();
    herd->add_option("mode", its->mode)->required();
    all.push_back({herd, [its] {
                       return runHerd(its->board, its->count, its->server, its->prefix, its->other, its->seed,
                                      its->mode == "open");
                   }});

    auto* axon_stream = begin("axon-stream", "a client that sends data as fast as it can");
    axon_stream->add_option("server", its->server)->required();
    axon_stream->add_option("readers", its->count)->required();
    axon_stream->add_option("stalled", its->other)->required();
    all.push_back(
        {axon_stream, [its] { return runAxonStream(its->board, its->server, its->count, its->other); }});

    auto* mosquitto_stream = begin("mosquitto-stream", "a publisher that sends data as fast as it can");
    mosquitto_stream->add_option("port", its->port)->required();
    mosquitto_stream->add_option("count", its->count)->required();
    all.push_back(
        {mosquitto_stream, [its] { return runMosquittoStream(its->board, its->port, its->count); }});

    auto* mosquitto = begin("mosquitto-receivers", "MQTT clients that receive");
    mosquitto->add_option("count", its->count)->required();
    mosquitto->add_option("port", its->port)->required();
    mosquitto->add_option("qos", its->qos)->required();
    mosquitto->add_option("first", its->first)->required();
    all.push_back({mosquitto, [its] {
                       return runMosquittoReceivers(its->board, its->count, its->port, its->qos, its->first);
                   }});

    auto* nats = begin("nats-receivers", "clients of NATS that receive");
    nats->add_option("count", its->count)->required();
    nats->add_option("port", its->port)->required();
    all.push_back(
        {nats, [its] { return runTcpReceivers(NatsReceiver(), its->board, its->count, its->port); }});

    auto* raw = begin("raw-receivers", "clients of the raw router that receive");
    raw->add_option("count", its->count)->required();
    raw->add_option("port", its->port)->required();
    all.push_back({raw, [its] { return runTcpReceivers(RawReceiver(), its->board, its->count, its->port); }});

    auto* beside = hidden(app, "beside-console", "entities and a client, for bench/console.py");
    beside->add_option("folder", its->board)->required();
    beside->add_option("entity-server", its->server)->required();
    beside->add_option("client-server", its->prefix)->required();
    beside->add_option("entities", its->count)->required();
    beside->add_option("scans", its->scans)->required();
    all.push_back(
        {beside, [its] {
             takeInterrupts();
             descriptorsPermitted();
             return runBesideConsole({its->board, its->server, its->prefix, its->count, its->scans});
         }});

    all.push_back({hidden(app, "raw-router", "the raw router"), runRawRouter});
    return all;
}

}  // namespace axon::bench
