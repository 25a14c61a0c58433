// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <string>

namespace axon::bench {

struct BesideConsole {
    std::filesystem::path folder;  ///< for boards, profiles and logs
    std::string entity_server, client_server;
    std::size_t entities = 0;
    std::size_t scans = 0;  ///< of the entities, the first so many stream scans
};

/// What is in the laboratory beside the browsers of bench/console.py: entities lab-0 …, each a real Entity
/// Manager with a robot application that has a real Entity Interfacer, and a client of the C++ library that
/// watches every scan and stops entities.
///
/// Says "ready" on standard output. Then it carries out one line of standard input after another, and answers
/// each with a line of JSON, until standard input ends:
/// * `stop FIRST COUNT N PERIOD_MS`: N stops, one entity at a time, of lab-FIRST … in turn, one each period:
///   `receipt_ms`, from the call to the receipt that confirms it, and `robot_ms`, from the call to the begin
///   of the stop callback; null where it did not come.
/// * `reached I`: `at_ns`, when the newest stop reached the robot application of lab-I, whoever has asked for
///   it: the begin of its stop callback, in nanoseconds of CLOCK_MONOTONIC; null if there was none.
/// * `scans`: how many have arrived since the last such line, and how many of those sent were left out.
int runBesideConsole(const BesideConsole& wish);

}  // namespace axon::bench
