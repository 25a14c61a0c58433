// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "certificates/certificate.hpp"

namespace axon::certificates {

/// Which certificates of a CA are no longer valid, and until when that is known: IceSSL refuses everybody
/// once a list has ended.
struct RevocationList {
    std::map<std::string, WallTime> serials;  ///< as Certificate::serial, and since when
    std::uint64_t number = 0;                 ///< greater than those of all earlier lists
    WallTime from{};
    WallTime until{};
};

/// `authority` is the CA's certificate. Both texts are PEM; `file` is what messages call the list. Throws
/// Unusable for a text that is no list, and for the list of another CA.
RevocationList readRevocationList(std::string_view pem, std::string_view authority, const std::string& file);

/// Throws Unusable where the certificate, PEM, is not one that this CA, PEM, has signed.
void checkSignedBy(std::string_view certificate, std::string_view authority, const std::string& file);

/// A list, PEM, of these serial numbers and no others, with this number. It is valid for `valid`, and at most
/// as long as the CA; without `valid` as long as that. Throws Unusable as issue() does.
std::string makeRevocationList(const Issued& authority, const std::map<std::string, WallTime>& serials,
                               std::uint64_t number, std::optional<std::chrono::days> valid, WallTime now);

/// As of a certificate: NotYetValid, where the clock is wrong, Expired, ExpiresSoon or Valid.
Validity validity(const RevocationList& list, WallTime now);

}  // namespace axon::certificates
