// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/view.hpp"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <ostream>
#include <utility>

#include "cli/view_text.hpp"
#include "cli/words.hpp"

namespace axon::cli {

std::string textOf(const Json& json, const char* member, bool lines) {
    const auto found = json.find(member);
    if (found == json.end() || found->is_null()) return {};
    return printable(found->is_string() ? found->get<std::string>() : line(*found), lines);
}

std::string valueText(const Json& value) {
    if (value.is_string()) return printable(value.get<std::string>());
    if (value.is_number_float()) return fmt::format("{:.6g}", value.get<double>());
    return printable(line(value));
}

std::string valuesText(const Json& values) {
    std::string text;
    for (const auto& value : values) text += (text.empty() ? "" : ", ") + valueText(value);
    return text;
}

Tint stateTint(const std::string& state) {
    if (state == "ERR" || state == "UNAV") return Tint::Red;
    if (state == "BUSY" || state == "COLLAB" || state == "SLAVE") return Tint::Cyan;
    if (state == "IDLE") return Tint::Green;
    return Tint::None;
}

std::string stageText(const Json& milliseconds, double precision_ms) {
    if (milliseconds.is_number() && milliseconds.get<double>() < precision_ms)
        return "< " + duration(precision_ms / 1000);
    return milliseconds.is_number() ? duration(milliseconds.get<double>() / 1000) : "-";
}

namespace {

/// How many bytes a text of base64 stands for.
double bytesOf(const Json& base64) {
    if (!base64.is_string()) return 0;
    const auto& text = base64.get_ref<const std::string&>();
    const auto padding = static_cast<std::size_t>(text.ends_with("==") ? 2 : text.ends_with('=') ? 1 : 0);
    return static_cast<double>(text.size() / 4 * 3 - std::min(padding, text.size() / 4 * 3));
}

/// "320 × 240 jpeg, 12.3 KB": nobody reads pixels.
std::string imageText(const Json& image) {
    std::string text;
    const auto width = image.value("width", Json(0));
    const auto height = image.value("height", Json(0));
    if (width != 0 || height != 0) text = valueText(width) + " × " + valueText(height) + " ";
    text += textOf(image, "encoding");
    const auto pixels = image.find("pixels");
    return pixels == image.end() ? text : text + ", " + byteCount(bytesOf(*pixels));
}

/// "x=1.5 y=2" for {"pose": {"x": 1.5, "y": 2, "frame": ""}}, "98.6 %" for a number with units; the beginning
/// of long lists.
std::string sampleText(const Json& sample) {
    if (!sample.is_structured()) return valueText(sample);
    if (sample.is_array()) {
        constexpr std::size_t kShown = 12;
        std::string text = "[";
        for (std::size_t i = 0; i < sample.size() && i < kShown; ++i)
            text += (i > 0 ? " " : "") + sampleText(sample[i]);
        return text + (sample.size() > kShown ? fmt::format(" …] {} values", sample.size()) : "]");
    }
    if (sample.size() == 1 && sample.contains("raw"))
        return byteCount(bytesOf(sample["raw"])) + " of raw data";
    if (sample.size() == 1 && sample.contains("image") && sample["image"].is_object())
        return imageText(sample["image"]);
    if (sample.size() == 1 && sample.begin()->is_structured()) return sampleText(*sample.begin());
    std::string text;
    std::string units;
    bool bare = true;  // one value: what it is called says nothing
    for (const auto& [name, value] : sample.items()) {
        if (value == "") continue;
        if (name == "units") {
            units = " " + valueText(value);
            continue;
        }
        bare = text.empty() && (name == "value" || name == "values");
        text += (text.empty() ? "" : " ") + printable(name) + "=" + sampleText(value);
    }
    if (bare && !text.empty()) text.erase(0, text.find('=') + 1);
    return text + units;
}

}  // namespace

Terminal Terminal::ofStandardOutput() {
    Terminal terminal;
    const char* kind = std::getenv("TERM");
    const char* no_colour = std::getenv("NO_COLOR");
    terminal.live = ::isatty(STDOUT_FILENO) == 1 && (kind == nullptr || std::string_view(kind) != "dumb");
    terminal.colour = terminal.live && (no_colour == nullptr || *no_colour == '\0');
    winsize size{};
    if (::ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col >= 20) terminal.width = size.ws_col;
    if (size.ws_row >= 5) terminal.height = size.ws_row;
    return terminal;
}

std::string lowerCase(std::string text) {
    std::transform(text.begin(), text.end(), text.begin(),
                   [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
    return text;
}

std::string percent(double part, int width) {
    return fmt::format("{:{}.0f} %", std::max(0.0, part) * 100, width);  // nor is anything at -0 %
}

std::string progressBar(double part, std::size_t width) {
    const auto inner = width - 2;
    const auto full = static_cast<std::size_t>(std::clamp(part, 0.0, 1.0) * static_cast<double>(inner) + 0.5);
    return "[" + std::string(full, '#') + std::string(inner - full, '-') + "]";
}

std::string duration(double seconds) {
    if (seconds < 0.01) return fmt::format("{:.1f} ms", seconds * 1000);
    if (seconds < 1) return fmt::format("{:.0f} ms", seconds * 1000);
    if (seconds < 60) return fmt::format("{:.1f} s", seconds);
    const auto whole = static_cast<long long>(seconds + 0.5);
    return fmt::format("{} min {:02} s", whole / 60, whole % 60);
}

std::string byteCount(double bytes) {
    if (bytes < 1000) return fmt::format("{:.0f} B", bytes);
    if (bytes < 1e6) return fmt::format("{:.1f} KB", bytes / 1e3);
    if (bytes < 1e9) return fmt::format("{:.1f} MB", bytes / 1e6);
    return fmt::format("{:.1f} GB", bytes / 1e9);
}

PersonView::PersonView(std::ostream& out, std::ostream& err, Terminal terminal, const Clock& clock)
    : out_(out), err_(err), terminal_(terminal), clock_(clock) {}

PersonView::~PersonView() {
    board_lines_ = 0;  // a run that was left behind stays as it was last seen
    wipe();
    out_.flush();
}

std::string PersonView::paint(std::string_view text, Tint tint) const {
    return tinted(text, tint, terminal_.colour);
}

void PersonView::wipe() {
    if (board_lines_ > 0) out_ << "\x1b[" << std::exchange(board_lines_, 0) << "F\x1b[J";
    if (!progress_shown_) return;
    out_ << "\r\x1b[K";
    progress_shown_ = false;
}

void PersonView::say(const std::string& text) {
    wipe();
    out_ << text << '\n' << std::flush;
}

void PersonView::progress(const std::string& text, double part) {
    const auto now = clock_.now();
    if (terminal_.live) {
        // Twenty times a second is as fast as a person reads; the last one of a burst is drawn by what
        // follows it.
        if (progress_shown_ && last_progress_at_ && now - *last_progress_at_ < std::chrono::milliseconds(50))
            return;
        out_ << "\r\x1b[K" << shortened(text, terminal_.width - 1) << std::flush;
        progress_shown_ = true;
    } else {
        const bool due = !last_progress_at_ || now - *last_progress_at_ >= std::chrono::seconds(5) ||
                         (part >= 0 && part - last_part_ >= 0.1);
        if (!due || text == last_progress_) return;
        out_ << text << '\n' << std::flush;
    }
    last_progress_ = text;
    last_part_ = part;
    last_progress_at_ = now;
}

void PersonView::emit(const Json& event) {
    show(event);
    // What was said has taken the place of the run's table.
    if (terminal_.live && board_lines_ == 0 && last_run_.is_object()) drawRun(last_run_);
}

void PersonView::show(const Json& event) {
    const auto kind = event.value("event", "");
    if (kind == "entities") return showEntities(event);
    if (kind == "entity") return showEntity(event);
    if (kind == "task") return showTask(event);
    if (kind == "tasks") return showTasks(event);
    if (kind == "upload") return showUpload(event);
    if (kind == "receipts") return showReceipts(event);
    if (kind == "checked_out") return showCheckedOut(event);
    if (kind == "sample") return showSample(event);
    if (kind == "finding") return showFinding(event);
    if (kind == "certificates") return showCertificates(event.at("certificates"));
    if (kind == "issued") return showIssued(event);
    if (kind == "revoked") return showRevoked(event);
    if (kind == "users") return showUsers(event);
    if (kind == "user_changed") return showUserChanged(event);
    if (kind == "audit_record") return showAuditRecord(event);
    if (kind == "audit_trail") return showAuditTrail(event);
    if (kind == "agent") return showAgent(event);
    if (kind == "error") return showError(event);
    if (kind == "global_services") return showGlobalServices(event);
    if (kind == "global_service") return showGlobalService(event);
    if (kind == "binding") return showBinding(event);
    if (kind == "run") return showRun(event);
    if (kind == "run_begun") return say(textOf(event, "service") + " is running");
    if (kind == "runs") return showRuns(event);
    if (kind == "run_record") return showRunRecord(event);
    if (kind == "uploaded") {
        return say(paint("✓", Tint::Green) + " " + textOf(event, "resource") + " of " +
                   textOf(event, "service") + " was uploaded to " + textOf(event, "entity"));
    }
    if (kind == "set") {
        const auto units = textOf(event, "units");
        return say(textOf(event, "entity") + " " + textOf(event, "service") + ": " +
                   textOf(event, "parameter") + " = " + valuesText(event.at("values")) +
                   (units.empty() ? "" : " " + units));
    }
    if (kind == "released") return say(textOf(event, "entity") + " is released");
    if (kind == "lost") {
        wipe();
        const auto holder = textOf(event, "holder");
        err_ << paint("axon: the check-out of " + textOf(event, "entity") + " is LOST: " +
                          textOf(event, "message") + (holder.empty() ? "" : "; held by " + holder),
                      Tint::Red)
             << " (" << textOf(event, "code") << ")\n"
             << std::flush;
        return;
    }
    if (kind == "orphaned") {
        wipe();
        auto why = textOf(event, "message");
        if (why.ends_with('.')) why.pop_back();
        err_ << paint("axon: " + why + "; " + textOf(event, "entity") +
                          " stands still and stays yours for a while",
                      Tint::Yellow)
             << '\n'
             << std::flush;
        return;
    }
    if (kind == "resumed") return say(textOf(event, "entity") + " is yours again: axon rearm lets it move");
    if (kind == "hand_over") return showHandOver(event);
    if (kind == "waiting")
        return terminal_.live ? progress(textOf(event, "message"), -1) : say(textOf(event, "message"));
    if (kind == "drill") return showDrill(event);
    if (kind == "drilling") {
        const auto done = event.value("done", 0.0);
        const auto count = event.value("count", 1.0);
        return progress(fmt::format("drill {} {:.0f} of {:.0f}", progressBar(done / count, 30), done, count),
                        done / count);
    }
    if (kind == "text") return say(textOf(event, "entity") + ": " + textOf(event, "text"));
    if (kind == "raw") {
        auto hex = textOf(event, "hex");
        if (hex.size() > 64) hex = hex.substr(0, 64) + "…";
        return say(fmt::format("{}: {} raw bytes  {}", textOf(event, "entity"), event.value("size", 0), hex));
    }
    if (kind == "dropped") {
        return say(paint(fmt::format("({} samples were dropped: they came faster than they could be shown)",
                                     event.value("count", 0)),
                         Tint::Yellow));
    }
    if (kind == "watching") {
        if (terminal_.live) say(paint("watching " + textOf(event, "entity") + "; Ctrl-C ends it", Tint::Dim));
        return;
    }
    if (kind == "viewing") {
        return say(event.value("opened", false) ? "showing " + textOf(event, "file")
                                                : "open this page in a browser: " + textOf(event, "file"));
    }
    if (kind == "sent") {
        return say(fmt::format("sent {} {} to {}", byteCount(event.value("size", 0.0)),
                               event.value("raw", false) ? "of raw data" : "of text",
                               textOf(event, "entity")));
    }
    if (kind == "done") {
        static const std::pair<const char*, const char*> kSaid[] = {
            {"rearm", "is rearmed and takes tasks again"},
            {"pause", "will pause"},
            {"resume", "will continue"},
            {"cancel", "will be cancelled"}};
        if (const auto verb = event.value("verb", ""); verb == "reset" || verb == "clear")
            return showCommand(event);
        if (event.value("verb", "") == "handover") {
            return say(textOf(event, "entity") +
                       (event.value("answer", "") == "accept" ? " is handed over" : " stays yours"));
        }
        auto what = textOf(event, "entity");
        if (const auto service = textOf(event, "service"); !service.empty())
            what += (what.empty() ? "" : " ") + service;
        for (const auto& [verb, said] : kSaid) {
            if (event.value("verb", "") == verb) return say(what + " " + said);
        }
        return say(what);
    }
    if (kind == "project") {
        say(paint("✓", Tint::Green) + " made the " + textOf(event, "kind") + " project " +
            textOf(event, "name") + "; next:");
        for (const auto& command : event.at("next")) out_ << "  " << valueText(command) << '\n';
        out_ << std::flush;
        return;
    }
    if (kind == "version") return say("axon " + textOf(event, "version"));
    if (kind == "notice") return say(paint(textOf(event, "message"), Tint::Dim));
    if (kind == "line") return say(textOf(event, "text", true));
}

void PersonView::showTask(const Json& event) {
    const auto state = textOf(event, "state");
    const auto who = textOf(event, "entity") + " " + textOf(event, "service");
    const auto feedback = textOf(event, "feedback");
    const auto elapsed = event.value("elapsed_s", 0.0);
    const double part = event.value("progress", -1.0);
    if (event.value("final", false)) {
        const bool good = state == "SUCCEEDED";
        const auto mark = good ? paint("✓", Tint::Green) : paint("✗", Tint::Red);
        say(mark + " " + who + " " + lowerCase(state) + " after " + duration(elapsed));
        const auto& results = event.at("results");
        const auto units = event.value("units", Json::object());
        const auto live = event.value("live", Json::array());
        for (const auto& [name, values] : results.items()) {
            // What was reported on the way is no result, unless nothing else tells where it ended.
            if (good && std::find(live.begin(), live.end(), Json(name)) != live.end()) continue;
            const auto unit = units.value(name, "");
            out_ << "  " << printable(name) << " = " << valuesText(values)
                 << (unit.empty() ? "" : " " + printable(unit)) << '\n';
        }
        if (const auto& reason = event.at("reason"); !good && reason.is_object()) {
            Refusal refusal{RefusalCode::Ok, reason.value("message", ""), reason.value("holder", "")};
            Json error{{"event", "error"}, {"code", reason.value("code", "")}, {"message", refusal.message}};
            if (event.contains("fix")) error["fix"] = event["fix"];
            showError(error);
        } else if (!good && !feedback.empty()) {
            out_ << "  " << feedback << '\n';
        }
        out_ << std::flush;
        return;
    }
    if (terminal_.live && !feedback.empty() && feedback != last_feedback_)
        say("  " + paint(feedback, Tint::Dim));
    // Between "queued" and "running" there is nothing to know for who reads lines.
    if (!terminal_.live && state == "DISPATCHED") return;
    std::string text = who + "  ";
    if (part >= 0) {
        text += progressBar(part, 30) + " " + percent(part);
    } else {
        text += lowerCase(state);
    }
    if (part >= 0 && state != "RUNNING") text += "  " + lowerCase(state);
    text += "  " + duration(elapsed);
    for (const auto& name : event.value("live", Json::array())) {
        const auto& results = event.at("results");
        const auto told = results.find(name.get<std::string>());
        if (told == results.end()) continue;
        const auto unit = event.value("units", Json::object()).value(told.key(), "");
        text += "  " + printable(told.key()) + " " + valuesText(*told) +
                (unit.empty() ? "" : " " + printable(unit));
    }
    if (!terminal_.live) {
        // What is new is worth a line whatever the clock says.
        if (!feedback.empty()) text += "  " + feedback;
        if (feedback != last_feedback_ || state != last_state_) last_progress_at_.reset();
    }
    last_feedback_ = feedback;
    last_state_ = state;
    progress(text, part);
}

void PersonView::showTasks(const Json& event) {
    const auto& list = event.at("tasks");
    const auto forgotten = event.value("forgotten", std::size_t{0});
    if (list.empty() && forgotten == 0) return say("no tasks were started here");
    Table table({"ID", "ENTITY", "SERVICE", "STATE", "PROGRESS", "REASON"});
    for (const auto& task : list) {
        const auto state = textOf(task, "state");
        table.add({{textOf(task, "id").substr(0, 8)},
                   {textOf(task, "entity")},
                   {textOf(task, "service")},
                   {lowerCase(state), state == "SUCCEEDED"         ? Tint::Green
                                      : task.value("final", false) ? Tint::Red
                                                                   : Tint::Cyan},
                   {task.value("progress", -1.0) < 0 ? "" : percent(task["progress"].get<double>())},
                   {task["reason"].is_object() ? textOf(task["reason"], "message") : textOf(task, "feedback"),
                    Tint::Dim}});
    }
    wipe();
    out_ << table.text(terminal_.colour);
    if (forgotten > 0)
        out_ << paint(fmt::format("{} older {} ended and {} no longer listed", forgotten,
                                  forgotten == 1 ? "task has" : "tasks have", forgotten == 1 ? "is" : "are"),
                      Tint::Dim)
             << '\n';
    out_ << std::flush;
}

void PersonView::showUpload(const Json& event) {
    const auto total = event.value("total", 0.0);
    const auto part = total > 0 ? event.value("sent", 0.0) / total : 1.0;
    progress(fmt::format("{}  {} {}  {} of {}", textOf(event, "resource"), progressBar(part, 30),
                         percent(part), byteCount(event.value("sent", 0.0)), byteCount(total)),
             part);
}

void PersonView::showCheckedOut(const Json& event) {
    const auto names = [](const Json& entities) {
        std::string text;
        for (std::size_t i = 0; i < entities.size(); ++i) {
            if (i > 0) text += i + 1 == entities.size() ? " and " : ", ";
            text += textOf(entities[i], entities[i].contains("call") ? "call" : "name");
        }
        return text;
    };
    const auto& entities = event.at("entities");
    const auto already = event.value("already", Json::array());
    if (!already.empty())
        say(names(already) + (already.size() == 1 ? " is already yours" : " are already yours"));
    if (entities.empty()) return;
    const std::string are = entities.size() == 1 ? " is" : " are";
    if (event.contains("for")) {
        say(paint(names(entities) + are + " checked out for this " + textOf(event, "for"), Tint::Dim));
    } else {
        say(names(entities) + are + " checked out" +
            (event.value("kept", false) ? ", until axon release" : ""));
    }
}

void PersonView::showSample(const Json& event) {
    if (const auto file = textOf(event, "file"); !file.empty()) {
        const auto text = fmt::format("{} {} #{}  {} → {}", textOf(event, "entity"), textOf(event, "stream"),
                                      event.value("sequence", 0ULL), sampleText(event.at("sample")), file);
        return progress(text, -1);
    }
    auto text = sampleText(event.at("sample"));
    const auto start = fmt::format("{} {} #{}  ", textOf(event, "entity"), textOf(event, "stream"),
                                   event.value("sequence", 0ULL));
    if (terminal_.live && columns(start) + 10 < terminal_.width) {
        text = shortened(text, terminal_.width - columns(start));
    }
    say(paint(start, Tint::Dim) + text);
}

void PersonView::showFinding(const Json& event) {
    const auto level = event.value("level", "bad");
    const auto mark = level == "ok"     ? paint("✓", Tint::Green)
                      : level == "warn" ? paint("!", Tint::Yellow)
                                        : paint("✗", Tint::Red);
    say(mark + " " + textOf(event, "name") + ": " + textOf(event, "message"));
    if (const auto fix = textOf(event, "fix"); !fix.empty()) say("    fix: " + fix);
}

void PersonView::showCertificates(const Json& list) {
    if (list.empty()) return say("there are no certificates");
    Table table({"NAME", "KIND", "FOR", "ISSUED BY", "FROM", "UNTIL", "FILE"});
    for (const auto& one : list) {
        const auto validity = textOf(one, "validity");
        const auto tint = validity == "valid"          ? Tint::None
                          : validity == "expires soon" ? Tint::Yellow
                                                       : Tint::Red;
        const auto file = textOf(one, "file");
        table.add({{textOf(one, "name"), Tint::Bold},
                   {textOf(one, "kind")},
                   {valuesText(one.at("names"))},
                   {textOf(one, "issuer")},
                   {textOf(one, "from")},
                   {validity == "revoked" ? validity : textOf(one, "until"), tint},
                   {file.substr(file.rfind('/') + 1)}});
    }
    auto text = table.text(terminal_.colour);
    text.pop_back();
    say(text);
}

void PersonView::showUsers(const Json& event) {
    const auto& list = event.at("users");
    if (list.empty()) return say("there are no users in " + textOf(event, "file"));
    Table table({"NAME", "ROLE", "PASSWORD HASH"});
    for (const auto& one : list) {
        const auto hash = textOf(one, "hash");
        table.add({{textOf(one, "name"), Tint::Bold},
                   {textOf(one, "role")},
                   {hash, hash == "argon2id" ? Tint::None : Tint::Yellow}});
    }
    auto text = table.text(terminal_.colour);
    if (!event.at("lists").empty()) {
        Table lists({"RIGHT", "ENTITY", "WHO"});
        for (const auto& one : event.at("lists"))
            lists.add({{textOf(one, "right")}, {textOf(one, "entity")}, {valuesText(one.at("who"))}});
        text += lists.text(terminal_.colour);
    }
    say(text + "fingerprint " + textOf(event, "fingerprint"));
}

void PersonView::showUserChanged(const Json& event) {
    const auto action = textOf(event, "action");
    const auto role = textOf(event, "role");
    const auto what = action == "add"        ? "may log in as " + role
                      : action == "role"     ? "has the role " + role
                      : action == "password" ? std::string("has a new password")
                                             : std::string("is removed");
    say(paint("✓", Tint::Green) + " " + textOf(event, "name") + " " + what +
        "; servers that read this file say in their logs when they have taken it over (users: taken)");
}

void PersonView::showAuditRecord(const Json& record) {
    auto who = textOf(record, "user");
    if (who.empty()) who = textOf(record, "session_user");
    for (const auto* other : {"name", "client", "peer"})
        if (const auto text = textOf(record, other); !text.empty() && text != who)
            who += (who.empty() ? "" : ", ") + text;
    const auto kind = textOf(record, "kind");
    const bool grave = kind == "stop" || kind == "refusal" || kind == "take-over" || kind == "lost";
    const auto outcome = textOf(record, "outcome");
    const auto entity = textOf(record, "entity");
    say(paint(textOf(record, "at"), Tint::Dim) + "  " + paint(kind, grave ? Tint::Yellow : Tint::Bold) +
        "  " + textOf(record, "what") + (outcome.empty() || outcome == "OK" ? "" : "  " + outcome) +
        (who.empty() ? "" : "  by " + who) + (entity.empty() ? "" : "  at " + entity));
}

void PersonView::showAuditTrail(const Json& trail) {
    const auto hash = textOf(trail, "hash");
    say((trail.value("whole", false) ? paint("✓", Tint::Green) : paint("✗", Tint::Red)) + " " +
        textOf(trail, "trail") + ": " +
        fmt::format("{} records, {} to {}, the last of {}", trail.value("records", 0ULL),
                    trail.value("first", 0ULL), trail.value("last", 0ULL), textOf(trail, "last_at")));
    for (const auto& place : trail.at("unfinished"))
        say("  unfinished, by a kill or a loss of power: " + valueText(place));
    const auto named = trail.at("unfinished").size();
    if (const auto all = trail.value("unfinished_lines", std::uint64_t{0}); all > named)
        say(fmt::format("  and {} further unfinished lines", all - named));
    if (!hash.empty()) say(paint("  hash of the last line, to keep elsewhere: " + hash, Tint::Dim));
}

void PersonView::showIssued(const Json& event) {
    const auto& certificate = event.at("certificate");
    say(paint("✓", Tint::Green) + " " + textOf(certificate, "name") + " (" + textOf(certificate, "kind") +
        "), valid until " + textOf(certificate, "until"));
    for (const auto& file : event.at("files")) say("  " + valueText(file));
    say(paint("next: " + textOf(event, "next"), Tint::Dim));
}

void PersonView::showRevoked(const Json& event) {
    say(paint("✓", Tint::Green) + fmt::format(" {} revoked now, {} in the list, which is valid until {}",
                                              event.at("added").get<std::size_t>(),
                                              event.at("revoked").get<std::size_t>(),
                                              textOf(event, "until")));
    say("  " + textOf(event, "file"));
    for (const auto& line : event.at("lines")) say("    " + valueText(line));
    say(paint("next: " + textOf(event, "next"), Tint::Dim));
}

void PersonView::showHandOver(const Json& event) {
    wipe();
    const auto entity = textOf(event, "entity");
    if (event.value("withdrawn", false)) {
        say(textOf(event, "by") + " no longer asks for " + entity);
        return;
    }
    const auto reason = textOf(event, "reason");
    const auto within = event.value("answer_within_s", 0.0);
    err_ << paint(
        "axon: " + textOf(event, "by") + " asks for " + entity + (reason.empty() ? "" : ": " + reason),
        Tint::Yellow);
    const auto answer = textOf(event, "answer");
    const bool yield = event.value("yield", false);
    if (answer.empty()) {
        err_ << "\nnobody can answer for this command: " << entity << " "
             << (yield ? "is handed over" : "stays here") << (within > 0 ? " after " + duration(within) : "")
             << '\n';
    } else {
        err_ << "\nanswer" << (within > 0 ? " within " + duration(within) : "") << ": " << answer
             << " accept, or refuse; no answer " << (yield ? "hands it over" : "refuses") << '\n';
    }
    err_ << std::flush;
}

void PersonView::showAgent(const Json& event) {
    if (!event.value("running", false)) return say("no agent is running, and nothing is checked out here");
    say(fmt::format("agent {} keeps the session {} at {}", event.value("pid", 0), textOf(event, "self"),
                    textOf(event, "server")) +
        (event.value("connected", false) ? "" : paint(", which is NOT CONNECTED", Tint::Red)));
    for (const auto& entity : event.at("held"))
        say("  holds " + textOf(entity, "call") + "  " +
            paint(textOf(entity, "state"), stateTint(textOf(entity, "state"))) +
            (entity.value("direct", false) ? paint("  direct", Tint::Dim) : "") +
            (entity.value("orphaned", false) ? paint("  until the connection is back", Tint::Yellow) : ""));
    for (const auto& entity : event.at("lost"))
        say(paint("  LOST " + textOf(entity, "name") + ": " + textOf(entity, "message"), Tint::Red));
    if (const auto log = textOf(event, "log"); !log.empty()) say(paint("  log: " + log, Tint::Dim));
}

void PersonView::showError(const Json& event) {
    wipe();
    out_ << std::flush;
    err_ << paint("axon:", Tint::Red) << ' ' << textOf(event, "message", true);
    if (const auto code = textOf(event, "code"); !code.empty() && code != "USAGE")
        err_ << " (" << code << ")";
    err_ << '\n';
    const auto message = textOf(event, "message");
    if (const auto holder = textOf(event, "holder");
        !holder.empty() && message.find(holder) == std::string::npos) {
        err_ << "held by: " << holder << '\n';
    }
    if (const auto fix = textOf(event, "fix"); !fix.empty()) err_ << "fix: " << fix << '\n';
    err_ << std::flush;
}

void JsonView::emit(const Json& event) {
    out_ << line(event) << '\n' << std::flush;
}

}  // namespace axon::cli
