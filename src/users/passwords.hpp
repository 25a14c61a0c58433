// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <string>

// Hashes of passwords, as lines of users.cfg have them. Pure but for randomness; any thread.
namespace axon::users {

inline constexpr std::size_t kPasswordMax = 511;  // CRYPT_MAX_PASSPHRASE_SIZE, without its zero

/// What one new hash costs whoever verifies it: OWASP's parameters for Argon2id (2 passes over 19 MiB, one
/// lane), about as long as yescrypt's (docs/adr/0043-users-at-run-time.md has the measurements).
inline constexpr unsigned long long kPasses = 2;
inline constexpr std::size_t kMemoryBytes = std::size_t{19} * 1024 * 1024;

/// Which costs a hash of Argon2id may ask for. Below, it is weak; above, one log-in would take the memory or
/// the time of all.
struct Argon2Bounds {
    unsigned memory_kib_min = 7 * 1024, memory_kib_max = 256 * 1024;
    unsigned passes_min = 1, passes_max = 16;
    unsigned lanes_max = 16;
};

/// The same for crypt(5): the most rounds of SHA-512, a quarter of a second, and the most memory of yescrypt.
struct CryptBounds {
    unsigned rounds_max = 1'000'000;
    unsigned memory_kib_max = 256 * 1024;
};

/// Argon2id or one of crypt(5) that is not of an older kind, yescrypt or SHA-512, within its bounds.
bool isHash(const std::string& hash);
/// "argon2id", "yescrypt", "sha512" or "crypt", of what isHash().
const char* kindOf(const std::string& hash);

/// Whether this is the password. What no password can be (kPasswordMax) takes as long as a wrong one. Throws
/// std::bad_alloc where there is too little memory to find out.
bool matches(const std::string& hash, const std::string& password);

/// The Argon2id hash of a password under a new salt. Throws std::runtime_error for a password that is empty,
/// longer than kPasswordMax bytes or has a zero byte, and std::bad_alloc.
std::string hashPassword(const std::string& password);

}  // namespace axon::users
