// SPDX-License-Identifier: MIT
#include "host/settings_file.hpp"

#include <algorithm>
#include <fstream>
#include <optional>
#include <utility>

namespace axon {
namespace {

constexpr std::size_t kFileMax = 1024 * 1024;  // more is another file
constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";

/// Key or value while it is read: without the blanks at its ends, but for escaped ones in a value.
class Word {
  public:
    void add(char c) {
        text_ += text_.empty() ? escaped_ : blanks_;
        blanks_.clear();
        escaped_.clear();
        text_ += c;
    }
    void addBlank(char c) { blanks_ += c; }
    void addEscapedBlank() {
        blanks_ += ' ';
        escaped_ += ' ';
    }
    std::string take() { return std::move(text_) + escaped_; }

  private:
    std::string text_;
    std::string blanks_;   // since its last other character
    std::string escaped_;  // those of them that were escaped
};

std::string firstWord(std::string_view line) {
    line.remove_prefix(std::min(line.find_first_not_of(" \t"), line.size()));
    // What follows another character may be a password.
    constexpr auto kOfKeys = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-";
    return std::string(line.substr(0, std::min<std::size_t>(line.find_first_not_of(kOfKeys), 80)));
}

/// None for a line without a setting, which is blank or a comment. Without a key when it is malformed.
std::optional<Setting> settingOn(std::string_view line) {
    Word key;
    Word value;
    bool equals = false;
    for (std::size_t i = 0; i < line.size() && line[i] != '#'; ++i) {
        auto& word = equals ? value : key;
        const char c = line[i];
        if (c == '\\' && i + 1 < line.size()) {
            const char next = line[++i];
            if (next == ' ') {
                equals ? word.addEscapedBlank() : word.addBlank(next);
                continue;
            }
            if (next != '\\' && next != '#' && next != '=') word.add(c);
            word.add(next);
        } else if (c == ' ' || c == '\t') {
            word.addBlank(c);
        } else if (c == '=' && !equals) {
            equals = true;
        } else {
            word.add(c);
        }
    }
    Setting setting{key.take(), value.take(), {}};
    if (!equals && setting.key.empty()) return std::nullopt;
    if (!equals) setting.key.clear();
    return setting;
}

}  // namespace

Result<std::vector<Setting>> parseSettings(std::string_view text, std::string_view file) {
    std::vector<Setting> settings;
    if (text.starts_with(kByteOrderMark)) text.remove_prefix(kByteOrderMark.size());
    for (int number = 1; !text.empty(); ++number) {
        const auto line = text.substr(0, text.find('\n'));
        text.remove_prefix(std::min(line.size() + 1, text.size()));
        auto setting = settingOn(line.substr(0, line.size() - (line.ends_with('\r') ? 1 : 0)));
        if (!setting) continue;
        setting->where = std::string(file) + ":" + std::to_string(number);
        if (setting->key.empty())
            return Refusal{RefusalCode::Malformed,
                           setting->where + ": '" + firstWord(line) +
                               "': expected a line KEY = VALUE; fix: add the key or the '=', or begin a "
                               "comment with '#'",
                           {}};
        settings.push_back(std::move(*setting));
    }
    return settings;
}

Result<std::vector<Setting>> readSettings(const std::filesystem::path& file) {
    std::ifstream in(file, std::ios::binary);
    std::string text;
    if (in) {
        text.resize(kFileMax + 1);
        in.read(text.data(), static_cast<std::streamsize>(text.size()));
        text.resize(static_cast<std::size_t>(in.gcount()));
    }
    if ((!in && !in.eof()) || text.size() > kFileMax)
        return Refusal{RefusalCode::BadName,
                       file.string() +
                           ": cannot be read; expected a file of at most 1 MiB with lines KEY = VALUE; fix: "
                           "create it, let this user read it, or correct the path",
                       {}};
    return parseSettings(text, file.string());
}

}  // namespace axon
