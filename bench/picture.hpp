// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <nlohmann/json.hpp>
#include <string>

namespace axon::bench {

/// The results of an experiment (Report::all()) as PNG, drawn by gnuplot. Where it is not installed, or a
/// result holds nothing to draw, that is said on standard error and nothing else happens: the figures are
/// there already.
void drawPeers(const nlohmann::json& report, const std::string& file);
/// Figures 5.1 to 5.4, of axon-robots the latency at the callback; of several tables each one's number is put
/// before the file's suffix.
void drawChapter5(const nlohmann::json& report, const std::string& file);

}  // namespace axon::bench
