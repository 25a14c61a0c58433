// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/line.hpp"

#include <sodium.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <ctime>
#include <nlohmann/json.hpp>
#include <utility>

namespace axon::audit {

using Json = nlohmann::ordered_json;

namespace {

struct Member {
    const char* key;
    std::string Record::*text;
};
constexpr std::array<Member, 7> kTexts{{{"user", &Record::user},
                                        {"name", &Record::name},
                                        {"client", &Record::client},
                                        {"peer", &Record::peer},
                                        {"entity", &Record::entity},
                                        {"what", &Record::what},
                                        {"outcome", &Record::outcome}}};

bool isHash(std::string_view text) {
    return text.size() == kNoHash.size() && std::all_of(text.begin(), text.end(), [](char c) {
               return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f');
           });
}

}  // namespace

std::string hashOf(std::string_view line) {
    std::array<unsigned char, crypto_hash_sha256_BYTES> hash{};
    crypto_hash_sha256(hash.data(), reinterpret_cast<const unsigned char*>(line.data()), line.size());
    std::string text(2 * hash.size() + 1, '\0');
    sodium_bin2hex(text.data(), text.size(), hash.data(), hash.size());
    text.pop_back();
    return text;
}

std::string lineOf(const Record& record) {
    Json line;
    line["n"] = record.number;
    line["at"] = record.at;
    line["kind"] = record.kind;
    for (const auto& [key, text] : kTexts)
        if (!(record.*text).empty()) line[key] = record.*text;
    line["before"] = record.before;
    return line.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::optional<Record> readLine(std::string_view line) {
    if (line.size() > kLineMax) return std::nullopt;
    const auto json = Json::parse(line, nullptr, false);
    if (!json.is_object()) return std::nullopt;
    const auto number = json.find("n");
    if (number == json.end() || !number->is_number_unsigned()) return std::nullopt;
    Record record;
    record.number = number->get<std::uint64_t>();
    const auto word = [&json](const char* key, std::string& to) {
        const auto found = json.find(key);
        if (found == json.end()) return true;
        if (!found->is_string()) return false;
        to = found->get<std::string>();
        return true;
    };
    bool texts = word("at", record.at) && word("kind", record.kind) && word("before", record.before);
    for (const auto& [key, text] : kTexts) texts = texts && word(key, record.*text);
    if (!texts || record.number == 0 || record.number > kNumberMax || record.at.empty() ||
        record.kind.empty() || !isHash(record.before))
        return std::nullopt;
    return record;
}

std::string utcTime(std::int64_t us) {
    const auto seconds = static_cast<std::time_t>(us / 1'000'000);
    std::tm utc{};
    ::gmtime_r(&seconds, &utc);
    std::array<char, 40> text{};
    const auto length = std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%S", &utc);
    std::array<char, 12> fraction{};
    std::snprintf(fraction.data(), fraction.size(), ".%06dZ", static_cast<int>(us % 1'000'000));
    return std::string(text.data(), length) + fraction.data();
}

}  // namespace axon::audit
