// SPDX-License-Identifier: GPL-2.0-or-later
// PersonView: stops, resets and drills.
#include <fmt/format.h>

#include <algorithm>
#include <ostream>
#include <utility>

#include "cli/view.hpp"
#include "cli/view_text.hpp"

namespace axon::cli {

void PersonView::showCommand(const Json& event) {
    const auto tasks = [](int count) {
        return count == 1 ? std::string("1 task") : fmt::format("{} tasks", count);
    };
    const int ended = event.value("tasks_ended", 0);
    const int removed = event.value("tasks_removed", 0);
    auto said = textOf(event, "entity") + (ended > 0 ? " has ended " + tasks(ended) : " was running no task");
    if (event.value("verb", "") == "clear")
        said += removed > 0
                    ? fmt::format(", and removed {} waiting {}", removed, removed == 1 ? "task" : "tasks")
                    : ", and none was waiting";
    else if (ended > 0)
        said += "; the next waiting task starts";
    say(said);
    if (!event.value("confirmed", true))
        err_ << paint("axon: its stop callback has not returned yet: look at the robot", Tint::Red) << '\n'
             << std::flush;
}

void PersonView::showReceipts(const Json& event) {
    const auto& list = event.at("receipts");
    if (list.empty()) return;  // a notice says so
    Table table({"STOPPED", "SERVER", "MANAGER", "CALLBACK", "STANDSTILL", "STATE", "RECEIPT"});
    for (const auto& receipt : list) {
        const bool confirmed = receipt.value("confirmed", false);
        const bool no_application = receipt.value("no_application", false);
        const auto state = textOf(receipt, "state");
        const auto precision = receipt.value("precision_ms", 0.0);
        std::string verdict = confirmed ? "✓ confirmed" : "✗ NOT CONFIRMED";
        if (confirmed && no_application) verdict = "✓ no application, nothing to stop";
        const bool rolls =
            confirmed && receipt.value("standstill_follows", false) && receipt.at("standstill_ms").is_null();
        table.add({{textOf(receipt, "call"), Tint::Bold},
                   {stageText(receipt.at("server_ms"), precision)},
                   {stageText(receipt.at("manager_ms"), precision)},
                   {stageText(receipt.at("callback_returned_ms"), precision)},
                   {rolls ? "not yet" : stageText(receipt.at("standstill_ms"), precision)},
                   {state, stateTint(state)},
                   {verdict, confirmed ? Tint::Green : Tint::Red}});
    }
    wipe();
    out_ << table.text(terminal_.colour) << std::flush;
    for (const auto& receipt : list)
        if (const auto fault = textOf(receipt, "fault"); !fault.empty())
            err_ << paint("axon: the stop callback of " + textOf(receipt, "call") +
                              " fails and is called again: " + fault,
                          Tint::Red)
                 << '\n';
    for (const auto& receipt : list) {
        const auto lost = textOf(receipt, "application_lost");
        if (lost.empty()) continue;
        const auto since = receipt.at("application_lost_s");
        err_ << paint("axon: " + textOf(receipt, "call") +
                          " may be moving: its robot application has not been reachable" +
                          (since.is_number() ? fmt::format(" for {:.1f} s", since.get<double>()) : "") +
                          ": " + lost,
                      Tint::Red)
             << '\n';
    }
    if (!event.value("confirmed", false)) {
        err_ << paint("axon: not every stop is confirmed: look at the robots, and use their emergency stops",
                      Tint::Red)
             << '\n'
             << std::flush;
    }
}

void PersonView::showDrill(const Json& event) {
    wipe();
    const auto& callback = event.at("callback");
    const auto& manager = event.at("manager");
    out_ << paint(textOf(event, "entity"), Tint::Bold) << "  " << event.value("tries", 0)
         << (event.value("tries", 0) == 1 ? " try" : " tries");
    if (event.value("no_application", false))
        out_ << "; " << paint("no robot application is linked", Tint::Yellow);
    out_ << '\n';
    Table table({"ROUND TRIP", "N", "P50", "P90", "P99", "P99.9", "MAX", "NEVER"}, 2);
    for (const auto& [name, part] : {std::pair<const char*, const Json&>{"manager", manager},
                                     std::pair<const char*, const Json&>{"robot application", callback}}) {
        if (part.value("n", 0) == 0) continue;
        const auto never = part.value("never_arrived", 0);
        const auto cell = [&part = part](const char* member) -> Cell {
            const auto value = part.value(member, Json());
            if (value.is_number()) return {stageText(value)};
            return {value.is_string() ? "never" : ""};
        };
        table.add({{name},
                   {std::to_string(part.value("n", 0))},
                   cell("p50_ms"),
                   cell("p90_ms"),
                   cell("p99_ms"),
                   cell("p999_ms"),
                   cell("max_ms"),
                   {std::to_string(never), never > 0 ? Tint::Red : Tint::None}});
    }
    out_ << table.text(terminal_.colour);
    const auto& shown = callback.value("n", 0) > 0 ? callback : manager;
    double most = 0;
    for (const auto& bin : shown.at("histogram")) most = std::max(most, bin.value("count", 0.0));
    for (const auto& bin : shown.at("histogram")) {
        const auto count = bin.value("count", 0.0);
        const auto width = static_cast<std::size_t>(count / most * 40 + 0.5);
        const std::string bar(count > 0 ? std::max<std::size_t>(width, 1) : 0, '#');
        out_ << fmt::format("  {:>9}  {}{}{:.0f}\n", "≤ " + stageText(bin.at("up_to_ms")), bar,
                            bar.empty() ? "" : " ", count);
    }
    out_ << std::flush;
}

}  // namespace axon::cli
