// SPDX-License-Identifier: GPL-2.0-or-later
// PersonView: global services and their runs.
#include <fmt/format.h>

#include <algorithm>
#include <ctime>
#include <ostream>
#include <set>
#include <tuple>

#include "cli/view.hpp"
#include "cli/view_text.hpp"
#include "cli/words.hpp"

namespace axon::cli {
namespace {

using Rows = std::vector<std::vector<Cell>>;

/// Of those that cannot play a role, so many are named.
constexpr std::size_t kUnfitShown = 4;
/// Of a step's progress, where lines cannot be redrawn: a line for each such part.
constexpr double kPartPerLine = 0.25;

Tint runTint(const std::string& state) {
    if (state == "SUCCEEDED") return Tint::Green;
    if (state == "FAILED" || state == "REFUSED" || state == "UNKNOWN") return Tint::Red;
    if (state == "STOPPED" || state == "CANCELLED" || state == "PAUSED" || state == "HELD" ||
        state == "STOPPING")
        return Tint::Yellow;
    return Tint::Cyan;
}

/// What a person calls the state of a step. `over`: so is the run.
Cell stepState(const Json& step, bool over) {
    if (!step.at("state").is_string()) return {over ? "not started" : "waiting", Tint::Dim};
    const auto state = textOf(step, "state");
    auto text = state == "DISPATCHED" ? "starting" : lowerCase(state);
    if (const auto tries = step.value("tries", 1); tries > 1) text += fmt::format(" (try {})", tries);
    return {text, runTint(state)};
}

std::string barOf(const Json& step, std::size_t width) {
    if (!step.at("state").is_string()) return {};
    const auto part = textOf(step, "state") == "SUCCEEDED" ? 1.0 : step.value("progress", -1.0);
    if (part < 0) return {};
    return (width > 0 ? progressBar(part, width) + " " : "") + percent(part);
}

std::string timeOf(const Json& step, double elapsed) {
    if (!step.at("began_s").is_number()) return {};
    const auto until = step.at("ended_s").is_number() ? step.at("ended_s").get<double>() : elapsed;
    return duration(std::max(0.0, until - step.at("began_s").get<double>()));
}

/// Equal ones run at the same time; those of the compensation all do.
std::string orderOf(const Json& step) {
    return step.value("compensation", false) ? "after" : std::to_string(step.value("preced", 0));
}

/// "Arm arm_pick (pick)".
std::string whatOf(const Json& step) {
    const auto called = textOf(step, "called");
    return textOf(step, "entity") + " " + textOf(step, "service") +
           (called.empty() ? "" : " (" + called + ")");
}

Cell remarkOf(const Json& step) {
    if (step.at("reason").is_object()) return {textOf(step.at("reason"), "message"), Tint::Yellow};
    return {textOf(step, "feedback"), Tint::Dim};
}

/// "Distance = 998 mm; Colour = red", of the step's "parameters" or "results"; without what was reported on
/// the way.
std::string valueList(const Json& step, const char* which) {
    const auto units = step.value("units", Json::object());
    const auto live = step.value("live", Json::array());
    std::string text;
    for (const auto& [name, list] : step.at(which).items()) {
        if (std::find(live.begin(), live.end(), Json(name)) != live.end()) continue;
        const auto unit = units.value(name, "");
        text += (text.empty() ? "" : "; ") + printable(name) + " = " + valuesText(list) +
                (unit.empty() ? "" : " " + printable(unit));
    }
    return text;
}

bool isShown(const Json& step, bool compensating) {
    return !step.value("compensation", false) || compensating || step.at("state").is_string();
}

std::vector<const Json*> inOrder(const std::map<int, Json>& steps, bool compensating) {
    std::vector<const Json*> shown;
    for (const auto& [place, step] : steps) {
        if (isShown(step, compensating)) shown.push_back(&step);
    }
    std::stable_sort(shown.begin(), shown.end(), [](const Json* a, const Json* b) {
        const auto key = [](const Json& step) {
            return std::pair(step.value("compensation", false), step.value("preced", 0));
        };
        return key(*a) < key(*b);
    });
    return shown;
}

/// The rows that fit into `most` lines: what is under way or went wrong before what is to come, and that
/// before what is done.
std::set<std::size_t> chosenRows(const std::vector<const Json*>& steps, std::size_t most) {
    const auto rank = [](const Json& step) {
        if (!step.at("state").is_string()) return 1;
        const auto state = textOf(step, "state");
        return state == "SUCCEEDED" ? 2 : 0;
    };
    std::vector<std::size_t> order(steps.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
        const auto ra = rank(*steps[a]);
        const auto rb = rank(*steps[b]);
        // Of what is done, the last.
        return ra != rb ? ra < rb : ra == 2 && a > b;
    });
    if (order.size() > most) order.resize(most);
    return {order.begin(), order.end()};
}

/// Shortens cells until every line fits into `width` columns: first the last column, a remark that goes
/// altogether where little is left of it, then the widest of the columns that `may_shrink`.
void fit(const std::vector<std::string>& head, Rows& rows, std::size_t width,
         const std::set<std::size_t>& may_shrink) {
    const auto last = head.size() - 1;
    std::vector<std::size_t> widths(head.size(), 0);
    for (const auto& row : rows) {
        for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], columns(row[i].text));
    }
    for (std::size_t i = 0; i < head.size(); ++i) {
        if (widths[i] > 0) widths[i] = std::max(widths[i], columns(head[i]));
    }
    const auto total = [&] {
        std::size_t sum = 0;
        std::size_t shown = 0;
        for (const auto one : widths) {
            sum += one;
            if (one > 0) ++shown;
        }
        return sum + (shown > 0 ? 2 * (shown - 1) : 0);
    };
    constexpr std::size_t kRemarkLeast = 12;
    constexpr std::size_t kLeast = 6;
    if (total() > width && widths[last] > 0) {
        const auto others = total() - widths[last];
        widths[last] = width > others && width - others >= kRemarkLeast ? width - others : 0;
    }
    while (total() > width) {
        auto widest = head.size();
        for (const auto i : may_shrink) {
            if (widths[i] > std::max(kLeast, columns(head[i])) &&
                (widest == head.size() || widths[i] > widths[widest]))
                widest = i;
        }
        if (widest == head.size()) break;
        --widths[widest];
    }
    for (auto& row : rows) {
        for (std::size_t i = 0; i < row.size(); ++i) row[i].text = shortened(row[i].text, widths[i]);
    }
}

/// As a table; on a terminal no line is wider than it.
std::string fitted(const std::vector<std::string>& head, Rows rows, const std::set<std::size_t>& may_shrink,
                   const Terminal& terminal) {
    if (terminal.live) fit(head, rows, terminal.width - 1, may_shrink);
    Table table(head);
    for (auto& row : rows) table.add(std::move(row));
    return table.text(terminal.colour);
}

/// The lines of a run's steps, heads first.
std::string stepTable(const std::vector<const Json*>& steps, double elapsed, bool over, std::size_t width,
                      bool colour) {
    const std::vector<std::string> head{"ORDER", "NAME",     "ENTITY", "SERVICE",
                                        "STATE", "PROGRESS", "TIME",   ""};
    const std::size_t bar = width >= 110 ? 22 : width >= 90 ? 12 : width >= 70 ? 8 : 0;
    Rows rows;
    for (const auto* step : steps) {
        rows.push_back({{orderOf(*step), Tint::Dim},
                        {textOf(*step, "called")},
                        {textOf(*step, "entity"), Tint::Bold},
                        {textOf(*step, "service")},
                        stepState(*step, over),
                        {barOf(*step, bar)},
                        {timeOf(*step, elapsed)},
                        remarkOf(*step)});
    }
    return fitted(head, std::move(rows), {1, 2, 3, 4}, {true, colour, width + 1});
}

std::string calendar(std::int64_t milliseconds) {
    const auto seconds = static_cast<std::time_t>(milliseconds / 1000);
    std::tm parts{};
    ::localtime_r(&seconds, &parts);
    char text[32];
    return {text, std::strftime(text, sizeof text, "%F %T", &parts)};
}

/// "Distance=1000 mm, Place=approach.Position".
std::string inputsOf(const Json& step) {
    std::string text;
    const auto add = [&](const std::string& one) { text += (text.empty() ? "" : ", ") + one; };
    for (const auto& [name, values] : step.at("parameters").items()) {
        const auto units = step.at("units").value(name, "");
        add(printable(name) + "=" + valuesText(values) + (units.empty() ? "" : " " + printable(units)));
    }
    for (const auto& source : step.at("sources")) {
        add(textOf(source, "parameter") + "=" + textOf(source, "step") + "." + textOf(source, "output"));
    }
    return text;
}

}  // namespace

void PersonView::showGlobalServices(const Json& event) {
    wipe();
    const auto& services = event.at("services");
    if (services.empty()) {
        say("no global services at " + textOf(event, "server") +
            ": put their profiles into its folder globalservices (axon-server --global-services)");
    } else {
        Rows rows;
        for (const auto& service : services) {
            rows.push_back({{textOf(service, "name"), Tint::Bold},
                            {std::to_string(service.at("steps").size())},
                            {std::to_string(service.at("roles").size())},
                            {textOf(service, "on_failure")},
                            {textOf(service, "file")},
                            {textOf(service, "descr"), Tint::Dim}});
        }
        out_ << fitted({"NAME", "STEPS", "ROLES", "ON FAILURE", "FILE", "DESCRIPTION"}, std::move(rows),
                       {0, 4}, terminal_)
             << std::flush;
    }
    for (const auto& file : event.at("files")) {
        const bool bad = file.value("bad", false);
        if (bad)
            say(paint("✗ " + textOf(file, "name") + " has errors: none of its services is offered",
                      Tint::Red));
        for (const auto& finding : file.at("findings")) {
            const auto text = valueText(finding);
            const bool error = text.find(": error: ") != std::string::npos;
            say((bad ? "    " : "") + paint(error ? "✗ " : "! ", error ? Tint::Red : Tint::Yellow) + text);
        }
    }
}

void PersonView::showGlobalService(const Json& event) {
    wipe();
    const auto& service = event.at("service");
    out_ << paint(textOf(service, "name"), Tint::Bold) << "  " << paint(textOf(service, "file"), Tint::Dim)
         << '\n';
    if (const auto descr = textOf(service, "descr"); !descr.empty()) out_ << "  " << descr << '\n';
    out_ << "  when a step fails: " << textOf(service, "on_failure") << "\n\n";
    std::vector<const Json*> steps;
    for (const auto& step : service.at("steps")) steps.push_back(&step);
    std::stable_sort(steps.begin(), steps.end(), [](const Json* a, const Json* b) {
        return a->value("preced", 0) < b->value("preced", 0);
    });
    const auto after = steps.size();
    for (const auto& step : service.at("compensation")) steps.push_back(&step);
    Rows rows;
    for (const auto* step : steps) {
        const bool compensation = rows.size() >= after;
        rows.push_back({{compensation ? "after" : std::to_string(step->value("preced", 0)),
                         compensation ? Tint::Dim : Tint::None},
                        {textOf(*step, "called")},
                        {std::to_string(step->value("role", 0))},
                        {textOf(*step, "service"), Tint::Bold},
                        {inputsOf(*step)}});
    }
    out_ << fitted({"ORDER", "NAME", "ROLE", "SERVICE", "INPUTS"}, std::move(rows), {1, 3}, terminal_)
         << '\n';
    rows.clear();
    for (const auto& role : event.at("roles")) {
        const auto able = valuesText(role.at("able"));
        rows.push_back({{std::to_string(role.value("role", 0))},
                        {able.empty() ? "nobody" : able, able.empty() ? Tint::Red : Tint::Green},
                        {textOf(role, "wanted"), Tint::Dim}});
    }
    out_ << fitted({"ROLE", "COULD BE PLAYED NOW BY", "WANTED"}, std::move(rows), {1}, terminal_)
         << std::flush;
    for (const auto& role : event.at("roles")) {
        std::size_t shown = 0;
        for (const auto& unfit : role.at("unfit")) {
            if (unfit.value("code", "") == "WRONG_TYPE" || shown++ == kUnfitShown) break;  // nearest first
            say(fmt::format("  role {}: {} {}", role.value("role", 0), textOf(unfit, "entity"),
                            textOf(unfit, "why")));
        }
    }
    for (const auto& id : event.at("nobody_offers"))
        say(paint("✗ no entity offers " + valueText(id), Tint::Red));
    if (event.value("possible", false)) {
        say(paint("✓", Tint::Green) + " every role can be played: axon global check " +
            shellWord(textOf(service, "name")) + " asks every robot");
    } else {
        say(paint("✗", Tint::Red) + " it cannot run now");
    }
}

void PersonView::showBinding(const Json& event) {
    wipe();
    Rows rows;
    for (const auto& role : event.at("roles")) {
        rows.push_back({{std::to_string(role.value("role", 0))},
                        {textOf(role, "entity"), Tint::Bold},
                        {role.value("chosen", false) ? "as bound" : "found"},
                        {role.at("entity_id") == event.at("master_id") ? "master" : ""},
                        {textOf(role, "wanted"), Tint::Dim}});
    }
    out_ << fitted({"ROLE", "PLAYED BY", "", "", "WANTED"}, std::move(rows), {1}, terminal_) << std::flush;
}

void PersonView::showRun(const Json& event) {
    // By state alone it can be told whether a picture is worth drawing at once.
    bool news = false;
    for (const auto& step : event.at("steps")) {
        auto& known = steps_[step.at("step").get<int>()];
        news = news || !known.is_object() || known.at("state") != step.at("state");
        known = step;
    }
    const auto state = textOf(event, "state");
    const bool over = event.value("final", false);
    if (event.value("check", false)) {
        if (over) {
            showRunEnd(event);
        } else if (terminal_.live) {
            progress("asking every robot that takes part in " + textOf(event, "service") + " …", -1);
        }
        return;
    }
    if (!terminal_.live) {
        if (state != last_state_ && !over && state != "CHECKING" && state != "RUNNING")
            say(duration(event.value("elapsed_s", 0.0)) + "  " + textOf(event, "service") + "  " +
                lowerCase(state) +
                (event.at("reason").is_object() ? ": " + textOf(event.at("reason"), "message") : ""));
        last_state_ = state;
        showRunLines(event);
        if (over) showRunEnd(event);
        return;
    }
    const auto now = clock_.now();
    news = news || over || state != last_state_ || board_lines_ == 0;
    if (!news && last_progress_at_ && now - *last_progress_at_ < std::chrono::milliseconds(50)) return;
    last_progress_at_ = now;
    last_state_ = state;
    if (progress_shown_) wipe();
    drawRun(event);
    if (!over) return;
    board_lines_ = 0;  // it stays
    showRunEnd(event);
}

void PersonView::drawRun(const Json& event) {
    const auto state = textOf(event, "state");
    const bool over = event.value("final", false);
    if (!over) {
        last_run_ = event;
        last_run_["steps"] = Json::array();
    }
    const auto width = terminal_.width - 1;
    const auto elapsed = event.value("elapsed_s", 0.0);
    const auto steps = inOrder(steps_, state == "COMPENSATING");
    auto visible = steps;
    std::string left_out;
    const auto room = terminal_.height > 6 ? terminal_.height - 5 : 1;
    if (!over && steps.size() > room) {
        const auto rows = chosenRows(steps, room - 1);
        visible.clear();
        std::size_t done = 0;
        for (std::size_t i = 0; i < steps.size(); ++i) {
            if (rows.count(i) != 0) {
                visible.push_back(steps[i]);
            } else if (steps[i]->at("state").is_string()) {
                ++done;
            }
        }
        left_out = fmt::format("… and {} done, {} to come\n", done, steps.size() - visible.size() - done);
    }
    const auto part = event.value("progress", 0.0);
    const auto title = shortened(textOf(event, "service"), width / 2);
    std::string text = board_lines_ > 0 ? fmt::format("\x1b[{}F", board_lines_) : "";
    auto below = paint(title, Tint::Bold) + "  " + progressBar(part, width >= 90 ? 32 : 12) +
                 fmt::format(" {:3.0f} %  ", part * 100) + paint(lowerCase(state), runTint(state)) + "  " +
                 duration(elapsed) + "\n";
    below += stepTable(visible, elapsed, over, width, terminal_.colour) + left_out;
    if (const auto& reason = event.at("reason"); !over && reason.is_object())
        below += paint(shortened(textOf(reason, "message"), width), Tint::Yellow) + "\n";
    board_lines_ = 0;
    for (std::size_t at = 0; at < below.size();) {
        const auto end = below.find('\n', at);
        text += below.substr(at, end - at) + "\x1b[K\n";
        at = end + 1;
        ++board_lines_;
    }
    out_ << text << "\x1b[J" << std::flush;
}

/// Where nothing can be redrawn: what has changed enough to be worth a line.
void PersonView::showRunLines(const Json& event) {
    for (const auto& step : event.at("steps")) {
        if (!step.at("state").is_string()) continue;
        auto& known = printed_[step.at("step").get<int>()];
        const bool same = known.is_object() && known.at("state") == step.at("state") &&
                          known.at("feedback") == step.at("feedback") &&
                          known.at("tries") == step.at("tries") &&
                          step.value("progress", -1.0) - known.value("progress", -1.0) < kPartPerLine;
        if (same || textOf(step, "state") == "QUEUED" || textOf(step, "state") == "DISPATCHED") continue;
        known = step;
        auto text = duration(event.value("elapsed_s", 0.0)) + "  " + whatOf(step) + "  " +
                    stepState(step, false).text;
        if (textOf(step, "state") == "RUNNING" && step.value("progress", -1.0) >= 0)
            text += " " + percent(step.at("progress").get<double>(), 0);
        if (const auto remark = remarkOf(step).text; !remark.empty()) text += "  " + remark;
        say(text);
    }
}

void PersonView::showRunEnd(const Json& event) {
    last_run_ = nullptr;
    const auto state = textOf(event, "state");
    const auto name = textOf(event, "service");
    const bool good = state == "SUCCEEDED";
    const auto mark = good ? paint("✓", Tint::Green) : paint("✗", Tint::Red);
    if (event.value("check", false)) {
        say(mark + " " + name + (good ? " can run: every robot agrees" : " cannot run now"));
    } else if (state == "REFUSED") {
        say(mark + " " + name + " was refused; nothing has moved");
    } else {
        say(mark + " " + name + " " + (state == "UNKNOWN" ? "has an unknown outcome" : lowerCase(state)) +
            " after " + duration(event.value("elapsed_s", 0.0)));
    }
    for (const auto* step : inOrder(steps_, true)) {
        if (const auto results = valueList(*step, "results"); !results.empty())
            say("  " + whatOf(*step) + ": " + results);
    }
    showProblems(event.at("problems"));
    // Where there are problems, the reason is the first of them.
    if (const auto& reason = event.at("reason");
        !good && reason.is_object() && event.at("problems").empty()) {
        Json error{
            {"event", "error"}, {"code", reason.value("code", "")}, {"message", reason.value("message", "")}};
        if (event.contains("fix")) error["fix"] = event["fix"];
        showError(error);
    }
    steps_.clear();
    printed_.clear();
    last_state_.clear();
}

void PersonView::showProblems(const Json& problems) {
    for (const auto& problem : problems) {
        std::string where;
        if (problem.at("step").is_number()) {
            const auto called = textOf(problem, "called");
            where = fmt::format("step {}", problem.at("step").get<int>() + 1) +
                    (called.empty() ? "" : " " + called);
            if (const auto service = textOf(problem, "service"); !service.empty())
                where += " (" + service + ")";
        }
        if (const auto entity = textOf(problem, "entity"); !entity.empty())
            where += (where.empty() ? "" : " ") + entity;
        say("  " + paint("✗", Tint::Red) + " " + where + (where.empty() ? "" : ": ") +
            textOf(problem, "message") + " (" + textOf(problem, "code") + ")");
        if (const auto fix = textOf(problem, "fix"); !fix.empty()) say("      fix: " + fix);
    }
}

void PersonView::showRuns(const Json& event) {
    wipe();
    const auto& runs = event.at("runs");
    if (runs.empty()) {
        say("no robot here remembers a run");
    } else {
        Rows rows;
        for (const auto& run : runs) {
            const auto state = textOf(run, "state");
            rows.push_back(
                {{textOf(run, "id").substr(0, 8)},
                 {calendar(run.value("asked_at_ms", std::int64_t{0}))},
                 {textOf(run, "service"), Tint::Bold},
                 {lowerCase(state), runTint(state)},
                 {duration(run.value("duration_s", 0.0))},
                 {textOf(run, "master")},
                 {textOf(run, "by")},
                 {run.at("reason").is_object() ? textOf(run.at("reason"), "message") : "", Tint::Dim}});
        }
        out_ << fitted({"RUN", "WHEN", "SERVICE", "OUTCOME", "TIME", "MASTER", "BY", "REASON"},
                       std::move(rows), {2, 5, 6}, terminal_)
             << std::flush;
    }
    for (const auto& one : event.at("silent"))
        say(paint("! " + textOf(one, "entity") + " does not answer: " + textOf(one, "message"),
                  Tint::Yellow));
}

void PersonView::showRunRecord(const Json& event) {
    wipe();
    const auto state = textOf(event, "state");
    out_ << paint(textOf(event, "service"), Tint::Bold) << "  " << paint(lowerCase(state), runTint(state))
         << (event.value("final", false) ? " after " : " for ") << duration(event.value("duration_s", 0.0))
         << '\n';
    out_ << "  " << calendar(event.value("asked_at_ms", std::int64_t{0})) << ", by " << textOf(event, "by")
         << "; master " << textOf(event, "master") << '\n';
    for (const auto& one : event.at("participants"))
        out_ << "  role " << one.value("role", 0) << ": " << textOf(one, "entity") << '\n';
    if (const auto& reason = event.at("reason"); reason.is_object())
        out_ << "  " << paint(textOf(reason, "message") + " (" + textOf(reason, "code") + ")", Tint::Red)
             << '\n';
    out_ << paint("  " + textOf(event, "id"), Tint::Dim) << "\n\n";
    std::map<int, Json> steps;
    for (const auto& step : event.at("steps")) steps[step.value("step", 0)] = step;
    Rows rows;
    for (const auto* step : inOrder(steps, false)) {
        const auto& began = step->at("began_s");
        rows.push_back(
            {{orderOf(*step), Tint::Dim},
             {textOf(*step, "called")},
             {textOf(*step, "entity"), Tint::Bold},
             {textOf(*step, "service")},
             stepState(*step, true),
             {began.is_number() ? duration(began.get<double>()) : ""},
             {timeOf(*step, event.value("duration_s", 0.0))},
             {valueList(*step, "parameters")},
             {valueList(*step, "results")},
             {step->at("reason").is_object() ? textOf(step->at("reason"), "message") : "", Tint::Yellow}});
    }
    out_ << fitted({"ORDER", "NAME", "ENTITY", "SERVICE", "STATE", "BEGAN", "TIME", "INPUTS", "RESULTS",
                    "REASON"},
                   std::move(rows), {1, 3, 7, 8}, terminal_)
         << std::flush;
}

}  // namespace axon::cli
