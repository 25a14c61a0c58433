// SPDX-License-Identifier: GPL-2.0-or-later
#include "certificates/revocation.hpp"

#include <algorithm>
#include <array>
#include <ctime>
#include <memory>

#include "certificates/x509.hpp"

namespace axon::certificates {
namespace {

struct ListFree {
    void operator()(gnutls_x509_crl_t it) const { gnutls_x509_crl_deinit(it); }
};
using ListPtr = std::unique_ptr<gnutls_x509_crl_int, ListFree>;

/// Servers whose clocks are behind use it, too.
constexpr std::chrono::hours kBackdated{1};
constexpr std::size_t kKeyIdSize = 20;
using Number = std::array<unsigned char, 8>;  // the most significant byte first

ListPtr newList() {
    gnutls_x509_crl_t it = nullptr;
    require(gnutls_x509_crl_init(&it), "a new revocation list");
    return ListPtr(it);
}

std::string bytesOf(std::string_view hex) {
    std::string bytes;
    for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
        bytes += static_cast<char>(std::stoi(std::string(hex.substr(i, 2)), nullptr, 16));
    return bytes;
}

}  // namespace

RevocationList readRevocationList(std::string_view pem, std::string_view authority, const std::string& file) {
    const auto list = newList();
    const auto text = datum(pem);
    if (gnutls_x509_crl_import(list.get(), &text, GNUTLS_X509_FMT_PEM) < 0)
        throw Unusable(file + ": expected a revocation list in PEM form (-----BEGIN X509 CRL-----)",
                       "restore it from a server that uses it; without it, certificates that were revoked "
                       "would be valid again");
    const auto its_authority = parsed(authority, "the CA's certificate");
    auto* const issuer = its_authority.front().get();
    // All CAs of ours have the same name, so the key says whose list it is. The time is for the caller.
    KeyId signer{};
    auto size = signer.size();
    const auto id = idOf(issuer);
    const bool ours = gnutls_x509_crl_get_authority_key_id(list.get(), signer.data(), &size, nullptr) >= 0 &&
                      size == kKeyIdSize &&
                      std::equal(signer.begin(), signer.begin() + kKeyIdSize, id.begin());
    constexpr unsigned int kOfTime = GNUTLS_CERT_REVOCATION_DATA_SUPERSEDED |
                                     GNUTLS_CERT_REVOCATION_DATA_ISSUED_IN_FUTURE | GNUTLS_CERT_EXPIRED |
                                     GNUTLS_CERT_NOT_ACTIVATED;
    unsigned int verdict = 0;
    const bool verified =
        gnutls_x509_crl_verify(list.get(), &issuer, 1, GNUTLS_VERIFY_DISABLE_TIME_CHECKS, &verdict) >= 0;
    const bool only_time = (verdict & kOfTime) != 0 && (verdict & ~(kOfTime | GNUTLS_CERT_INVALID)) == 0;
    if (!ours || !verified || (verdict != 0 && !only_time))
        throw Unusable(file + " is not a list of this CA", "name the folder of its CA: --folder DIR");
    RevocationList its;
    its.from = WallTime(std::chrono::seconds(gnutls_x509_crl_get_this_update(list.get())));
    its.until = WallTime(std::chrono::seconds(gnutls_x509_crl_get_next_update(list.get())));
    const int count = std::max(0, gnutls_x509_crl_get_crt_count(list.get()));
    for (int i = 0; i < count; ++i) {
        std::array<unsigned char, 64> serial{};
        auto length = serial.size();
        std::time_t since = 0;
        require(gnutls_x509_crl_get_crt_serial(list.get(), static_cast<unsigned int>(i), serial.data(),
                                               &length, &since),
                "reading a revocation list");
        its.serials.emplace(hexOf(std::string_view(reinterpret_cast<const char*>(serial.data()), length)),
                            WallTime(std::chrono::seconds(since)));
    }
    Number number{};
    auto length = number.size();
    require(gnutls_x509_crl_get_number(list.get(), number.data(), &length, nullptr), "the number of a list");
    for (std::size_t i = 0; i < length; ++i) its.number = its.number << 8U | number.at(i);
    return its;
}

void checkSignedBy(std::string_view certificate, std::string_view authority, const std::string& file) {
    const auto its = parsed(certificate, file);
    const auto its_authority = parsed(authority, "the CA's certificate");
    auto* const issuer = its_authority.front().get();
    unsigned int verdict = 0;
    if (gnutls_x509_crt_verify(its.front().get(), &issuer, 1, GNUTLS_VERIFY_DISABLE_TIME_CHECKS, &verdict) <
            0 ||
        verdict != 0)
        throw Unusable(file + " is not a certificate of this CA", "name the folder of its CA: --folder DIR");
}

std::string makeRevocationList(const Issued& authority, const std::map<std::string, WallTime>& serials,
                               std::uint64_t number, std::optional<std::chrono::days> valid, WallTime now) {
    const auto signer = signerOf(authority, now);
    const auto ends = contentOf(signer.certificate.get()).until;
    const auto until = valid ? std::min<WallTime>(now + *valid, ends) : ends;
    const auto list = newList();
    require(gnutls_x509_crl_set_version(list.get(), 2), "a list of version 2");
    require(gnutls_x509_crl_set_this_update(list.get(), (now - kBackdated).time_since_epoch().count()),
            "validity");
    require(gnutls_x509_crl_set_next_update(list.get(), until.time_since_epoch().count()), "validity");
    for (const auto& [serial, since] : serials) {
        const auto bytes = bytesOf(serial);
        require(gnutls_x509_crl_set_crt_serial(list.get(), bytes.data(), bytes.size(),
                                               since.time_since_epoch().count()),
                "revoking a certificate");
    }
    Number bytes{};
    for (auto at = bytes.rbegin(); at != bytes.rend(); ++at, number >>= 8U)
        *at = static_cast<unsigned char>(number & 0xFFU);
    require(gnutls_x509_crl_set_number(list.get(), bytes.data(), bytes.size()), "the number of a list");
    const auto id = idOf(signer.certificate.get());
    require(gnutls_x509_crl_set_authority_key_id(list.get(), id.data(), kKeyIdSize), "the issuer's key id");
    require(
        gnutls_x509_crl_sign2(list.get(), signer.certificate.get(), signer.key.get(), GNUTLS_DIG_SHA256, 0),
        "signing a revocation list");
    gnutls_datum_t out{};
    require(gnutls_x509_crl_export2(list.get(), GNUTLS_X509_FMT_PEM, &out), "writing a revocation list");
    return taken(out);
}

Validity validity(const RevocationList& list, WallTime now) {
    Certificate like;
    like.from = list.from;
    like.until = list.until;
    return validity(like, now);
}

}  // namespace axon::certificates
