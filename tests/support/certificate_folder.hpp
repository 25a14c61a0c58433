// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "certificates/folder.hpp"
#include "certificates/trust.hpp"

namespace axon::test {

/// A laboratory's CA in a folder of its own, which goes with it, and what it issues.
class CertificateFolder {
  public:
    static certificates::WallTime now() {
        return std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
    }
    CertificateFolder() { folder_.init(now(), false); }
    ~CertificateFolder() { std::filesystem::remove_all(path_); }
    CertificateFolder(const CertificateFolder&) = delete;
    CertificateFolder& operator=(const CertificateFolder&) = delete;

    /// The configuration file of a new certificate.
    std::filesystem::path issue(certificates::Kind kind, std::vector<std::string> names) const {
        return folder_.issue({kind, std::move(names)}, now(), true).files.back();
    }
    /// The same as credentials.
    certificates::Credentials credentials(certificates::Kind kind, const std::string& name) const {
        const auto files = folder_.issue({kind, {name}}, now(), true).files;
        certificates::Credentials its;
        its.authorities = certificates::readFile(folder_.path() / "ca.cert.pem", "");
        for (const auto& file : files) {
            if (file.string().ends_with(".cert.pem")) its.certificate = certificates::readFile(file, "");
            if (file.string().ends_with(".key.pem")) its.key = certificates::readFile(file, "");
        }
        return its;
    }
    const std::filesystem::path& path() const { return path_; }

  private:
    static std::filesystem::path newFolder() {
        std::string name = std::filesystem::temp_directory_path() / "axon-certificates-XXXXXX";
        return ::mkdtemp(name.data());
    }
    const std::filesystem::path path_ = newFolder();
    const certificates::Folder folder_{path_ / "certs"};
};

}  // namespace axon::test
