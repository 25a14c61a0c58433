// SPDX-License-Identifier: GPL-2.0-or-later
// PersonView: what entities there are, and one of them with its services.
#include <fmt/format.h>

#include <algorithm>
#include <ostream>
#include <sstream>

#include "cli/view.hpp"
#include "cli/view_text.hpp"
#include "cli/words.hpp"

namespace axon::cli {
namespace {

std::string holderText(const Json& entity) {
    const std::string lost = entity.value("orphaned", false) ? " (lost)" : "";
    if (entity.value("yours", false)) return "you" + lost;
    const auto holder = textOf(entity, "holder");
    return holder.empty() ? holder : holder + lost;
}

/// "INT mm", and what its values may be.
std::string typeText(const Json& parameter) {
    auto text = textOf(parameter, "data_type");
    if (const auto units = textOf(parameter, "units"); !units.empty()) text += " " + units;
    return text;
}

/// The lines of a text of several findings.
std::vector<std::string> findingsOf(const Json& entity) {
    std::vector<std::string> all;
    std::istringstream lines(textOf(entity, "reason", true));
    for (std::string one; std::getline(lines, one);)
        if (!one.empty()) all.push_back(one);
    return all;
}

/// The first finding, and how many there are.
std::string reasonCell(const Json& entity) {
    const auto all = findingsOf(entity);
    if (all.size() < 2) return all.empty() ? std::string() : all.front();
    return fmt::format("{} (and {} more: axon info {})", all.front(), all.size() - 1,
                       shellWord(textOf(entity, "call")));
}

/// What a person calls the kind of a stream.
std::string kindText(const std::string& kind) {
    if (kind == "scalar") return "number";
    if (kind == "vector") return "numbers";
    return kind;
}

std::string allowedText(const Json& parameter) {
    if (parameter.contains("choices")) return valuesText(parameter["choices"]);
    const bool low = parameter.contains("minimum");
    const bool high = parameter.contains("maximum");
    if (low && high) return valueText(parameter["minimum"]) + " to " + valueText(parameter["maximum"]);
    if (low) return "from " + valueText(parameter["minimum"]);
    if (high) return "up to " + valueText(parameter["maximum"]);
    return {};
}

}  // namespace

void PersonView::showEntities(const Json& event) {
    const auto& list = event.at("entities");
    const auto sayHidden = [&] {
        if (const auto hidden = event.value("not_ready", 0); hidden > 0)
            say(paint(std::to_string(hidden) + (hidden == 1 ? " entity is" : " entities are") +
                          " not ready: axon ls --all shows why",
                      Tint::Dim));
    };
    if (list.empty()) {
        say("no entities at " + textOf(event, "server") +
            " yet: start a robot's application and its "
            "axon-entity-manager");
        return sayHidden();
    }
    std::vector<std::string> head{"NAME",  "CATEGORY", "TYPE", "STATE", "HOLDER",
                                  "LATCH", "WAITING",  "STOP", "REASON"};
    const bool uuid = event.value("uuid", false);
    if (uuid) head.emplace_back("UUID");
    Table table(head);
    for (const auto& entity : list) {
        const auto state = textOf(entity, "state");
        const auto holder = holderText(entity);
        const auto waiting = entity.value("waiting", 0);
        const auto latency = entity.value("stop_latency_ms", Json());
        std::vector<Cell> row{{textOf(entity, "call"), Tint::Bold},
                              {textOf(entity, "category")},
                              {textOf(entity, "type")},
                              {state, stateTint(state)},
                              {holder.empty() ? "-" : holder, holder == "you" ? Tint::Green : Tint::None},
                              {entity.value("latched", false) ? "stopped" : "", Tint::Yellow},
                              {waiting > 0 ? std::to_string(waiting) : ""},
                              {latency.is_number() ? stageText(latency) : ""},
                              {reasonCell(entity), Tint::Dim}};
        if (uuid) row.push_back({textOf(entity, "id")});
        table.add(std::move(row));
    }
    wipe();
    out_ << table.text(terminal_.colour) << std::flush;
    sayHidden();
}

void PersonView::showEntity(const Json& event) {
    const auto& entity = event.at("entity");
    const auto call = textOf(entity, "call");
    const auto state = textOf(entity, "state");
    const auto holder = holderText(entity);
    wipe();
    if (entity.value("ready", true)) {
        out_ << paint(call, Tint::Bold) << "  " << textOf(entity, "category") << ' ' << textOf(entity, "type")
             << "  " << paint(state, stateTint(state)) << "  "
             << (holder.empty() ? "free" : "held by " + holder) << '\n';
    } else {
        out_ << paint(call, Tint::Bold) << "  not ready  " << paint(state, stateTint(state)) << '\n';
    }
    if (entity.value("latched", false)) {
        out_ << "  " << paint("stopped: it refuses tasks until axon rearm " + shellWord(call), Tint::Yellow)
             << '\n';
    }
    for (const auto& reason : findingsOf(entity)) out_ << "  " << paint(reason, Tint::Red) << '\n';
    if (entity.value("orphaned", false)) {
        out_ << "  "
             << paint(
                    "its holder has lost the connection; it stands still, and becomes free if the holder "
                    "does not come back in time",
                    Tint::Yellow)
             << '\n';
    }
    if (const auto waiting = entity.value("waiting", 0); waiting > 0)
        out_ << "  " << waiting << (waiting == 1 ? " client is" : " clients are") << " waiting for it\n";
    for (const auto& finding : event.value("findings", Json::array())) {
        out_ << "  " << paint(textOf(finding, "message"), Tint::Yellow) << '\n';
        if (const auto fix = textOf(finding, "fix"); !fix.empty()) out_ << "    fix: " << fix << '\n';
    }
    if (const auto descr = textOf(entity, "descr"); !descr.empty()) out_ << "  " << descr << '\n';
    for (const auto& service : event.at("services")) {
        out_ << '\n' << paint(textOf(service, "name"), Tint::Bold);
        if (const auto id = textOf(service, "global_id"); !id.empty()) out_ << " (" << id << ")";
        out_ << "  ";
        const auto& missing = service.at("missing");
        if (!service.value("active", true)) {
            const auto why = textOf(service, "inactive_reason");
            out_ << paint(
                "switched off" + (why.empty() ? std::string(" by the robot application") : ": " + why),
                Tint::Red);
        } else if (service.value("executing", false)) {
            out_ << paint("running", Tint::Cyan);
        } else if (!missing.empty()) {
            out_ << paint("needs " + valuesText(missing), Tint::Yellow);
        } else {
            out_ << paint("ready", Tint::Green);
        }
        if (textOf(service, "type") == "CMPLX")
            out_ << "; composite of " << valuesText(service.value("parts", Json::array()));
        if (!service.value("blocking", true)) out_ << "; runs beside other tasks";
        if (service.value("pausable", false)) out_ << "; pausable";
        out_ << '\n';
        if (const auto descr = textOf(service, "descr"); !descr.empty()) out_ << "  " << descr << '\n';
        if (const auto notes = textOf(service, "notes"); !notes.empty())
            out_ << "  " << paint(notes, Tint::Dim) << '\n';
        const auto isMissing = [&](const std::string& name) {
            return std::any_of(missing.begin(), missing.end(), [&](const Json& one) { return one == name; });
        };
        if (const auto& parameters = service.at("parameters"); !parameters.empty()) {
            Table table({"PARAMETER", "KIND", "TYPE", "VALUE", "ALLOWED", "", "DESCRIPTION"}, 2);
            for (const auto& parameter : parameters) {
                std::string marks;
                if (parameter.value("required", false)) marks = "required";
                if (parameter.value("multiple", false)) marks += marks.empty() ? "several" : ", several";
                if (parameter.value("savable", false)) marks += marks.empty() ? "kept" : ", kept";
                const bool lacking = isMissing(parameter.value("name", ""));
                table.add({{textOf(parameter, "name")},
                           {lowerCase(textOf(parameter, "type"))},
                           {typeText(parameter)},
                           {lacking ? "missing" : valuesText(parameter.at("values")),
                            lacking ? Tint::Yellow : Tint::None},
                           {allowedText(parameter)},
                           {marks},
                           {textOf(parameter, "descr"), Tint::Dim}});
            }
            out_ << table.text(terminal_.colour);
        }
        if (const auto& resources = service.at("resources"); !resources.empty()) {
            Table table({"RESOURCE", "SIZE", "", "DESCRIPTION"}, 2);
            for (const auto& resource : resources) {
                const bool there = resource.value("ready", false);
                table.add({{textOf(resource, "name")},
                           {there ? byteCount(resource.value("size", 0.0)) : "missing",
                            there ? Tint::None : Tint::Yellow},
                           {resource.value("required", false) ? "required" : ""},
                           {textOf(resource, "descr"), Tint::Dim}});
            }
            out_ << table.text(terminal_.colour);
        }
    }
    if (const auto streams = event.value("streams", Json::array()); !streams.empty()) {
        out_ << '\n' << paint("streams", Tint::Bold) << " (axon watch " << shellWord(call) << " STREAM)\n";
        std::size_t widest = 0;
        for (const auto& stream : streams) widest = std::max(widest, columns(textOf(stream, "name")));
        for (const auto& stream : streams) {
            const auto name = textOf(stream, "name");
            out_ << "  " << name << std::string(widest - columns(name) + 2, ' ')
                 << paint(kindText(textOf(stream, "kind")), Tint::Dim) << '\n';
        }
    }
    showStation(event);
    out_ << std::flush;
}

/// Where it is and how it is reached: what few people look for.
void PersonView::showStation(const Json& event) {
    const auto& entity = event.at("entity");
    out_ << fmt::format("\nat {:.0f}, {:.0f}, {:.0f} mm  {}\n", entity.value("x_mm", 0.0),
                        entity.value("y_mm", 0.0), entity.value("z_mm", 0.0),
                        paint(textOf(entity, "id"), Tint::Dim));
    if (entity.value("yours", false))
        out_ << paint(entity.value("direct", false) ? "messages go directly to its Entity Manager"
                                                    : "messages go through the servers",
                      Tint::Dim)
             << '\n';
    if (const auto latency = entity.value("stop_latency_ms", Json()); latency.is_number())
        out_ << "stop latency " << stageText(latency) << " (from the last drill of the servers)\n";
    for (const auto& margin : event.value("watchdogs", Json::array())) {
        const auto timeout = margin.value("timeout_ms", 0.0);
        const auto gap = margin.value("longest_gap_ms", 0.0);
        const bool near = timeout > 0 && gap > timeout / 2;
        out_ << paint(fmt::format("watchdog {}: stops after {} of silence, longest gap in the last minute {}",
                                  textOf(margin, "hop"), stageText(timeout), stageText(gap)),
                      near ? Tint::Yellow : Tint::Dim)
             << '\n';
    }
}

}  // namespace axon::cli
