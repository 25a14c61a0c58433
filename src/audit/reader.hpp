// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "audit/line.hpp"

namespace axon::audit {

/// Something that is wrong with a trail.
struct Fault {
    std::string file;
    std::uint64_t line = 0;  ///< 1, 2, …; 0: the whole file
    std::string text;        ///< what is wrong: changed, missing, out of order, no record

    std::string place() const { return line == 0 ? file : file + ':' + std::to_string(line); }
    bool operator==(const Fault&) const = default;
};

/// What a trail is like.
struct Chain {
    static constexpr std::size_t kFaults = 100;

    std::string name;
    std::uint64_t records = 0;
    std::uint64_t first = 0, last = 0;  ///< numbers of records; older ones have been rotated away
    std::string hash;                   ///< of the last line that is complete: what to keep elsewhere
    std::string last_at;                ///< time of the last record
    std::vector<Fault> faults;          ///< the first kFaults
    std::uint64_t faulty = 0;           ///< all of them
    /// Lines that a kill or a loss of power has cut off, "FILE:LINE", the first kFaults. They are no fault.
    std::vector<std::string> unfinished;
    std::uint64_t unfinished_lines = 0;  ///< all of them
    bool kept_found = false;             ///< a line has the hash that was asked for

    bool whole() const { return faulty == 0; }
};

/// Verifies one trail, line by line. Pure. Bounded: one line, and what Chain says.
///
/// A line that is the beginning of the next record, and no more, is unfinished, and no fault, where nothing
/// follows it or a record of kind "started" that covers it by its hash: that is what a new life of the
/// program writes.
class ChainReader {
  public:
    /// `each` gets every record that can be read, also of a trail with faults.
    using Each = std::function<void(const Record& record)>;

    /// `kept`: a hash that a line should have; empty: none.
    explicit ChainReader(Each each = {}, std::string kept = {})
        : each_(std::move(each)), kept_(std::move(kept)) {}

    /// The next file of the trail.
    void file(std::string name);
    /// Its next line, without its end; `ended`: it has one.
    void line(std::string_view text, bool ended = true);
    /// Something about the present file that its lines do not show.
    void fault(std::string text);
    /// What has been read.
    Chain end();

  private:
    struct Place {
        std::string file;
        std::uint64_t line = 0;
    };
    void add(const Place& place, std::string text);
    bool beginsARecord(std::string_view text) const;
    void check(const Record& record, std::uint64_t skipped);
    void endTorn(std::uint64_t lines, bool covered);

    const Each each_;
    const std::string kept_;
    Chain chain_;
    Place here_, last_;  // last_: of the last line
    std::string hash_;   // of the last line, also of one that is not complete
    struct Torn {
        Place place;
        bool begins_a_record = false;
    };
    std::vector<Torn> torn_;        // lines that are no records, since the last record; at most kFaults
    std::uint64_t torn_lines_ = 0;  // how many
};

/// Reads the trails of a folder, or the one of that name. Throws std::runtime_error where a file cannot be
/// read.
std::vector<Chain> readTrails(const std::filesystem::path& folder, const std::string& kept = {},
                              const std::function<void(const std::string& trail, const Record&)>& each = {});

}  // namespace axon::audit
