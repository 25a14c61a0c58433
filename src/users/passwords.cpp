// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/passwords.hpp"

#include <crypt.h>
#include <sodium.h>
#include <string.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cstdint>
#include <memory>
#include <new>
#include <optional>
#include <stdexcept>
#include <string_view>

namespace axon::users {
namespace {

constexpr std::size_t kHashMax = 383;   // CRYPT_OUTPUT_SIZE, with its zero
constexpr std::size_t kDigestMin = 43;  // of SHA-256 and yescrypt; of MD5 22, of DES 11
constexpr std::string_view kArgon2 = "$argon2id$";

void readySodium() {
    if (sodium_init() < 0)
        throw std::runtime_error("libsodium cannot be used: the kernel gives no random bytes");
}

bool isPassword(const std::string& password) {
    return !password.empty() && password.size() <= kPasswordMax && password.find('\0') == std::string::npos;
}

/// The number after `name`, which is taken off the text with it; nothing where that is not there.
std::optional<unsigned> take(std::string_view& text, std::string_view name) {
    if (!text.starts_with(name)) return std::nullopt;
    unsigned value = 0;
    const auto* begin = text.data() + name.size();
    const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
    if (error != std::errc{}) return std::nullopt;
    text.remove_prefix(static_cast<std::size_t>(end - text.data()));
    return value;
}

bool isArgon2(const std::string& hash) {
    constexpr Argon2Bounds kBounds;
    if (hash.size() >= crypto_pwhash_STRBYTES) return false;
    auto rest = std::string_view(hash).substr(kArgon2.size());
    const auto version = take(rest, "v=");
    const auto memory = take(rest, "$m=");
    const auto passes = take(rest, ",t=");
    const auto lanes = take(rest, ",p=");
    if (version != 19U || !memory || !passes || !lanes) return false;
    if (*memory < kBounds.memory_kib_min || *memory > kBounds.memory_kib_max ||
        *passes < kBounds.passes_min || *passes > kBounds.passes_max || *lanes < 1 ||
        *lanes > kBounds.lanes_max)
        return false;
    // Whether the library can read it all: it is then compared and not refused at each log-in.
    readySodium();
    return hash.size() - hash.rfind('$') > kDigestMin - 1 &&
           crypto_pwhash_str_needs_rehash(hash.c_str(), kPasses, kMemoryBytes) >= 0;
}

/// What a hash of crypt(5) costs is in it, and the library carries out any of it.
bool isCheap(std::string_view hash) {
    constexpr CryptBounds kBounds;
    if (hash.starts_with("$6$")) {
        hash.remove_prefix(3);
        const auto rounds = take(hash, "rounds=");
        return rounds ? *rounds <= kBounds.rounds_max : !hash.starts_with("rounds=");
    }
    // "$y$j", then log2 of N and r, one digit each: more of either, or other parameters, cost more.
    if (!hash.starts_with("$y$j") || hash.size() < 7 || hash[6] != '$') return false;
    constexpr std::string_view kDigits = "./0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz";
    const auto n = kDigits.find(hash[4]) + 1;
    const auto r = kDigits.find(hash[5]) + 1;
    return n >= 1 && n <= 24 && r >= 1 &&
           (std::uint64_t{128} * r << n) <= std::uint64_t{kBounds.memory_kib_max} * 1024;
}

bool isCrypt(const std::string& hash) {
    const auto plain = [](unsigned char c) {
        return std::isalnum(c) != 0 || c == '.' || c == '/' || c == '$' || c == '=' || c == ',' || c == '-';
    };
    if (hash.size() > kHashMax || !std::all_of(hash.begin(), hash.end(), plain)) return false;
    return hash.size() - hash.rfind('$') > kDigestMin && isCheap(hash) &&
           crypt_checksalt(hash.c_str()) == CRYPT_SALT_OK;
}

/// In a time that does not depend on where they differ.
bool same(std::string_view one, std::string_view other) {
    return one.size() == other.size() && sodium_memcmp(one.data(), other.data(), one.size()) == 0;
}

bool matchesCrypt(const std::string& hash, const std::string& password) {
    const auto work = std::make_unique<crypt_data>();
    errno = 0;
    const char* made = crypt_r(password.c_str(), hash.c_str(), work.get());
    if (made == nullptr && errno == ENOMEM) throw std::bad_alloc();
    const bool equal = made != nullptr && same(made, hash);
    explicit_bzero(work.get(), sizeof(crypt_data));
    return equal;
}

bool matchesArgon2(const std::string& hash, const std::string& password) {
    readySodium();
    errno = 0;
    if (crypto_pwhash_str_verify(hash.c_str(), password.data(), password.size()) == 0) return true;
    // A wrong password is EINVAL; the hash has been read before, so what else fails is the memory.
    if (errno != EINVAL) throw std::bad_alloc();
    return false;
}

}  // namespace

bool isHash(const std::string& hash) {
    if (hash.empty() || hash.front() != '$') return false;
    return hash.starts_with(kArgon2) ? isArgon2(hash) : isCrypt(hash);
}

const char* kindOf(const std::string& hash) {
    return hash.starts_with(kArgon2) ? "argon2id"
           : hash.starts_with("$y$") ? "yescrypt"
           : hash.starts_with("$6$") ? "sha512"
                                     : "crypt";
}

bool matches(const std::string& hash, const std::string& password) {
    // What no password can be is compared all the same: a refusal in less time would tell something.
    const bool usable = isPassword(password);
    const std::string other;
    const auto& its = usable ? password : other;
    const bool equal = hash.starts_with(kArgon2) ? matchesArgon2(hash, its) : matchesCrypt(hash, its);
    return usable && equal;
}

std::string hashPassword(const std::string& password) {
    if (!isPassword(password))
        throw std::runtime_error("expected a password of 1 to " + std::to_string(kPasswordMax) +
                                 " bytes without a zero byte");
    readySodium();
    std::array<char, crypto_pwhash_STRBYTES> hash{};
    if (crypto_pwhash_str(hash.data(), password.data(), password.size(), kPasses, kMemoryBytes) != 0)
        throw std::bad_alloc();
    return hash.data();
}

}  // namespace axon::users
