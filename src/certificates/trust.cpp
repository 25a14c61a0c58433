// SPDX-License-Identifier: GPL-2.0-or-later
#include "certificates/trust.hpp"

#include <algorithm>
#include <utility>

#include "certificates/x509.hpp"
#include "common/utf8.hpp"

namespace axon::certificates {
namespace {

constexpr std::size_t kChainMax = 8;

struct ListFree {
    // The certificates in it belong to others.
    void operator()(gnutls_x509_trust_list_t it) const { gnutls_x509_trust_list_deinit(it, 0); }
};

std::string shown(const std::string& text) {
    std::string its(validUtf8(std::string_view(text).substr(0, 128)));
    for (auto& c : its)
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = '?';
    return "'" + its + "'";
}

std::vector<gnutls_x509_crt_t> handles(const std::vector<CertificatePtr>& all) {
    std::vector<gnutls_x509_crt_t> list;
    for (const auto& one : all) list.push_back(one.get());
    return list;
}

}  // namespace

struct Trust::Authorities {
    std::vector<CertificatePtr> certificates;
    std::unique_ptr<gnutls_x509_trust_list_st, ListFree> list;

    Verdict judge(const std::vector<CertificatePtr>& chain, WallTime now) const {
        auto its = handles(chain);
        unsigned int status = 0;
        // Time is judged below, by the caller's clock.
        const int code = gnutls_x509_trust_list_verify_crt2(
            list.get(), its.data(), static_cast<unsigned int>(its.size()), nullptr, 0,
            GNUTLS_VERIFY_DISABLE_TIME_CHECKS | GNUTLS_VERIFY_DISABLE_TRUSTED_TIME_CHECKS, &status, nullptr);
        if (code < 0) return std::string("cannot be verified: ") + gnutls_strerror(code);
        if ((status & (GNUTLS_CERT_SIGNER_NOT_FOUND | GNUTLS_CERT_SIGNATURE_FAILURE)) != 0)
            return "is of another CA";
        if (status != 0) return "is not one of this laboratory's CA";
        // Of several authorities, only the one that signed counts.
        gnutls_x509_crt_t issuer = nullptr;
        if (gnutls_x509_trust_list_get_issuer(list.get(), its.back(), &issuer, 0) < 0)
            return "is of another CA";
        its.push_back(issuer);
        for (auto* const one : its) {
            const auto content = contentOf(one);
            const auto its_validity = validity(content, now);
            if (its_validity == Validity::Expired)
                return "expired on " + day(content.until) + " (axon certs issue … --force makes a new one)";
            if (its_validity == Validity::NotYetValid)
                return "is valid from " + day(content.from) + " on (compare the clocks of the two machines)";
        }
        return contentOf(chain.front().get());
    }
};

Trust::Trust(std::string_view authorities) {
    auto its = std::make_unique<Authorities>();
    its->certificates = parsed(authorities, "the CA's certificate");
    gnutls_x509_trust_list_t list = nullptr;
    if (gnutls_x509_trust_list_init(&list, 0) < 0) throw std::bad_alloc();
    its->list.reset(list);
    const auto all = handles(its->certificates);
    gnutls_x509_trust_list_add_cas(list, all.data(), static_cast<unsigned int>(all.size()), 0);
    authorities_ = std::move(its);
}

Trust::~Trust() = default;
Trust::Trust(Trust&&) noexcept = default;

Trust::Verdict Trust::judgePem(std::string_view chain, WallTime now) const {
    try {
        const auto its = parsed(chain, "the peer's certificate");
        if (its.size() > kChainMax) return "comes with too many others";
        return authorities_->judge(its, now);
    } catch (const Unusable&) {
        return "cannot be read";
    }
}

Trust::Verdict Trust::judgeDer(const std::vector<std::string_view>& chain, WallTime now) const {
    if (chain.empty()) return "was not shown";
    if (chain.size() > kChainMax) return "comes with too many others";
    std::vector<CertificatePtr> its;
    for (const auto& one : chain) {
        gnutls_x509_crt_t made = nullptr;
        if (gnutls_x509_crt_init(&made) < 0) throw std::bad_alloc();
        its.emplace_back(made);
        const auto bytes = datum(one);
        if (gnutls_x509_crt_import(made, &bytes, GNUTLS_X509_FMT_DER) < 0) return "cannot be read";
    }
    return authorities_->judge(its, now);
}

std::string mismatch(const Certificate& its, Kind kind, std::string_view name) {
    if (its.unit == toString(kind) && its.name == name) return {};
    return "is that of the " + (its.unit.empty() ? "unknown kind" : shown(its.unit)) + " " + shown(its.name) +
           "; expected that of the " + toString(kind) + " " + shown(std::string(name));
}

}  // namespace axon::certificates
