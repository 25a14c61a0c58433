// SPDX-License-Identifier: GPL-2.0-or-later
#include "picture.hpp"

#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>
#include <set>
#include <sstream>
#include <vector>

#include "child.hpp"
#include "thesis_tables.hpp"

namespace axon::bench {

namespace {

/// One line of a panel: its points are (count, ms).
struct Curve {
    std::string title;
    std::vector<std::pair<std::size_t, double>> points;
    bool thesis = false, some_lost = false;
};

struct Panel {
    std::string title, x, y;
    std::vector<Curve> curves;
};

/// Of a series of the report; nothing where it is not there, or infinite. A mean is of what arrived, so
/// losses must be said.
void addPoint(Curve& curve, std::size_t x, const nlohmann::json& series, const char* key) {
    if (series.is_object() && series.value("lost", 0) > 0) curve.some_lost = true;
    if (series.is_object() && series.contains(key) && series[key].is_number())
        curve.points.emplace_back(x, series[key].get<double>());
}

/// The same system has the same one in every picture, whatever is measured of it.
std::string colourOf(const Curve& curve) {
    for (const auto& [beginning, colour] :
         {std::pair{"thesis, LAN", "#606060"}, std::pair{"thesis, WLAN", "#a0a0a0"},
          std::pair{"axon-direct", "#8040a0"}, std::pair{"axon-robots", "#00a0a0"},
          std::pair{"axon", "#d02020"}, std::pair{"mosquitto-qos0", "#2060c0"},
          std::pair{"mosquitto-qos1", "#60a0e0"}, std::pair{"nats", "#208040"},
          std::pair{"raw-direct", "#e0c060"}, std::pair{"raw", "#c08000"}})
        if (curve.title.rfind(beginning, 0) == 0) return colour;
    return "#404040";
}

std::string styleOf(const Curve& curve) {
    if (curve.thesis) return "dt 2 lw 1.5";
    const std::string width = curve.title.rfind("axon", 0) == 0 ? " lw 2.5" : " lw 1.5";
    for (const auto& [part, dashes] :
         {std::pair{" wired", "dt 3"}, std::pair{" wireless", "dt 4"}, std::pair{" open", "dt 5"}})
        if (curve.title.find(part) != std::string::npos) return dashes + width;
    return "dt 1" + width;
}

void draw(const std::vector<Panel>& panels, const std::string& file) {
    std::vector<Panel> filled;
    for (auto panel : panels) {
        std::erase_if(panel.curves, [](const Curve& curve) { return curve.points.empty(); });
        if (!panel.curves.empty()) filled.push_back(std::move(panel));
    }
    if (filled.empty()) {
        std::cerr << "There is nothing to draw in " << file << ".\n";
        return;
    }
    const auto gnuplot = findProgram("gnuplot");
    if (gnuplot.empty()) {
        std::cerr << file
                  << " is not drawn: gnuplot is not installed; fix: apt-get install --no-install-recommends "
                     "gnuplot-nox\n";
        return;
    }
    const auto columns = filled.size() > 1 ? 2 : 1;
    const auto rows = (static_cast<int>(filled.size()) + columns - 1) / columns;
    std::ostringstream script;
    script << "set terminal pngcairo size " << 1000 * columns << "," << 600 * rows
           << " font ',12'\nset output '" << file << "'\n"
           << "set logscale xy\nset grid lt 1 lc rgb '#d0d0d0' lw 0.5\nset key outside right top Left "
              "reverse\nset format y '%g'\n";
    int block = 0;
    for (const auto& panel : filled)
        for (const auto& curve : panel.curves) {
            script << "$curve" << block++ << " << EOD\n";
            for (const auto& [x, y] : curve.points) script << x << ' ' << y << '\n';
            script << "EOD\n";
        }
    if (filled.size() > 1) script << "set multiplot layout " << rows << "," << columns << "\n";
    block = 0;
    for (const auto& panel : filled) {
        std::set<std::size_t> ticks;
        for (const auto& curve : panel.curves)
            for (const auto& [x, y] : curve.points) ticks.insert(x);
        script << "set title '" << panel.title << "'\nset xlabel '" << panel.x << "'\nset ylabel '" << panel.y
               << "'\nset xrange [" << static_cast<double>(*ticks.begin()) * 0.8 << ":"
               << static_cast<double>(*ticks.rbegin()) * 1.25 << "]\nset xtics (";
        for (const auto x : ticks) script << (x == *ticks.begin() ? "" : ",") << x;
        script << ")\nplot ";
        for (std::size_t i = 0; i < panel.curves.size(); ++i) {
            const auto& curve = panel.curves[i];
            script << (i == 0 ? "" : ", ") << "$curve" << block++ << " with linespoints pt " << i + 4
                   << " ps 1.2 lc rgb '" << colourOf(curve) << "' " << styleOf(curve) << " title '"
                   << curve.title << (curve.some_lost ? " (some lost)" : "") << "' noenhanced";
        }
        script << "\n";
    }
    FILE* pipe = ::popen((gnuplot + " -").c_str(), "w");
    if (pipe == nullptr) return;
    const auto text = script.str();
    std::fwrite(text.data(), 1, text.size(), pipe);
    if (::pclose(pipe) != 0) std::cerr << file << " is not drawn: gnuplot has failed; its message is above\n";
}

bool isSystem(const nlohmann::json& of) {
    return of.is_object() && (of.contains("from_batch") || of.contains("mean"));
}

}  // namespace

void drawPeers(const nlohmann::json& report, const std::string& file) {
    std::vector<Panel> panels;
    for (const auto& cores : report.at("settings").at("cores"))
        for (const auto* what : {"small", "data", "stop"})
            for (const auto* key : {"mean", "last"}) {
                Panel panel{std::string(what) + ", " +
                                (key[0] == 'm' ? "mean" : "last of the batch (median)") +
                                "; cores: " + cores.get<std::string>(),
                            "receivers",
                            "ms from the start of the batch",
                            {}};
                std::map<std::string, Curve> curves;
                for (const auto& row : report.at("results")) {
                    if (row.at("what") != what || row.at("cores") != cores) continue;
                    for (const auto& [name, its] : row.items())
                        if (isSystem(its)) addPoint(curves[name], row.at("n"), its, key);
                }
                for (auto& [name, curve] : curves)
                    panel.curves.push_back({name, std::move(curve.points), false, curve.some_lost});
                panels.push_back(std::move(panel));
            }
    draw(panels, file);
}

void drawChapter5(const nlohmann::json& report, const std::string& file) {
    const auto& channel = report.at("settings").at("channel");
    const std::string where =
        channel.is_string() ? " (" + channel.get<std::string>() + ")" : " (emulated radio link)";
    std::set<std::string> drawn;
    for (const auto& row : report.at("results")) drawn.insert(row.at("table"));
    for (const auto& table : kThesisTables) {
        if (drawn.count(std::string(table.number)) == 0) continue;
        Panel panel{"Figure " + std::string(table.number) + ". " + std::string(table.title),
                    table.many_clients ? "clients" : "entities",
                    "average latency, ms" + where,
                    {}};
        Curve lan{"thesis, LAN", {}, true}, wlan{"thesis, WLAN", {}, true};
        for (const auto& row : table.rows) {
            lan.points.emplace_back(row.count, row.lan_ms);
            wlan.points.emplace_back(row.count, row.wlan_ms);
        }
        std::map<std::string, Curve> curves;
        for (const auto& row : report.at("results")) {
            if (row.at("table") != table.number) continue;
            const std::size_t x = row.at(table.many_clients ? "clients" : "entities");
            const std::string mode = row.contains("mode") ? " " + row["mode"].get<std::string>() : "";
            for (const auto& [name, its] : row.items()) {
                if (!isSystem(its)) continue;
                // At its Entity Manager it is one more Axon relayed.
                if (its.contains("at_callback")) {
                    addPoint(curves[name + mode + ", callback"], x, its["at_callback"], "mean");
                } else {
                    addPoint(curves[name + mode], x, its.at("from_batch"), "mean");
                }
            }
        }
        panel.curves = {lan, wlan};
        for (auto& [name, curve] : curves)
            panel.curves.push_back({name, std::move(curve.points), false, curve.some_lost});
        std::filesystem::path to(file);
        if (drawn.size() > 1)
            to.replace_filename(to.stem().string() + "-" + std::string(table.number) +
                                to.extension().string());
        draw({panel}, to.string());
    }
}

}  // namespace axon::bench
