// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users.hpp"

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "common/descriptor.hpp"
#include "users/file_text.hpp"

namespace axon::users {
namespace {

// Of no password: an unknown user's is compared with it where the file has nobody.
constexpr const char* kNobody =
    "$argon2id$v=19$m=19456,t=2,p=1$UtOU5N71jSD9CHU9IzIrrg$WhjeN9remt0azQgOxTUnqxXwsieEI1BJEpijWgf6IbI";
constexpr const char* kHowTo =
    "write the line with axon users add NAME ROLE --file FILE, or with axon-server --users FILE --add-user "
    "NAME "
    "--user-role ROLE";

}  // namespace

const char* toString(UserRole role) {
    switch (role) {
        case UserRole::Observer:
            return "observer";
        case UserRole::Operator:
            return "operator";
        case UserRole::Admin:
            return "admin";
        case UserRole::Entity:
            return "entity";
    }
    return "?";
}

std::optional<UserRole> userRole(std::string_view text) {
    for (const auto role : {UserRole::Observer, UserRole::Operator, UserRole::Admin, UserRole::Entity})
        if (text == toString(role)) return role;
    return std::nullopt;
}

std::string shown(std::string_view text) {
    std::string out;
    for (const unsigned char c : text.substr(0, 64))
        out += c >= 0x20 && c < 0x7f ? static_cast<char>(c) : '?';
    return "'" + out + "'";
}

Users Users::parse(std::string_view text, const std::string& file) {
    Users users;
    int number = 0;
    while (!text.empty()) {
        ++number;
        const auto line = contentOf(takeLine(text));
        const auto refuse = [&](const std::string& expected) {
            throw std::runtime_error(file + ":" + std::to_string(number) + ": " + expected +
                                     "; fix: " + kHowTo);
        };
        const auto fields = fieldsOf(line);
        if (fields.empty()) continue;
        if (fields[0].starts_with('@')) {
            if (const auto expected = users.access_.add(fields); !expected.empty())
                throw std::runtime_error(file + ":" + std::to_string(number) + ": " + expected +
                                         "; fix: correct the line (docs/reference/server_configuration.md)");
            continue;
        }
        if (fields.size() != 3)
            refuse("expected 'name role hash', not " + std::to_string(fields.size()) + " words");
        if (!isUserName(fields[0]))
            refuse("expected a name of at most 64 letters, digits, '.', '-' and '_', not " +
                   shown(fields[0]));
        const auto role = userRole(fields[1]);
        if (!role) refuse("expected the role observer, operator, admin or entity, not " + shown(fields[1]));
        std::string hash(fields[2]);
        // What it is, is not shown: perhaps somebody wrote the password itself.
        if (!isHash(hash))
            refuse(
                "expected a hash that begins with $argon2id$, $y$ or $6$, not one of an older kind or with "
                "other costs than the server accepts");
        if (users.find(fields[0]) != nullptr)
            refuse("expected one line per user, but " + shown(fields[0]) + " has one already");
        users.by_name_.emplace(fields[0], users.users_.size());
        users.users_.push_back({std::string(fields[0]), *role, std::move(hash)});
    }
    return users;
}

Users Users::read(const std::string& file, MayBeEmpty may_be_empty) {
    const Descriptor fd(::open(file.c_str(), O_RDONLY | O_CLOEXEC));
    if (fd.get() < 0 && errno == ENOENT)
        throw std::runtime_error(file + ": No such file; fix: " + std::string(kHowTo));
    if (fd.get() < 0) fail(file, "expected a readable file of users");
    struct stat facts {};
    if (::fstat(fd.get(), &facts) != 0) fail(file, "cannot be read");
    if (!S_ISREG(facts.st_mode)) throw std::runtime_error(file + ": expected a regular file");
    if ((facts.st_mode & 07777U & ~0640U) != 0) {
        std::array<char, 8> mode{};
        std::snprintf(mode.data(), mode.size(), "%04o", static_cast<unsigned>(facts.st_mode & 07777U));
        throw std::runtime_error(
            file + ": its permissions are " + mode.data() +
            "; expected 0640 or narrower, because it holds password hashes; fix: chmod 640 " + file);
    }
    auto users = parse(readAll(fd.get(), file), file);
    if (users.size() == 0 && may_be_empty == MayBeEmpty::No)
        throw std::runtime_error(file + ": expected at least one user; fix: " + std::string(kHowTo));
    return users;
}

const Users::User* Users::find(std::string_view name) const {
    const auto found = by_name_.find(name);
    return found == by_name_.end() ? nullptr : &users_[found->second];
}

bool Users::keeps(const std::string& name, const Users& before) const {
    const auto* then = before.find(name);
    const auto* now = find(name);
    return then != nullptr && now != nullptr && then->hash == now->hash;
}

std::optional<UserRole> Users::verify(const std::string& name, const std::string& password) const {
    const auto* user = find(name);
    const std::string nobody = kNobody;
    const auto& hash = user != nullptr ? user->hash : users_.empty() ? nobody : users_.front().hash;
    const bool right = matches(hash, password);
    if (user == nullptr || !right) return std::nullopt;
    return user->role;
}

std::optional<UserRole> Users::roleOf(const std::string& name) const {
    const auto* user = find(name);
    return user == nullptr ? std::nullopt : std::optional(user->role);
}

std::string Users::fingerprint() const {
    crypto_generichash_state state;
    crypto_generichash_init(&state, nullptr, 0, crypto_generichash_BYTES);
    const auto add = [&](const std::string& text) {
        crypto_generichash_update(&state, reinterpret_cast<const unsigned char*>(text.c_str()),
                                  text.size() + 1);
    };
    auto sorted = users_;
    std::sort(sorted.begin(), sorted.end(), [](const User& a, const User& b) { return a.name < b.name; });
    for (const auto& user : sorted) {
        add(user.name);
        add(toString(user.role));
        add(user.hash);
    }
    for (const auto& rule : access_.rules()) {
        add("@");
        add(toString(rule.right));
        add(rule.entity);
        for (const auto& who : rule.who) add(who);
    }
    std::array<unsigned char, crypto_generichash_BYTES> digest{};
    crypto_generichash_final(&state, digest.data(), digest.size());
    std::array<char, 9> text{};
    sodium_bin2hex(text.data(), text.size(), digest.data(), 4);
    return text.data();
}

}  // namespace axon::users
