// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <string>
#include <string_view>

namespace axon::transport {

// A UUID that only who knows a secret can register: of version 8 (RFC 9562), and its other 122 bits are the
// first ones of SHA-256("axon entity" + secret). A server needs no record of who registered it first, and
// several servers agree. An entity shows its server the secret; the server passes it on to nobody. Threads:
// any; all values.

inline constexpr std::size_t kSecretBytes = 32;

/// In lower case.
std::string boundUuid(std::string_view secret);

/// Whether a UUID, in upper or lower case, is such a one.
bool isBoundUuid(std::string_view uuid);

/// Whether who shows this secret may register this UUID. One that is not bound may be registered by anybody.
bool mayRegister(std::string_view uuid, std::string_view secret);

}  // namespace axon::transport
