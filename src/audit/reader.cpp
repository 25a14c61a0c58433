// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/reader.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "audit/files.hpp"
#include "common/descriptor.hpp"

namespace axon::audit {

namespace fs = std::filesystem;

void ChainReader::add(const Place& place, std::string text) {
    ++chain_.faulty;
    if (chain_.faults.size() < Chain::kFaults)
        chain_.faults.push_back({place.file, place.line, std::move(text)});
}

void ChainReader::file(std::string name) {
    here_ = {std::move(name), 0};
}

void ChainReader::fault(std::string text) {
    add({here_.file, 0}, std::move(text));
}

void ChainReader::line(std::string_view text, bool ended) {
    ++here_.line;
    const auto record = readLine(text);
    if (record) {
        const auto skipped = std::exchange(torn_lines_, 0);
        check(*record, skipped);
        ++chain_.records;
        if (chain_.first == 0) chain_.first = record->number;
        chain_.last = record->number;
        chain_.last_at = record->at;
    } else {
        ++torn_lines_;
        if (torn_.size() < Chain::kFaults) torn_.push_back({here_, beginsARecord(text)});
    }
    hash_ = hashOf(text);
    if (!kept_.empty() && hash_ == kept_) chain_.kept_found = true;
    if (ended || record) chain_.hash = hash_;  // a part of a record may be being written
    last_ = here_;
    if (record && each_) each_(*record);
}

/// As far as it goes.
bool ChainReader::beginsARecord(std::string_view text) const {
    const auto begin =
        chain_.records == 0 ? std::string("{\"n\":") : "{\"n\":" + std::to_string(chain_.last + 1) + ',';
    return text.substr(0, begin.size()) == std::string_view(begin).substr(0, text.size());
}

/// What becomes of the lines before that are no records.
void ChainReader::endTorn(std::uint64_t lines, bool covered) {
    for (const auto& [place, begins_a_record] : torn_) {
        if (!covered || !begins_a_record) {
            add(place, "is no record: it was changed or damaged");
            continue;
        }
        ++chain_.unfinished_lines;
        if (chain_.unfinished.size() < Chain::kFaults)
            chain_.unfinished.push_back(place.file + ':' + std::to_string(place.line));
    }
    chain_.faulty += lines - torn_.size();
    torn_.clear();
}

/// Before it becomes the last one. `skipped`: lines before it that are no records.
void ChainReader::check(const Record& record, std::uint64_t skipped) {
    const bool first = chain_.records == 0;
    const auto expected = chain_.last + 1;
    const bool covers = hash_.empty() || record.before == hash_;
    if (skipped > 0) {
        const bool goes_on = covers && record.kind == "started" && (first || record.number == expected);
        endTorn(skipped, goes_on);
        if (goes_on) return;
        if (!first && record.number > expected + skipped)
            add(here_, "is record " + std::to_string(record.number) + ", but record " +
                           std::to_string(expected) + " was expected: records before it are missing");
        return;
    }
    if (first) {
        if (record.number == 1 && record.before != kNoHash)
            add(here_, "is the first record, but names a line before it: it was changed");
        return;
    }
    if (record.number > expected) {
        const auto missing = record.number - expected;
        add(here_, std::to_string(missing) + (missing == 1 ? " record is" : " records are") +
                       " missing before it: it is record " + std::to_string(record.number) + ", and record " +
                       std::to_string(expected) + " was expected");
    } else if (record.number < expected) {
        add(here_, "is record " + std::to_string(record.number) + ", but record " + std::to_string(expected) +
                       " was expected: it was changed, copied or put in another place");
    } else if (!covers) {
        add(last_, "was changed: the record after it names another hash");
    }
}

Chain ChainReader::end() {
    endTorn(std::exchange(torn_lines_, 0), true);
    return std::exchange(chain_, {});
}

namespace {

void readFile(const fs::path& path, ChainReader& reader) {
    const Descriptor fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
    struct stat facts {};
    if (!fd.open() || ::fstat(fd.get(), &facts) != 0)
        throw std::runtime_error("'" + path.string() +
                                 "' cannot be read: " + std::generic_category().message(errno) +
                                 "; fix: run it as the user who runs the program, or as root");
    if (!S_ISREG(facts.st_mode)) return reader.fault("is no file");
    std::string line;
    std::array<char, 65'536> block{};
    const auto add = [&](std::string_view part) {
        // What is longer is no record anyway, and its beginning says so.
        const auto room = kLineMax + 1 - std::min(line.size(), kLineMax + 1);
        line.append(part.substr(0, room));
    };
    while (true) {
        const auto n = ::read(fd.get(), block.data(), block.size());
        if (n < 0 && errno == EINTR) continue;
        if (n < 0)
            throw std::runtime_error("'" + path.string() +
                                     "' cannot be read: " + std::generic_category().message(errno));
        if (n == 0) break;
        std::string_view rest(block.data(), static_cast<std::size_t>(n));
        for (auto at = rest.find('\n'); at != std::string_view::npos; at = rest.find('\n')) {
            add(rest.substr(0, at));
            reader.line(line);
            line.clear();
            rest.remove_prefix(at + 1);
        }
        add(rest);
    }
    if (!line.empty()) reader.line(line, false);
}

}  // namespace

std::vector<Chain> readTrails(const fs::path& folder, const std::string& kept,
                              const std::function<void(const std::string& trail, const Record&)>& each) {
    std::vector<Chain> chains;
    for (const auto& [name, files] : trailFiles(folder)) {
        ChainReader reader(
            [&each, trail = name](const Record& record) {
                if (each) each(trail, record);
            },
            kept);
        std::uint64_t expected = files.begin()->first;
        for (const auto& [number, path] : files) {
            reader.file(path.string());
            if (number != expected)
                reader.fault("is there, but file " + std::to_string(expected) + " before it is missing");
            expected = number + 1;
            readFile(path, reader);
        }
        chains.push_back(reader.end());
        chains.back().name = name;
    }
    return chains;
}

}  // namespace axon::audit
