// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "audit/reader.hpp"

// For tests of what records and of who reads it.
namespace axon::audit {

/// A folder of its own, deleted at the end.
struct TrailFolder {
    TrailFolder() {
        std::string name = (std::filesystem::temp_directory_path() / "axon-audit-XXXXXX").string();
        path = ::mkdtemp(name.data());
    }
    ~TrailFolder() { std::filesystem::remove_all(path); }
    TrailFolder(const TrailFolder&) = delete;
    TrailFolder& operator=(const TrailFolder&) = delete;

    std::string text(const std::string& file) const {
        std::stringstream all;
        all << std::ifstream(path / file, std::ios::binary).rdbuf();
        return all.str();
    }
    void write(const std::string& file, const std::string& text) const {
        std::ofstream(path / file, std::ios::binary | std::ios::trunc) << text;
    }
    std::vector<Record> records() const {
        std::vector<Record> all;
        if (std::filesystem::exists(path))
            readTrails(path, {}, [&](const std::string&, const Record& record) { all.push_back(record); });
        return all;
    }
    /// Of the only trail.
    Chain chain(const std::string& kept = {}) const {
        auto chains = readTrails(path, kept);
        return chains.size() == 1 ? chains.front() : Chain{};
    }

    std::filesystem::path path;
};

}  // namespace axon::audit
