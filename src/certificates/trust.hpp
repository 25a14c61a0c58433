// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "certificates/certificate.hpp"

namespace axon::certificates {

/// What a program shows and whom it trusts, as its configuration says. All texts are PEM.
struct Credentials {
    enum class Peer : std::uint8_t { NotAsked, Asked, Required };

    std::string authorities;
    std::string certificate;  ///< its own; certificates between it and the CA may follow
    std::string key;
    std::string password;  ///< of the key; empty: none
    /// Whether somebody who calls this program has to show a certificate.
    Peer caller = Peer::Required;
    bool tls_1_2 = false;  ///< besides 1.3
};

/// Decides whether a certificate is one of a CA. What it may be used for is not asked: that is for whoever
/// knows the connection, by the certificate's kind and name.
///
/// Constant after construction. Threads: any. Failure: the constructor throws Unusable for a text without a
/// certificate.
class Trust {
  public:
    /// `authorities` is PEM.
    explicit Trust(std::string_view authorities);
    ~Trust();
    Trust(Trust&&) noexcept;

    /// The peer's certificate (the first of the chain), or why it is not accepted: a text for a person that
    /// follows "the certificate".
    using Verdict = std::variant<Certificate, std::string>;
    Verdict judgePem(std::string_view chain, WallTime now) const;
    Verdict judgeDer(const std::vector<std::string_view>& chain, WallTime now) const;

  private:
    struct Authorities;
    std::unique_ptr<const Authorities> authorities_;
};

/// Why it is not the certificate of this kind and name, as above; empty: it is.
std::string mismatch(const Certificate& its, Kind kind, std::string_view name);

}  // namespace axon::certificates
