// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "certificates/certificate.hpp"

namespace axon::certificates {

/// Which certificates of a CA are no longer valid, and until when that is known: IceSSL refuses everybody
/// once a list has ended.
struct RevocationList {
    std::set<std::string> serials;  ///< as Certificate::serial
    WallTime from{};
    WallTime until{};
};

/// `authority` is the CA's certificate. Both texts are PEM; `file` is what messages call the list. Throws
/// Unusable for a text that is no list, and for the list of another CA.
RevocationList readRevocationList(std::string_view pem, std::string_view authority, const std::string& file);

/// Throws Unusable where the certificate, PEM, is not one that this CA, PEM, has signed.
void checkSignedBy(std::string_view certificate, std::string_view authority, const std::string& file);

/// A list, PEM, of these serial numbers and no others. It is valid for so long, and at most as long as the
/// CA; without `valid` as long as that. Throws Unusable as issue() does.
std::string makeRevocationList(const Issued& authority, const std::set<std::string>& serials,
                               std::optional<std::chrono::days> valid, WallTime now);

/// As of a certificate: NotYetValid, where the clock is wrong, Expired, ExpiresSoon or Valid.
Validity validity(const RevocationList& list, WallTime now);

}  // namespace axon::certificates
