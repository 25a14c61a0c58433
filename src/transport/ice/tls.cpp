// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/tls.hpp"

#include <IceSSL/IceSSL.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cctype>
#include <memory>
#include <mutex>
#include <utility>

#include "certificates/certificate.hpp"
#include "certificates/folder.hpp"
#include "common/rate_limit.hpp"
#include "common/refused_connection.hpp"
#include "transport/ice/ip_layer.hpp"

namespace axon::transport {
namespace {

std::shared_ptr<spdlog::logger> log() {
    // The client library has a logger of its own; standard output is its program's.
    const auto logger = spdlog::get("axon");
    return logger ? logger : spdlog::default_logger();
}

std::shared_ptr<IceSSL::ConnectionInfo> tlsOf(const std::shared_ptr<Ice::ConnectionInfo>& info) {
    for (auto layer = info; layer; layer = layer->underlying)
        if (auto tls = std::dynamic_pointer_cast<IceSSL::ConnectionInfo>(layer)) return tls;
    return nullptr;
}

std::shared_ptr<IceSSL::ConnectionInfo> tlsOf(const Ice::Connection& connection) {
    try {
        return tlsOf(connection.getInfo());
    } catch (const Ice::LocalException&) {  // closed meanwhile
        return nullptr;
    }
}

std::optional<PeerCertificate> contentOf(const IceSSL::ConnectionInfo& info) {
    if (info.certs.empty() || !info.certs.front()) return std::nullopt;
    try {
        auto its =
            certificates::readCertificates(info.certs.front()->encode(), "the peer's certificate").front();
        return PeerCertificate{std::move(its.name), std::move(its.unit)};
    } catch (const std::exception&) {  // verified by one library and not understood by the other
        return PeerCertificate{};
    }
}

/// What IceSSL says where the verifier of ours has refused, which has told why itself.
constexpr const char* kRefusedByUs = "rejected by certificate verifier";

/// The plug-in's; null without it.
std::shared_ptr<IceSSL::Plugin> pluginOf(const std::shared_ptr<Ice::Communicator>& communicator) {
    return std::dynamic_pointer_cast<IceSSL::Plugin>(communicator->getPluginManager()->getPlugin("IceSSL"));
}

std::string onOneLine(std::string text) {
    std::replace(text.begin(), text.end(), '\n', ' ');
    return text;
}

/// Ice's logger of a communicator that speaks TLS. Ice tells nobody but its traces why it has not accepted a
/// connection; of these the one is passed on, at most ten in a second, as strangers cause it. Where the
/// configuration asks for traces all are.
class TlsLog final : public Ice::Logger, public std::enable_shared_from_this<TlsLog> {
  public:
    explicit TlsLog(bool all) : all_(all) {}
    void print(const std::string& message) override { log()->info("{}", onOneLine(message)); }
    void trace(const std::string& category, const std::string& message) override {
        // A WebSocket that is not opened as it should is no matter of TLS (onBrokenProtocol()).
        if (const auto its = refusedConnection(message); its && its->at == RefusedAt::TlsHandshake) {
            refused(*its);
        } else if (all_) {
            log()->info("{}: {}", category, onOneLine(message));
        }
    }
    void warning(const std::string& message) override { log()->warn("{}", onOneLine(message)); }
    void error(const std::string& message) override { log()->error("{}", onOneLine(message)); }
    std::string getPrefix() override { return {}; }
    std::shared_ptr<Ice::Logger> cloneWithPrefix(const std::string&) override { return shared_from_this(); }

    using Refused = std::function<void(const std::string&, const std::string&, const std::string&)>;
    void tell(Refused refused) {
        const std::lock_guard lock(mutex_);
        refused_ = std::move(refused);
    }

  private:
    void refused(const RefusedConnection& its) {
        if (its.said.find(kRefusedByUs) != std::string::npos) return;
        if (limit_.admit(clock_.now()))
            log()->warn("TLS: a connection from {} was refused: {} ({})", its.peer, its.why, its.said);
        Refused tell;
        {
            const std::lock_guard lock(mutex_);
            tell = refused_;
        }
        if (tell) tell(its.peer, its.local, its.why);
    }

    const bool all_;
    const SteadyClock clock_{};
    RateLimit limit_{10};
    std::mutex mutex_;
    Refused refused_;  // guarded by mutex_
};

/// Whether a client or an Entity Manager may have reached it.
bool answersPeers(const PeerCertificate& its) {
    using certificates::Kind;
    const auto kind = certificates::kindOf(its.unit);
    return kind && isCalled(*kind) && *kind != Kind::Storm && *kind != Kind::Registry;
}

/// Nothing also where IceSSL has let pass what it has not verified (IceSSL.VerifyPeer=0).
std::optional<PeerCertificate> verifiedOf(const IceSSL::ConnectionInfo& info) {
    return info.verified ? contentOf(info) : std::nullopt;
}

/// Whether TLS 1.2 is spoken besides 1.3: by IceSSL.Protocols, the one key that IceSSL 3.7.8 obeys with
/// OpenSSL, and without it by IceSSL.ProtocolVersionMin.
bool speaksOlderTls(const std::string& protocols, std::string least) {
    if (!protocols.empty()) return protocols.find("1_2") != std::string::npos;
    std::transform(least.begin(), least.end(), least.begin(),
                   [](unsigned char letter) { return static_cast<char>(std::tolower(letter)); });
    return !least.empty() && !least.ends_with("1_3");  // tls1_3 and tlsv1_3
}

}  // namespace

std::optional<PeerCertificate> certificateOf(const Ice::Connection& connection) {
    const auto info = tlsOf(connection);
    return info ? contentOf(*info) : std::nullopt;
}

std::optional<PeerCertificate> verifiedCertificateOf(const Ice::Connection& connection) {
    const auto info = tlsOf(connection);
    return info ? verifiedOf(*info) : std::nullopt;
}

bool isTls(const Ice::Connection& connection) {
    return tlsOf(connection) != nullptr;
}

bool speaksTls(const std::map<std::string, std::string>& properties) {
    return properties.contains("IceSSL.CertFile") || properties.contains("IceSSL.FindCert");
}

certificates::WallTime wallTime() {
    return std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
}

certificates::Credentials credentialsOf(const std::map<std::string, std::string>& properties) {
    const auto value = [&](const char* key, const char* otherwise = "") {
        const auto found = properties.find(key);
        return found == properties.end() ? std::string(otherwise) : found->second;
    };
    const std::filesystem::path folder = value("IceSSL.DefaultDir");
    const auto read = [&](const char* key, const std::string& name) {
        if (name.empty())
            throw certificates::Unusable(std::string(key) + " is not configured",
                                         "the lines of the file KIND-NAME.cfg of axon certs issue");
        return certificates::readFile(folder / name,
                                      std::string("name a file of axon certs issue in ") + key);
    };
    // What only IceSSL would check must not be left unchecked.
    for (const auto& [key, set] : properties)
        if (!set.empty() && (key.starts_with("IceSSL.TrustOnly") || key.starts_with("IceSSL.Revocation") ||
                             key == "IceSSL.CertificateRevocationListFiles"))
            throw certificates::Unusable(key + " is known to IceSSL only",
                                         "leave it out, or everything stays relayed");
    certificates::Credentials its;
    its.authorities = read("IceSSL.CAs", value("IceSSL.CAs"));
    const auto certificate = value("IceSSL.CertFile");
    its.certificate = read("IceSSL.CertFile", certificate);
    its.key = read("IceSSL.KeyFile", value("IceSSL.KeyFile", certificate.c_str()));
    its.password = value("IceSSL.Password");
    const auto verifies = value("IceSSL.VerifyPeer", "2");
    using Peer = certificates::Credentials::Peer;
    its.caller = verifies == "0" ? Peer::NotAsked : verifies == "1" ? Peer::Asked : Peer::Required;
    its.tls_1_2 = speaksOlderTls(value("IceSSL.Protocols"), value("IceSSL.ProtocolVersionMin"));
    return its;
}

std::map<std::string, std::string> callingEntities(std::map<std::string, std::string> properties) {
    properties["IceSSL.VerifyPeer"] = "0";
    properties["IceSSL.CheckCertName"] = "0";
    return properties;
}

void onlyEntities(const std::shared_ptr<Ice::Communicator>& communicator,
                  std::shared_ptr<const certificates::Trust> trust) {
    const auto plugin = pluginOf(communicator);
    if (!plugin) return;
    plugin->setCertificateVerifier(
        [trust = std::move(trust)](const std::shared_ptr<IceSSL::ConnectionInfo>& info) {
            std::string chain;
            for (const auto& one : info->certs)
                if (one) chain += one->encode();
            const auto verdict = trust->judgePem(chain, wallTime());
            const auto* const its = std::get_if<certificates::Certificate>(&verdict);
            return its != nullptr && its->unit == certificates::toString(certificates::Kind::Entity);
        });
}

void prepareTls(Ice::InitializationData& init, const std::map<std::string, std::string>& configured) {
    const std::map<std::string, std::string> defaults = {
        {"Ice.Plugin.IceSSL", "IceSSL:createIceSSL"},
        {"IceSSL.VerifyPeer", "2"},
        {"IceSSL.CheckCertName", "1"},
        {"IceSSL.Protocols", speaksOlderTls({}, init.properties->getProperty("IceSSL.ProtocolVersionMin"))
                                 ? "TLS1_2,TLS1_3"
                                 : "TLS1_3"},
        {"Ice.Trace.Network", "2"},  // for TlsLog
    };
    bool all = false;
    for (const auto& [key, value] : configured)
        all = all || key.rfind("Ice.Trace.", 0) == 0 || key.rfind("IceSSL.Trace.", 0) == 0;
    for (const auto& [key, value] : defaults)
        if (!configured.contains(key)) init.properties->setProperty(key, value);
    init.logger = std::make_shared<TlsLog>(all);
}

void checkServers(const std::shared_ptr<Ice::Communicator>& communicator) {
    const auto plugin = pluginOf(communicator);
    if (!plugin) return;
    plugin->setCertificateVerifier([](const std::shared_ptr<IceSSL::ConnectionInfo>& info) {
        if (info->incoming) return true;  // the gates say what they expect, and why not
        const auto its = contentOf(*info);
        if (its && answersPeers(*its)) return true;
        log()->warn(
            "TLS: the called machine shows the certificate of the {} '{}'; expected one of a server: it is "
            "not the server, or has the wrong certificate",
            its ? its->unit : std::string("unknown"), its ? its->name : std::string());
        return false;
    });
}

void judgeCertificates(const std::shared_ptr<Ice::Communicator>& communicator,
                       std::function<bool(const Judged&)> accept) {
    const auto plugin = pluginOf(communicator);
    if (!plugin) return;
    plugin->setCertificateVerifier(
        [accept = std::move(accept)](const std::shared_ptr<IceSSL::ConnectionInfo>& info) {
            const auto ip = ipOf(info->underlying);
            return accept({info->incoming, info->adapterName, ip ? remoteEnd(*ip) : "an unknown address",
                           ip ? localEnd(*ip) : std::string(), verifiedOf(*info)});
        });
}

void onRefused(const std::shared_ptr<Ice::Communicator>& communicator,
               std::function<void(const std::string&, const std::string&, const std::string&)> refused) {
    if (const auto its = std::dynamic_pointer_cast<TlsLog>(communicator->getLogger()))
        its->tell(std::move(refused));
}

std::optional<Refusal> tlsRefusal(const std::exception_ptr& error, bool setting_up) {
    const auto refused = [](const std::string& said) {
        const auto* means = meaningOfTlsError(said);
        return Refusal{RefusalCode::PermissionDenied,
                       std::string("the server's certificate is not accepted: ") +
                           (means != nullptr ? means : onOneLine(said).c_str()) +
                           "; expected one of the laboratory's CA (IceSSL.CAs) for the name or address that "
                           "was called; fix: axon certs issue --server NAME ADDRESS",
                       {}};
    };
    try {
        std::rethrow_exception(error);
    } catch (const Ice::SecurityException& security) {
        return refused(security.reason);
    } catch (const Ice::ProtocolException& protocol) {
        if (protocol.reason.find("SSL") == std::string::npos) return std::nullopt;
        if (protocol.reason.find("alert") == std::string::npos &&
            meaningOfTlsError(protocol.reason) != nullptr)
            return refused(protocol.reason);
        // IceSSL 3.7.8 loses what OpenSSL says of it.
        if (protocol.reason.find("new outgoing connection") != std::string::npos)
            return Refusal{RefusalCode::NotConnected,
                           "TLS could not be set up: most likely the server does not speak TLS on that port; "
                           "fix: leave ssl:// out, or name another port; otherwise see the server's log",
                           {}};
        if (!setting_up)
            return Refusal{RefusalCode::NotConnected, "the TLS connection was lost; fix: connect again", {}};
    } catch (const Ice::ConnectionLostException&) {
        if (!setting_up) return std::nullopt;
    } catch (...) {
        return std::nullopt;
    }
    return Refusal{RefusalCode::PermissionDenied,
                   "the server closed the connection while it was being set up: most likely it does not "
                   "accept the certificate shown (IceSSL.CertFile: of another CA, expired or revoked); fix: "
                   "check it with axon certs show, and see the server's log",
                   {}};
}

std::string certificateMissing(const std::string& address, const std::string& kind) {
    return "'" + address +
           "' is a TLS endpoint, but no certificate is configured (IceSSL.CertFile); fix: axon certs init, "
           "then axon certs issue --" +
           kind + " NAME, which writes a configuration file for --config";
}

}  // namespace axon::transport
