// SPDX-License-Identifier: GPL-2.0-or-later
// Certificates that no honest peer shows, for abuse.py: of another CA, expired, not yet valid, revoked.
//
//     hostile-certificates FOLDER
//
// makes FOLDER/{good,foreign,expired,early,revoked}/KIND.{cert,key}.pem for each kind, and for the two of a
// partner's gateway, FOLDER/ca.{cert,key}.pem as axon certs has them, and FOLDER/revoked.crl.pem. All but the
// foreign ones are the CA's.
#include <gnutls/x509.h>

#include <filesystem>
#include <fstream>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

#include "certificates/certificate.hpp"
#include "certificates/x509.hpp"

namespace {

using namespace axon::certificates;
namespace fs = std::filesystem;

void write(const fs::path& file, const std::string& text) {
    fs::create_directories(file.parent_path());
    std::ofstream out(file, std::ios::binary);
    out << text;
    out.close();
    fs::permissions(file, fs::perms::owner_read | fs::perms::owner_write);
    if (!out) throw std::runtime_error("cannot write " + file.string());
}

std::vector<std::string> namesFor(Kind kind) {
    if (kind == Kind::Entity) return {"Counter"};
    if (kind == Kind::Client) return {"ann"};
    if (isNamedServer(kind)) return {kind == Kind::FrontEnd ? "fe1" : "es1", "localhost", "127.0.0.1"};
    return {"localhost", "127.0.0.1"};
}

std::vector<Issued> issueAll(const fs::path& folder, const Issued& authority, WallTime at) {
    std::vector<Issued> all;
    const auto add = [&](const std::string& stem, Kind kind, const std::vector<std::string>& names) {
        all.push_back(issue(authority, {kind, names}, at));
        write(folder / (stem + ".cert.pem"), all.back().certificate);
        write(folder / (stem + ".key.pem"), all.back().key);
    };
    for (const auto kind : kKinds) add(std::string(toString(kind)), kind, namesFor(kind));
    add("partner", Kind::Entity, {"b/"});
    add("partner-client", Kind::Client, {"lab-a"});
    return all;
}

void require(int code) {
    if (code < 0) throw std::runtime_error(gnutls_strerror(code));
}

std::string listOf(const std::vector<Issued>& revoked, const Issued& authority, WallTime now) {
    const auto at = std::chrono::system_clock::to_time_t(now);
    gnutls_x509_crl_t list = nullptr;
    gnutls_x509_privkey_t key = nullptr;
    require(gnutls_x509_crl_init(&list));
    require(gnutls_x509_crl_set_version(list, 2));
    require(gnutls_x509_crl_set_this_update(list, at - 3600));
    require(gnutls_x509_crl_set_next_update(list, at + 86400));
    const unsigned char number = 1;
    require(gnutls_x509_crl_set_number(list, &number, 1));
    for (const auto& one : revoked)
        require(gnutls_x509_crl_set_crt(list, parsed(one.certificate, "revoked").front().get(), at - 3600));
    require(gnutls_x509_privkey_init(&key));
    const auto pem = datum(authority.key);
    require(gnutls_x509_privkey_import2(key, &pem, GNUTLS_X509_FMT_PEM, nullptr, 0));
    require(gnutls_x509_crl_sign2(list, parsed(authority.certificate, "the CA").front().get(), key,
                                  GNUTLS_DIG_SHA256, 0));
    gnutls_datum_t text{};
    require(gnutls_x509_crl_export2(list, GNUTLS_X509_FMT_PEM, &text));
    std::string its(reinterpret_cast<const char*>(text.data), text.size);
    gnutls_free(text.data);
    gnutls_x509_privkey_deinit(key);
    gnutls_x509_crl_deinit(list);
    return its;
}

}  // namespace

int main(int argc, char** argv) try {
    if (argc != 2) {
        std::cerr << "hostile-certificates FOLDER\n";
        return 2;
    }
    const fs::path folder = argv[1];
    const auto now = std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
    const auto long_ago = now - std::chrono::days{400};
    const auto authority = makeAuthority(long_ago);
    write(folder / "ca.cert.pem", authority.certificate);
    write(folder / "ca.key.pem", authority.key);
    issueAll(folder / "good", authority, now);
    issueAll(folder / "foreign", makeAuthority(long_ago), now);
    issueAll(folder / "expired", authority, long_ago);
    issueAll(folder / "early", authority, now + std::chrono::days{10});
    write(folder / "revoked.crl.pem", listOf(issueAll(folder / "revoked", authority, now), authority, now));
    return 0;
} catch (const std::exception& problem) {
    std::cerr << "hostile-certificates: " << problem.what() << "\n";
    return 2;
}
