// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <iosfwd>
#include <map>
#include <memory>
#include <string>

#include "cli/session.hpp"
#include "cli/table.hpp"
#include "common/clock.hpp"

namespace axon::cli {

/// What the output goes to.
struct Terminal {
    bool live = false;    ///< a terminal: lines may be redrawn
    bool colour = false;  ///< a terminal, and NO_COLOR is not set
    std::size_t width = 100, height = 24;
    static Terminal ofStandardOutput();
};

/// Shows events to a person: tables, progress that redraws itself, errors as `axon: what (CODE)` and `fix:
/// …` on the error stream. The only place that turns events into text. Threads: one.
class PersonView final : public Events {
  public:
    PersonView(std::ostream& out, std::ostream& err, Terminal terminal, const Clock& clock);
    ~PersonView() override;
    void emit(const Json& event) override;

  private:
    void show(const Json& event);
    void showEntities(const Json& event);
    void showEntity(const Json& event);
    void showStation(const Json& event);
    void showTask(const Json& event);
    void showTasks(const Json& event);
    void showUpload(const Json& event);
    void showReceipts(const Json& event);
    void showCommand(const Json& event);
    void showCheckedOut(const Json& event);
    void showSample(const Json& event);
    void showFinding(const Json& event);
    void showCertificates(const Json& list);
    void showUsers(const Json& event);
    void showUserChanged(const Json& event);
    void showAuditRecord(const Json& record);
    void showAuditTrail(const Json& trail);
    void showIssued(const Json& event);
    void showRevoked(const Json& event);
    void showAgent(const Json& event);
    void showHandOver(const Json& event);
    void showDrill(const Json& event);
    void showError(const Json& event);
    void showGlobalServices(const Json& event);
    void showGlobalService(const Json& event);
    void showBinding(const Json& event);
    void showRun(const Json& event);
    void showRuns(const Json& event);
    void showRunRecord(const Json& event);
    void drawRun(const Json& event);
    void showRunLines(const Json& event);
    void showRunEnd(const Json& event);
    void showProblems(const Json& problems);
    /// One that is replaced by what comes next; where lines cannot be redrawn, now and then an ordinary one.
    void progress(const std::string& text, double part);
    /// An ordinary line; takes the progress line away first.
    void say(const std::string& text);
    void wipe();
    std::string paint(std::string_view text, Tint tint) const;

    std::ostream& out_;
    std::ostream& err_;
    const Terminal terminal_;
    const Clock& clock_;
    bool progress_shown_ = false;
    std::string last_progress_;
    double last_part_ = -1;
    std::optional<TimePoint> last_progress_at_;
    std::string last_feedback_, last_state_;
    int board_lines_ = 0;          // of a run's table, just above the cursor; it is drawn anew
    Json last_run_;                // without its steps; null when none is shown
    std::map<int, Json> steps_;    // of the run that is shown
    std::map<int, Json> printed_;  // likewise, as they were when a line was printed of them
};

/// Each event as one line of JSON. Threads: one.
class JsonView final : public Events {
  public:
    explicit JsonView(std::ostream& out) : out_(out) {}
    void emit(const Json& event) override;

  private:
    std::ostream& out_;
};

/// "[#####-----]", `width` characters in all.
std::string progressBar(double part, std::size_t width);
/// "0.4 ms", "12 ms", "3.2 s", "2 min 05 s"
std::string duration(double seconds);
/// "1.5 KB", "20 MB"
std::string byteCount(double bytes);

}  // namespace axon::cli
