// SPDX-License-Identifier: MIT
#include "common/refused_connection.hpp"

#include <algorithm>

namespace axon {
namespace {

struct Reason {
    std::string_view said;
    const char* means;
};

/// By a part of the text.
constexpr Reason kTlsReasons[] = {
    {"CRL has expired",
     "the revocation list of this program has ended (axon certs revoke without a name makes it valid again; "
     "copy it here and restart this program)"},
    {"CRL is not yet valid",
     "the revocation list of this program is not yet valid (compare the clocks of the two machines)"},
    {"unable to get certificate CRL",
     "there is no revocation list of its CA here (IceSSL.CertificateRevocationListFiles; axon certs revoke "
     "makes one)"},
    {"expired", "the certificate has expired (axon certs issue … --force makes a new one)"},
    {"not yet valid", "the certificate is not yet valid (compare the clocks of the two machines)"},
    {"ostname mismatch", "the certificate is for other names"},
    {"P address mismatch", "the certificate is for other addresses"},
    {"revoked", "the certificate has been revoked"},
    {"peer did not return a certificate", "no certificate was shown (axon certs issue makes one)"},
    {"unsupported certificate purpose", "the certificate is of another kind"},
    {"unsuitable certificate purpose", "the certificate is of another kind"},
    {"rejected by trust manager", "the certificate is of another kind than this port takes"},
    {"self signed", "the certificate is of another CA"},
    {"self-signed", "the certificate is of another CA"},
    {"unable to get local issuer", "the certificate is of another CA"},
    {"unable to verify the first certificate", "the certificate is of another CA"},
    {"certificate signature failure", "the certificate is of another CA"},
    {"certificate verify failed", "the certificate is not one of this laboratory's CA"},
    {"unknown ca", "the certificate is of another CA"},
};

/// IceSSL 3.7.8 loses what OpenSSL says of a handshake in which no certificate came, or reports that the peer
/// has ended it.
constexpr const char* kWithoutReason =
    "no certificate was shown (axon certs issue makes one), or the peer does not speak TLS 1.3, or it ended "
    "the handshake, as one does that does not accept this program's certificate";

/// The same at a port that asks for no certificate.
constexpr const char* kNoTls = "the peer does not speak TLS 1.3";

/// What OpenSSL says where the peer has said so with an alert: "tlsv1 alert unknown ca".
constexpr const char* kRefusedByPeer =
    "the peer does not accept this program's certificate (compare IceSSL.CAs of the peer, and the name or "
    "address that it called)";

/// By the names of Ice's exceptions.
constexpr Reason kProtocolReasons[] = {
    {"::Ice::BadMagicException", "it does not speak Ice's protocol"},
    {"::Ice::UnsupportedProtocolException", "it speaks another version of Ice's protocol"},
    {"::Ice::UnsupportedEncodingException", "it uses another version of Ice's encoding"},
    {"::Ice::UnknownMessageException", "it sent a message of a kind that Ice does not have"},
    {"::Ice::ConnectionNotValidatedException", "it sent a message before the connection was set up"},
    {"::Ice::UnknownRequestIdException", "it answered a call that nobody made"},
    {"::Ice::UnknownReplyStatusException", "it sent an answer of a kind that Ice does not have"},
    {"::Ice::IllegalMessageSizeException", "it announced a message of an impossible size"},
    {"::Ice::MemoryLimitException", "it announced a message that is larger than this port takes"},
    {"::Ice::CompressionException", "it sent a message that cannot be decompressed"},
    {"::Ice::FeatureNotSupportedException", "it sent a message that is compressed"},
    {"::Ice::UnmarshalOutOfBoundsException", "it sent a message that is cut off"},
    {"::Ice::MarshalException", "it sent a message that cannot be read"},
    {"::Ice::EncapsulationException", "it sent a message that cannot be read"},
    {"::Ice::ProxyUnmarshalException", "it sent a message that cannot be read"},
    {"::Ice::StringConversionException", "it sent a message that cannot be read"},
    {"::Ice::IllegalIdentityException", "it called an object without a name"},
    {"::Ice::ProtocolException", "it does not speak the protocol of this port"},
};

constexpr std::size_t kSaidMax = 300;

/// The type ("ssl") of a message that begins so: "failed to accept ssl connection".
std::optional<std::string> typeIn(const std::string& trace, std::string_view before, std::string_view after) {
    if (!trace.starts_with(before)) return std::nullopt;
    const auto line = trace.substr(0, trace.find('\n'));
    if (!line.ends_with(after) || line.size() < before.size() + after.size()) return std::nullopt;
    return line.substr(before.size(), line.size() - before.size() - after.size());
}

/// Of a line "remote address = 10.0.0.7:50122", and of "local address = …".
std::string addressIn(const std::string& trace, const std::string& side) {
    const auto before = "\n" + side + " address = ";
    const auto at = trace.find(before);
    if (at == std::string::npos) return "an unknown address";
    const auto begin = at + before.size();
    auto its = trace.substr(begin, trace.find('\n', begin) - begin);
    return portIn(its).empty() ? "an unknown address" : its;  // "<not connected>"
}

/// "::Ice::SecurityException" and all that follows, of a line "FILE:NUMBER: ::Ice::SecurityException:".
std::string exceptionIn(const std::string& trace) {
    constexpr std::string_view kBefore = ": ::Ice::";
    const auto at = trace.find(kBefore);
    return at == std::string::npos ? std::string() : trace.substr(at + 2);
}

std::string nameOf(const std::string& exception) {
    constexpr std::size_t kScope = 7;  // "::Ice::"
    return exception.substr(0, exception.find_first_of(":\n", std::min(kScope, exception.size())));
}

std::string onOneLine(std::string exception) {
    exception = exception.substr(0, std::min(kSaidMax, exception.find("\nlocal address")));
    while (!exception.empty() && (exception.back() == '\n' || exception.back() == ':')) exception.pop_back();
    std::replace(exception.begin(), exception.end(), '\n', ' ');
    return exception;
}

/// Whether the alert, which the peer has sent, is about a certificate: that of this program.
bool isAlertOfCertificate(std::string_view said) {
    const auto at = said.find("alert ");
    if (at == std::string_view::npos) return false;
    const auto alert = said.substr(at, said.find_first_of(":\n", at) - at);
    return alert.find("certificate") != std::string_view::npos ||
           alert.find("unknown ca") != std::string_view::npos;
}

/// Of a connection that was not accepted. False: not because of its peer.
bool explainNotAccepted(RefusedConnection& its, const std::string& type, const std::string& name,
                        const std::string& exception) {
    const bool late = name == "::Ice::ConnectTimeoutException";
    // Over a WebSocket it may also have been after the handshake.
    const bool ended = type == "ssl" && name == "::Ice::ConnectionLostException";
    if (!late && !ended && name != "::Ice::SecurityException" && meaningOfProtocolError(name) == nullptr)
        return false;
    const bool tls =
        type == "ssl" ||
        (type == "wss" && (name == "::Ice::SecurityException" || exception.find("SSL") != std::string::npos));
    its.at = tls                             ? RefusedAt::TlsHandshake
             : type == "ws" || type == "wss" ? RefusedAt::WebSocket
                                             : RefusedAt::Protocol;
    if (late) {
        its.code = RefusalCode::Expired;
        its.why = tls             ? "it did not finish the TLS handshake in time"
                  : type == "wss" ? "it did not finish the TLS handshake, or open a WebSocket, in time"
                                  : "it did not set up the connection in time";
    } else if (tls) {
        const auto* const means =
            isAlertOfCertificate(exception) ? kRefusedByPeer : meaningOfTlsError(exception);
        its.code = RefusalCode::PermissionDenied;
        its.why = means != nullptr ? means : type == "wss" ? kNoTls : kWithoutReason;
    } else {
        its.why = its.at == RefusedAt::WebSocket ? "it does not open a WebSocket"
                                                 : "it does not speak the protocol of this port";
    }
    return true;
}

}  // namespace

std::string_view portIn(std::string_view address) {
    const auto at = address.rfind(':');
    return at == std::string_view::npos ? std::string_view() : address.substr(at + 1);
}

const char* meaningOfTlsError(std::string_view said) {
    for (const auto& [part, means] : kTlsReasons)
        if (said.find(part) != std::string_view::npos) return means;
    return nullptr;
}

const char* meaningOfProtocolError(std::string_view exception) {
    for (const auto& [name, means] : kProtocolReasons)
        if (exception == name) return means;
    return nullptr;
}

std::optional<std::string> listeningAt(const std::string& trace) {
    if (!typeIn(trace, "listening for ", " connections")) return std::nullopt;
    auto address = addressIn(trace, "local");
    if (portIn(address).empty()) return std::nullopt;
    return address;
}

std::optional<RefusedConnection> refusedConnection(const std::string& trace) {
    const auto not_accepted = typeIn(trace, "failed to accept ", " connection");
    if (!not_accepted && !typeIn(trace, "closed ", " connection")) return std::nullopt;
    const auto exception = exceptionIn(trace);
    const auto name = nameOf(exception);
    if (name.empty()) return std::nullopt;
    RefusedConnection its{.peer = addressIn(trace, "remote"),
                          .local = addressIn(trace, "local"),
                          .why = {},
                          .said = onOneLine(exception)};
    if (not_accepted) {
        if (!explainNotAccepted(its, *not_accepted, name, exception)) return std::nullopt;
        return its;
    }
    const auto* const means = meaningOfProtocolError(name);
    if (means == nullptr) return std::nullopt;
    its.why = means;
    return its;
}

}  // namespace axon
