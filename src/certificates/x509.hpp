// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <gnutls/gnutls.h>
#include <gnutls/x509.h>

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

/// Refers to the text.
gnutls_datum_t datum(std::string_view text);

Certificate contentOf(gnutls_x509_crt_t certificate);

/// All certificates of a PEM text, at least one. Throws Unusable.
std::vector<CertificatePtr> parsed(std::string_view pem, const std::string& file);

}  // namespace axon::certificates
