// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/visitors.hpp"

#include <sodium.h>

#include <algorithm>

namespace axon::console {
namespace {

std::string newKey(RandomSource& random) {
    std::array<unsigned char, 16> bytes{};
    random.fill(bytes.data(), bytes.size());
    constexpr const char* kDigits = "0123456789abcdef";
    std::string key;
    for (const unsigned char byte : bytes) {
        key += kDigits[byte >> 4U];
        key += kDigits[byte & 15U];
    }
    return key;
}

}  // namespace

Visitors::Book::Digest Visitors::Book::digestOf(std::string_view key) {
    Digest digest{};
    crypto_generichash(digest.data(), digest.size(), reinterpret_cast<const unsigned char*>(key.data()),
                       key.size(), nullptr, 0);
    return digest;
}

void Visitors::Book::forget(const Digest& key) {
    const auto found = entries_.find(key);
    if (found == entries_.end()) return;
    const auto its = of_user_.find(found->second.user);
    std::erase(its->second, key);
    if (its->second.empty()) of_user_.erase(its);
    std::erase(order_, key);
    entries_.erase(found);
}

void Visitors::Book::expire(TimePoint now) {
    while (!order_.empty() && entries_.at(order_.front()).ends <= now) forget(Digest(order_.front()));
}

std::string Visitors::Book::add(const std::string& user, TimePoint now, RandomSource& random) {
    expire(now);
    if (const auto its = of_user_.find(user); its != of_user_.end() && its->second.size() >= most_of_one_)
        forget(Digest(its->second.front()));
    if (order_.size() >= most_) forget(Digest(order_.front()));
    auto key = newKey(random);
    const auto digest = digestOf(key);
    entries_[digest] = {user, now + life_};
    order_.push_back(digest);
    of_user_[user].push_back(digest);
    return key;
}

std::optional<std::string> Visitors::Book::find(std::string_view key, TimePoint now) {
    const auto found = entries_.find(digestOf(key));
    if (found == entries_.end() || found->second.ends <= now) return std::nullopt;
    return found->second.user;
}

void Visitors::Book::remove(std::string_view key) {
    forget(digestOf(key));
}

void Visitors::Book::removeAll(const std::string& user) {
    const auto its = of_user_.find(user);
    if (its == of_user_.end()) return;
    const auto keys = its->second;  // forget() changes and erases it
    for (const auto& key : keys) forget(key);
}

void Visitors::Book::addUsers(std::set<std::string>& to, TimePoint now) {
    expire(now);
    for (const auto& [user, keys] : of_user_) to.insert(user);
}

std::string Visitors::enter(const std::string& user) {
    const std::lock_guard lock(mutex_);
    return visits_.add(user, clock_.now(), random_);
}

std::optional<std::string> Visitors::userOf(std::string_view key) {
    const std::lock_guard lock(mutex_);
    return visits_.find(key, clock_.now());
}

void Visitors::leave(std::string_view key) {
    const std::lock_guard lock(mutex_);
    visits_.remove(key);
}

void Visitors::forget(const std::string& user) {
    const std::lock_guard lock(mutex_);
    visits_.removeAll(user);
    tickets_.removeAll(user);
}

std::vector<std::string> Visitors::users() {
    std::set<std::string> all;
    const std::lock_guard lock(mutex_);
    visits_.addUsers(all, clock_.now());
    tickets_.addUsers(all, clock_.now());
    return {all.begin(), all.end()};
}

std::string Visitors::ticket(const std::string& user) {
    const std::lock_guard lock(mutex_);
    return tickets_.add(user, clock_.now(), random_);
}

std::optional<std::string> Visitors::redeem(std::string_view ticket) {
    const std::lock_guard lock(mutex_);
    auto user = tickets_.find(ticket, clock_.now());
    tickets_.remove(ticket);
    return user;
}

}  // namespace axon::console
