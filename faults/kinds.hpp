// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "common/ids.hpp"
#include "figures.hpp"
#include "laboratory.hpp"

namespace axon::faults {

/// One run of one kind, in the hands of its trials.
struct Run {
    Laboratory& lab;
    Report& report;
    SeededRandom random;
    std::size_t trials = 0;
    double seconds = 0;  ///< of kinds that last instead of counting
    std::function<void(std::size_t done, std::size_t of)> progress;

    /// Whether to go on; says how far it is.
    bool goOn();
    /// From least to most.
    std::uint64_t among(std::uint64_t least, std::uint64_t most);
};

/// Of a kind that is not one of the numbered trials; it comes after them.
inline constexpr int kNoTrial = 99;

/// A kind of fault: what is done, what is promised, and what a trial of it is.
struct Kind {
    std::string name;
    int trial = 0;  ///< of docs/explanation/safety.md
    std::string what;
    Promise promise;
    Needs needs;
    std::string measured;  ///< what the latencies are of; empty = none are measured
    std::size_t usual_trials = 20;
    std::size_t short_factor = 1;  ///< `all --trials N` carries out so many times N
    std::function<void(Run&)> run;
};

/// What Report::counts calls the commands that went by direct paths.
inline constexpr const char* kSentDirectly = "commands sent by direct paths";

/// Every kind, in the order of the trials of docs/explanation/safety.md.
const std::vector<Kind>& kinds();
const Kind* findKind(const std::string& name);

/// Those that end in a stop callback, or in what the client is told.
std::vector<Kind> stopKinds();
/// Those of clients that come to stop a robot.
std::vector<Kind> loginKinds();
/// Those that ask what a robot obeys; of them, those in which processes and connections end meanwhile.
std::vector<Kind> commandKinds();
std::vector<Kind> restartKinds();
/// Those that ask what a stop costs when there is much of everything.
std::vector<Kind> loadKinds();

}  // namespace axon::faults
