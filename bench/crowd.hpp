// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <string>

namespace axon::bench {

/// What the Entity Managers of a crowd are, and which way messages take to them.
enum class Variant : std::uint8_t {
    Relayed,       ///< by the servers; the link to the robot application is in memory
    Direct,        ///< they offer a direct path, and the client takes it
    Robots,        ///< as Relayed, and each has a robot application with a real Entity Interfacer, in another
                   ///< process
    DirectRobots,  ///< both: the direct path, and real robot applications
    Open,          ///< no Entity Managers but OpenEntity, which many clients hold at once
};
inline constexpr bool isDirect(Variant variant) {
    return variant == Variant::Direct || variant == Variant::DirectRobots;
}
inline constexpr bool hasRobots(Variant variant) {
    return variant == Variant::Robots || variant == Variant::DirectRobots;
}

/// How long the threads that read direct paths may spin, in this process and in its children that begin
/// later. Until it is set, that of the library.
void setDirectSpin(std::chrono::microseconds longest);
std::chrono::microseconds directSpin();

struct CrowdWish {
    std::string board_file;
    std::size_t slots = 0;             ///< of the board
    std::size_t first = 0, count = 0;  ///< of them, those of this process
    std::string server;                ///< HOST:PORT, or the configuration file of an Entity Manager
    std::string prefix;
    Variant variant = Variant::Relayed;
};

/// N Entity Managers (the library the daemon is made of, with real sessions over real sockets) in one
/// process, each with a robot application in memory that notes the arrival of stops and data on the board.
/// Named PREFIX-FIRST … Open ones send 60 bytes to each who holds them every 500 ms while the board says go.
/// Runs until its parent dies or kills it.
int runCrowd(const CrowdWish& wish);

}  // namespace axon::bench
