// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace axon::bench {

/// Quantile q of values in order by the nearest rank, and the median of an even number the mean of the two in
/// the middle; 0 for none.
double quantile(const std::vector<double>& ordered, double q);
/// {"median", "p10", "p90", "n"} of values in any order; infinite ones are null.
nlohmann::json spread(std::vector<double> values);

/// Ours by theirs, batch by batch: 0 where only theirs is infinite, infinite where only ours is, not a number
/// where both are.
std::vector<double> ratios(const std::vector<double>& ours, const std::vector<double>& theirs);

/// The geometric mean over N of the medians of ratios; null where one of them is not finite or 0, for then
/// one of the two lost most batches.
class MeanOverN {
  public:
    /// `ratio` as spread() gives it.
    void add(std::size_t n, const nlohmann::json& ratio);
    nlohmann::json mean() const;
    /// Those that have one.
    const std::vector<std::size_t>& n() const { return n_; }

  private:
    double logs_ = 0;
    std::vector<std::size_t> n_;
    bool null_ = false;
};

/// Latencies in milliseconds. What never arrived counts as infinitely late: it belongs to the tail, not to
/// nowhere.
class Series {
  public:
    /// Every message between two of these belongs to one batch.
    void beginBatch();
    void add(double ms);
    void lose();

    std::size_t sent() const { return arrived_.size() + lost_; }
    std::size_t lost() const { return lost_; }
    /// Of each batch; infinite where one of it never arrived.
    const std::vector<double>& means() const { return means_; }
    const std::vector<double>& lasts() const { return lasts_; }
    /// Ends the open batch, too. "n" sent, "lost", "mean" of what arrived, "p50", "p99", "p99.9" (from 1000
    /// messages on), "max", "last" (median over the batches); a figure that is infinite is null.
    nlohmann::json json();

  private:
    void endBatch();

    std::vector<double> arrived_, means_, lasts_;
    std::size_t lost_ = 0;
    bool open_ = false;
    std::size_t batch_begin_ = 0, batch_lost_ = 0;
};

/// A figure of Series::json as text of this width: "never" for null, "-" where there is none.
std::string figure(const nlohmann::json& series, const char* key, int width = 9);

/// The file of --json. It is written anew with each row, so what interrupts a run leaves a usable file,
/// marked "partial".
class Report {
  public:
    /// `file` may be empty. Throws std::runtime_error when it cannot be written.
    Report(std::string file, const std::string& experiment, nlohmann::json settings);
    void add(nlohmann::json row);
    void set(const std::string& key, nlohmann::json value);
    const nlohmann::json& all() const { return all_; }
    /// Not partial any more, unless it was interrupted.
    void finish();

  private:
    void write() const;
    std::string file_;
    nlohmann::json all_;
};

/// An experiment's work. What fails because it was interrupted is no failure.
void carryOut(const std::function<void()>& work);
/// The end of every experiment: finishes the report, prints what was wrong of Axon's (empty: nothing) and
/// whether this is a part only, and gives the exit status.
int conclude(Report& report, const std::string& wrong);

/// One line on a terminal that the next one replaces; nothing where standard error is none. An empty text
/// clears it.
void progress(const std::string& text);

/// What the results were measured on: processor, cores, memory, kernel, load, whether real-time scheduling is
/// permitted, build.
nlohmann::json machine();
/// Version of an installed Debian package, or empty.
std::string packageVersion(const std::string& package);

/// Sleeps until a time of nowNs(); false when interrupted before.
bool sleepUntil(std::int64_t time);

}  // namespace axon::bench
