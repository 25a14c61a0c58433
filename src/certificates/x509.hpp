// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <gnutls/gnutls.h>
#include <gnutls/x509.h>

#include <array>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "certificates/certificate.hpp"

// What the sources that call GnuTLS have in common; of this folder and of the data lane over TLS only.
namespace axon::certificates {

struct CertificateFree {
    void operator()(gnutls_x509_crt_t it) const { gnutls_x509_crt_deinit(it); }
};
using CertificatePtr = std::unique_ptr<gnutls_x509_crt_int, CertificateFree>;

struct KeyFree {
    void operator()(gnutls_x509_privkey_t it) const { gnutls_x509_privkey_deinit(it); }
};
using KeyPtr = std::unique_ptr<gnutls_x509_privkey_int, KeyFree>;

using KeyId = std::array<unsigned char, 32>;
KeyId idOf(gnutls_x509_crt_t certificate);

/// Of a call that only a bug or a broken machine can fail: throws std::runtime_error with what GnuTLS says.
void require(int code, const char* what);

/// Takes what GnuTLS has allocated. A key does not stay behind in freed memory.
std::string taken(gnutls_datum_t& from);

/// Two small digits for each byte.
std::string hexOf(std::string_view bytes);

/// A CA that can sign.
struct Signer {
    CertificatePtr certificate;
    KeyPtr key;
};
/// Throws Unusable for an authority that has expired, has another's key, or is none.
Signer signerOf(const Issued& authority, WallTime now);

/// Refers to the text.
gnutls_datum_t datum(std::string_view text);

Certificate contentOf(gnutls_x509_crt_t certificate);

/// All certificates of a PEM text, at least one. Throws Unusable.
std::vector<CertificatePtr> parsed(std::string_view pem, const std::string& file);

}  // namespace axon::certificates
