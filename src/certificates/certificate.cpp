// SPDX-License-Identifier: GPL-2.0-or-later
#include "certificates/certificate.hpp"

#include <arpa/inet.h>
#include <gnutls/crypto.h>
#include <gnutls/gnutls.h>
#include <gnutls/x509.h>

#include <algorithm>
#include <array>
#include <ctime>
#include <memory>
#include <utility>

#include "certificates/x509.hpp"
#include "common/routed.hpp"
#include "common/utf8.hpp"

namespace axon::certificates {
namespace {

using std::chrono::days;
using std::chrono::hours;

constexpr days kAuthorityValid{3653};
constexpr days kLongest{3650};
/// The clocks of a laboratory's machines differ.
constexpr hours kBackdated{1};
constexpr std::size_t kNameMax = 64;  // X.520's bound of a common name
constexpr std::size_t kNamesMax = 64;
constexpr const char* kOrganisation = "Axon";
constexpr const char* kAuthorityName = "Axon laboratory CA";
constexpr std::size_t kSerialBytes = 16;

CertificatePtr newCertificate() {
    gnutls_x509_crt_t it = nullptr;
    require(gnutls_x509_crt_init(&it), "a new certificate");
    return CertificatePtr(it);
}

KeyPtr emptyKey() {
    gnutls_x509_privkey_t it = nullptr;
    require(gnutls_x509_privkey_init(&it), "a new key");
    return KeyPtr(it);
}

KeyPtr newKey() {
    auto key = emptyKey();
    require(gnutls_x509_privkey_generate2(key.get(), GNUTLS_PK_ECDSA,
                                          GNUTLS_CURVE_TO_BITS(GNUTLS_ECC_CURVE_SECP256R1), 0, nullptr, 0),
            "making a key");
    return key;
}

std::string pemOf(gnutls_x509_crt_t certificate) {
    gnutls_datum_t out{};
    require(gnutls_x509_crt_export2(certificate, GNUTLS_X509_FMT_PEM, &out), "writing a certificate");
    return taken(out);
}

std::string pemOf(gnutls_x509_privkey_t key) {
    gnutls_datum_t out{};
    require(gnutls_x509_privkey_export2_pkcs8(key, GNUTLS_X509_FMT_PEM, nullptr, GNUTLS_PKCS_PLAIN, &out),
            "writing a key");
    return taken(out);
}

/// `get`: GnuTLS' function for the id of the key that `it` is or has.
template <class It>
KeyId keyId(int (*get)(It, unsigned int, unsigned char*, std::size_t*), It it) {
    KeyId id{};
    auto size = id.size();
    require(get(it, GNUTLS_KEYID_USE_SHA256, id.data(), &size), "the id of a key");
    return id;
}

void setName(gnutls_x509_crt_t certificate, const char* oid, std::string_view text) {
    require(gnutls_x509_crt_set_dn_by_oid(certificate, oid, 0, text.data(),
                                          static_cast<unsigned int>(text.size())),
            "naming a certificate");
}

/// What every certificate of ours has.
CertificatePtr draft(gnutls_x509_privkey_t key, std::string_view name, WallTime from, WallTime until) {
    auto it = newCertificate();
    std::array<unsigned char, kSerialBytes> serial{};
    require(gnutls_rnd(GNUTLS_RND_NONCE, serial.data(), serial.size()), "a serial number");
    serial[0] = static_cast<unsigned char>((serial[0] & 0x7FU) | 0x40U);  // positive, and not shorter
    require(gnutls_x509_crt_set_version(it.get(), 3), "a certificate of version 3");
    require(gnutls_x509_crt_set_serial(it.get(), serial.data(), serial.size()), "a serial number");
    require(gnutls_x509_crt_set_activation_time(it.get(), from.time_since_epoch().count()), "validity");
    require(gnutls_x509_crt_set_expiration_time(it.get(), until.time_since_epoch().count()), "validity");
    setName(it.get(), GNUTLS_OID_X520_ORGANIZATION_NAME, kOrganisation);
    setName(it.get(), GNUTLS_OID_X520_COMMON_NAME, name);
    require(gnutls_x509_crt_set_key(it.get(), key), "the key of a certificate");
    const auto id = idOf(it.get());
    require(gnutls_x509_crt_set_subject_key_id(it.get(), id.data(), 20), "a certificate's key id");
    return it;
}

/// A signature of the authority's own key for its own certificate, too.
Issued sign(gnutls_x509_crt_t certificate, gnutls_x509_privkey_t key, gnutls_x509_crt_t issuer,
            gnutls_x509_privkey_t issuers_key) {
    const auto id = idOf(issuer);
    require(gnutls_x509_crt_set_authority_key_id(certificate, id.data(), 20), "the issuer's key id");
    require(gnutls_x509_crt_sign2(certificate, issuer, issuers_key, GNUTLS_DIG_SHA256, 0), "signing");
    return {pemOf(certificate), pemOf(key)};
}

bool isAddress(const std::string& name, std::string* bytes = nullptr) {
    std::array<char, sizeof(in6_addr)> address{};
    for (const auto& [family, size] : {std::pair{AF_INET, 4U}, std::pair{AF_INET6, 16U}}) {
        if (inet_pton(family, name.c_str(), address.data()) != 1) continue;
        if (bytes != nullptr) bytes->assign(address.data(), size);
        return true;
    }
    return false;
}

/// Labels of letters, digits and '-' with dots between them. All digits and dots would be an address.
bool isDnsName(const std::string& name) {
    if (name.empty() || name.size() > 253 || name.find_first_not_of("0123456789.") == std::string::npos)
        return false;
    std::size_t label = 0;
    char before = '.';
    for (const char c : name + ".") {
        const bool letter = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
        if (c == '.') {
            if (label == 0 || label > 63 || before == '-') return false;
            label = 0;
        } else if (letter || (c == '-' && label > 0)) {
            ++label;
        } else {
            return false;
        }
        before = c;
    }
    return true;
}

bool isUserName(const std::string& name) {
    return std::all_of(name.begin(), name.end(), [](unsigned char c) {
        return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' ||
               c == '-' || c == '_';
    });
}

std::string quoted(std::string_view name) {
    std::string text(validUtf8(name.substr(0, 2 * kNameMax)));
    for (auto& c : text)
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = '?';
    return "'" + text + "'";
}

std::string nameByOid(gnutls_x509_crt_t certificate, const char* oid, bool of_issuer = false) {
    std::array<char, 1024> text{};
    auto size = text.size();
    const auto get = of_issuer ? gnutls_x509_crt_get_issuer_dn_by_oid : gnutls_x509_crt_get_dn_by_oid;
    if (get(certificate, oid, 0, 0, text.data(), &size) < 0) return {};
    return validUtf8(std::string_view(text.data(), size));
}

std::vector<std::string> alternativeNames(gnutls_x509_crt_t certificate) {
    std::vector<std::string> names;
    for (unsigned int i = 0; names.size() < kNamesMax; ++i) {
        std::array<char, 1024> bytes{};
        auto size = bytes.size();
        const int type = gnutls_x509_crt_get_subject_alt_name(certificate, i, bytes.data(), &size, nullptr);
        if (type == GNUTLS_E_REQUESTED_DATA_NOT_AVAILABLE) break;
        if (type == GNUTLS_E_SHORT_MEMORY_BUFFER) continue;
        if (type < 0) break;
        std::array<char, INET6_ADDRSTRLEN> text{};
        if (type == GNUTLS_SAN_DNSNAME) {
            names.push_back(validUtf8(std::string_view(bytes.data(), size)));
        } else if (type == GNUTLS_SAN_IPADDRESS && (size == 4 || size == 16)) {
            inet_ntop(size == 4 ? AF_INET : AF_INET6, bytes.data(), text.data(), text.size());
            names.emplace_back(text.data());
        }
    }
    return names;
}

constexpr const char* kAnew = "axon certs init --force, then issue all certificates again";

std::string serialOf(gnutls_x509_crt_t certificate) {
    std::array<char, 64> bytes{};
    auto size = bytes.size();
    if (gnutls_x509_crt_get_serial(certificate, bytes.data(), &size) < 0) return {};
    return hexOf(std::string_view(bytes.data(), size));
}

}  // namespace

void require(int code, const char* what) {
    if (code < 0) throw std::runtime_error(std::string(what) + " failed: " + gnutls_strerror(code));
}

std::string taken(gnutls_datum_t& from) {
    std::string text(reinterpret_cast<const char*>(from.data), from.size);
    gnutls_memset(from.data, 0, from.size);
    gnutls_free(from.data);
    return text;
}

KeyId idOf(gnutls_x509_crt_t certificate) {
    return keyId(&gnutls_x509_crt_get_key_id, certificate);
}

std::string hexOf(std::string_view bytes) {
    constexpr std::string_view kDigits = "0123456789abcdef";
    std::string text;
    for (const unsigned char c : bytes) {
        text += kDigits[c >> 4U];
        text += kDigits[c & 0xFU];
    }
    return text;
}

gnutls_datum_t datum(std::string_view text) {
    return {reinterpret_cast<unsigned char*>(const_cast<char*>(text.data())),
            static_cast<unsigned int>(text.size())};
}

Certificate contentOf(gnutls_x509_crt_t certificate) {
    Certificate it;
    it.name = nameByOid(certificate, GNUTLS_OID_X520_COMMON_NAME);
    it.unit = nameByOid(certificate, GNUTLS_OID_X520_ORGANIZATIONAL_UNIT_NAME);
    it.serial = serialOf(certificate);
    it.organisation = nameByOid(certificate, GNUTLS_OID_X520_ORGANIZATION_NAME);
    it.issuer = nameByOid(certificate, GNUTLS_OID_X520_COMMON_NAME, true);
    it.names = alternativeNames(certificate);
    it.authority = gnutls_x509_crt_get_ca_status(certificate, nullptr) > 0;
    it.from = WallTime(std::chrono::seconds(gnutls_x509_crt_get_activation_time(certificate)));
    it.until = WallTime(std::chrono::seconds(gnutls_x509_crt_get_expiration_time(certificate)));
    return it;
}

std::vector<CertificatePtr> parsed(std::string_view pem, const std::string& file) {
    gnutls_x509_crt_t* list = nullptr;
    unsigned int count = 0;
    const auto bytes = datum(pem);
    const int code = gnutls_x509_crt_list_import2(&list, &count, &bytes, GNUTLS_X509_FMT_PEM, 0);
    std::vector<CertificatePtr> all;
    if (code >= 0) {
        for (unsigned int i = 0; i < count; ++i) all.emplace_back(list[i]);
        gnutls_free(list);
    }
    if (all.empty()) {
        throw Unusable(file + ": expected a certificate in PEM form (-----BEGIN CERTIFICATE-----)",
                       "name a file of axon certs issue that ends in .cert.pem, or make it again");
    }
    return all;
}

const char* toString(Kind kind) {
    switch (kind) {
        case Kind::Server:
            return "server";
        case Kind::FrontEnd:
            return "front-end";
        case Kind::EntityServer:
            return "entity-server";
        case Kind::Storm:
            return "storm";
        case Kind::Registry:
            return "registry";
        case Kind::Router:
            return "router";
        case Kind::Entity:
            return "entity";
        case Kind::Client:
            break;
    }
    return "client";
}

std::optional<Kind> kindOf(std::string_view unit) {
    for (const auto kind : kKinds)
        if (unit == toString(kind)) return kind;
    return std::nullopt;
}

bool isCalled(Kind kind) {
    return kind != Kind::Entity && kind != Kind::Client;
}

bool isNamedServer(Kind kind) {
    return kind == Kind::FrontEnd || kind == Kind::EntityServer;
}

namespace {

/// Of these names, those by which it is called.
std::vector<std::string> hostsOf(const Request& request) {
    if (!isCalled(request.kind)) return {};
    return {request.names.begin() + (isNamedServer(request.kind) ? 1 : 0), request.names.end()};
}

}  // namespace

void check(const Request& request) {
    const auto its = std::string(toString(request.kind));
    const auto usage = "axon certs issue --" + its + (isNamedServer(request.kind) ? " NAME HOST" : " NAME");
    if (request.names.empty() || request.names.front().empty())
        throw Unusable("expected the name of the " + its, usage);
    const auto& name = request.names.front();
    if (request.valid < days{1} || request.valid > kLongest)
        throw Unusable("expected a validity of 1 to " + std::to_string(kLongest.count()) + " days",
                       "--days 365");
    if (name.size() > kNameMax)
        throw Unusable(quoted(name) + ": expected a name of at most " + std::to_string(kNameMax) +
                           " bytes, which is what a certificate can hold",
                       request.kind == Kind::Entity ? "give the entity a shorter name in its basic profile"
                                                    : "choose a shorter name");
    if (isCalled(request.kind)) {
        if (request.names.size() > kNamesMax)
            throw Unusable("expected at most " + std::to_string(kNamesMax) + " names", "issue a second one");
        if (isNamedServer(request.kind) && !isServerName(name))
            throw Unusable(quoted(name) +
                               ": expected the Server.Name of that server, which has 1 to 32 "
                               "letters, digits, '-' and '_', such as fe1",
                           usage);
        const auto hosts = hostsOf(request);
        if (hosts.empty())
            throw Unusable("expected the names and addresses by which " + quoted(name) +
                               " is called after its name: whoever calls checks that it has reached one",
                           usage + "…, such as " + its + ".lab.example or 192.168.0.5");
        for (const auto& one : hosts) {
            if (!isDnsName(one) && !isAddress(one))
                throw Unusable(quoted(one) + ": expected a DNS name or an IP address, as " + its +
                                   ".lab.example or 192.168.0.5: whoever calls checks that it has reached it",
                               usage + " ADDRESS");
        }
        return;
    }
    if (request.names.size() > 1)
        throw Unusable("expected one name, not " + std::to_string(request.names.size()),
                       name.find(' ') == std::string::npos ? usage + "; quote a name with spaces"
                                                           : "issue one after the other");
    if (request.kind == Kind::Client && !isUserName(name))
        throw Unusable(quoted(name) +
                           ": expected a user name of letters, digits, '.', '-' and '_', which is "
                           "also the one in users.cfg",
                       usage);
    const bool control =
        std::any_of(name.begin(), name.end(), [](unsigned char c) { return c < 0x20 || c == 0x7F; });
    if (control || validUtf8(name) != name)
        throw Unusable(quoted(name) + ": expected the name in the entity's basic profile, UTF-8 on one line",
                       usage);
}

Issued makeAuthority(WallTime now) {
    const auto key = newKey();
    const auto it = draft(key.get(), kAuthorityName, now - kBackdated, now + kAuthorityValid);
    require(gnutls_x509_crt_set_basic_constraints(it.get(), 1, 0), "the constraints of an authority");
    require(gnutls_x509_crt_set_key_usage(it.get(), GNUTLS_KEY_KEY_CERT_SIGN | GNUTLS_KEY_CRL_SIGN),
            "the use of a key");
    return sign(it.get(), key.get(), it.get(), key.get());
}

Signer signerOf(const Issued& authority, WallTime now) {
    auto all = parsed(authority.certificate, "the CA's certificate");
    auto* const issuer = all.front().get();
    const auto its = contentOf(issuer);
    if (!its.authority)
        throw Unusable("the CA's certificate is " + quoted(its.name) + "'s and no CA's",
                       "name the folder that axon certs init has made");
    if (validity(its, now) == Validity::Expired) throw Unusable("the CA expired on " + day(its.until), kAnew);
    if (validity(its, now) == Validity::NotYetValid)
        throw Unusable("the CA is valid from " + day(its.from) + " on, and today is " + day(now),
                       "set this machine's clock");
    auto issuers_key = emptyKey();
    const auto bytes = datum(authority.key);
    if (gnutls_x509_privkey_import2(issuers_key.get(), &bytes, GNUTLS_X509_FMT_PEM, nullptr,
                                    GNUTLS_PKCS_PLAIN) < 0)
        throw Unusable("the CA's key is no private key in PEM form (-----BEGIN PRIVATE KEY-----)",
                       "restore ca.key.pem from where you keep a copy, or " + std::string(kAnew));
    if (idOf(issuer) != keyId(&gnutls_x509_privkey_get_key_id, issuers_key.get()))
        throw Unusable("the CA's key is not the one of its certificate",
                       "restore ca.key.pem from where you keep a copy, or " + std::string(kAnew));
    return {std::move(all.front()), std::move(issuers_key)};
}

Issued issue(const Issued& authority, const Request& request, WallTime now) {
    check(request);
    const auto signer = signerOf(authority, now);
    const auto its = contentOf(signer.certificate.get());
    const auto key = newKey();
    const auto it = draft(key.get(), request.names.front(), now - kBackdated,
                          std::min<WallTime>(now + request.valid, its.until));
    setName(it.get(), GNUTLS_OID_X520_ORGANIZATIONAL_UNIT_NAME, toString(request.kind));
    require(gnutls_x509_crt_set_basic_constraints(it.get(), 0, -1), "the constraints of a certificate");
    require(gnutls_x509_crt_set_key_usage(it.get(), GNUTLS_KEY_DIGITAL_SIGNATURE), "the use of a key");
    require(gnutls_x509_crt_set_key_purpose_oid(it.get(), GNUTLS_KP_TLS_WWW_CLIENT, 0), "the use of a key");
    if (isCalled(request.kind)) {
        require(gnutls_x509_crt_set_key_purpose_oid(it.get(), GNUTLS_KP_TLS_WWW_SERVER, 0),
                "the use of a key");
        for (const auto& name : hostsOf(request)) {
            std::string address;
            const bool is_address = isAddress(name, &address);
            const auto& content = is_address ? address : name;
            require(gnutls_x509_crt_set_subject_alt_name(
                        it.get(), is_address ? GNUTLS_SAN_IPADDRESS : GNUTLS_SAN_DNSNAME, content.data(),
                        static_cast<unsigned int>(content.size()), GNUTLS_FSAN_APPEND),
                    "the names of a server");
        }
    }
    return sign(it.get(), key.get(), signer.certificate.get(), signer.key.get());
}

std::vector<Certificate> readCertificates(std::string_view pem, const std::string& file) {
    std::vector<Certificate> all;
    for (const auto& one : parsed(pem, file)) all.push_back(contentOf(one.get()));
    return all;
}

Validity validity(const Certificate& certificate, WallTime now) {
    if (now < certificate.from) return Validity::NotYetValid;
    if (now >= certificate.until) return Validity::Expired;
    return certificate.until - now < kSoon ? Validity::ExpiresSoon : Validity::Valid;
}

std::string day(WallTime time) {
    const auto seconds = static_cast<std::time_t>(time.time_since_epoch().count());
    std::tm parts{};
    std::array<char, 32> text{};
    if (gmtime_r(&seconds, &parts) == nullptr) return "?";
    const auto size = std::strftime(text.data(), text.size(), "%Y-%m-%d", &parts);
    return {text.data(), size};
}

}  // namespace axon::certificates
