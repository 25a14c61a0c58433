// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "certificates/certificate.hpp"
#include "certificates/revocation.hpp"

namespace axon::certificates {

/// What an issue has written.
struct Written {
    std::vector<std::filesystem::path> files;  ///< the configuration file last
    Certificate certificate;
};

/// What a revocation has written.
struct Revoked {
    std::filesystem::path list;
    WallTime until{};       ///< of the list
    std::size_t added = 0;  ///< certificates
    std::size_t in_the_list = 0;
};

/// The folder with the laboratory's CA and what it has issued:
///
///     ca.cert.pem         goes to every machine
///     ca.key.pem  0600    stays here: whoever has it can be anybody
///     KIND-NAME.cert.pem, KIND-NAME.key.pem (0600), KIND-NAME.cfg
///     issued.txt          each certificate that was issued: serial number, last second, KIND-NAME
///     revoked.crl.pem     the revocation list, once there is one; goes to every server
///
/// Threads: one for each Folder; of several Folders, processes included, one at a time changes the same
/// folder, and the others wait. Failure: Unusable, with the fix; what was there before is then still there,
/// whole. Nothing is overwritten without `force`.
class Folder {
  public:
    explicit Folder(std::filesystem::path path);

    /// Makes the folder (0700) where there is none, and the CA.
    Written init(WallTime now, bool force) const;
    Written issue(const Request& request, WallTime now, bool force) const;
    /// Writes the revocation list with these certificates and those that it has already; with none, the same
    /// list with a new validity. One is named by its file, or by KIND-NAME, which is every one that was
    /// issued so far under that name and is still valid. All or, where one cannot be revoked, none.
    Revoked revoke(const std::vector<std::string>& names, std::optional<std::chrono::days> valid,
                   WallTime now) const;
    /// The revocation list of this folder; none where there is none.
    std::optional<RevocationList> revocationList() const;
    /// The certificates in it, the CA's first.
    std::vector<std::filesystem::path> certificateFiles() const;

    const std::filesystem::path& path() const { return path_; }

  private:
    struct Entry {
        std::string serial;
        WallTime until{};
        std::string stem;
    };
    std::vector<Entry> issuedSoFar() const;
    Issued authority() const;

    const std::filesystem::path path_;
};

/// A regular file of at most 1 MiB. Throws Unusable, with this fix.
std::string readFile(const std::filesystem::path& file, const std::string& fix);

/// The certificates in a file of at most 1 MiB. Throws Unusable.
std::vector<Certificate> readCertificateFile(const std::filesystem::path& file);

/// "entity-Cyton_Arm": what the files of this certificate begin with.
std::string fileStem(const Request& request);

/// In Ice property syntax: how a program uses the certificate `stem` in `folder`. `stem` is a fileStem().
std::string configuration(const Request& request, const std::string& stem,
                          const std::filesystem::path& folder);

/// The folder where none is named: $XDG_CONFIG_HOME/axon/certs, or ~/.config/axon/certs. Empty where neither
/// is known.
std::filesystem::path defaultFolder();

}  // namespace axon::certificates
