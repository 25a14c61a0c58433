// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/tls_channel.hpp"

#include <gnutls/gnutls.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <mutex>
#include <utility>
#include <vector>

#include "certificates/x509.hpp"

namespace axon::direct::lane {

using certificates::Credentials;
using certificates::Unusable;

namespace {

constexpr std::size_t kReadMax = 64 * 1024;       // of the socket, at once
constexpr std::size_t kRecordMax = 16 * 1024;     // what one record of TLS holds
constexpr std::size_t kHandshakeMax = 32 * 1024;  // of one message, such as a chain of certificates
constexpr std::size_t kSentAtOnce = 64 * 1024;    // then the socket is asked how much it takes
/// What may wait to be sent: what was sealed at once, and a little that TLS itself says.
constexpr std::size_t kUnsentMax = 2 * kSentAtOnce;

struct SessionFree {
    void operator()(gnutls_session_t it) const { gnutls_deinit(it); }
};
using Session = std::unique_ptr<gnutls_session_int, SessionFree>;

void require(int code, const char* what) {
    if (code < 0) throw std::runtime_error(std::string(what) + " failed: " + gnutls_strerror(code));
}

/// What GnuTLS has taken from the connection and says, and what changes nothing.
bool isNothing(ssize_t code) {
    return code == GNUTLS_E_INTERRUPTED || code == GNUTLS_E_WARNING_ALERT_RECEIVED;
}

/// What GnuTLS says of an error, without its full stop.
std::string textOf(int code) {
    std::string text = gnutls_strerror(code);
    if (text.ends_with('.')) text.pop_back();
    return text;
}

/// The pieces as one run of bytes.
class Run {
  public:
    explicit Run(std::span<const std::string_view> pieces) : pieces_(pieces) {}
    void skip(std::size_t count) {
        while (count > 0 && !pieces_.empty()) {
            const auto part = std::min(count, pieces_.front().size() - at_);
            count -= part;
            advance(part);
        }
    }
    /// At most as many as there is room for.
    std::size_t take(std::span<char> room) {
        std::size_t taken = 0;
        while (taken < room.size() && !pieces_.empty()) {
            const auto part = std::min(room.size() - taken, pieces_.front().size() - at_);
            if (part > 0) std::memcpy(room.data() + taken, pieces_.front().data() + at_, part);
            taken += part;
            advance(part);
        }
        return taken;
    }

  private:
    void advance(std::size_t part) {
        at_ += part;
        if (at_ < pieces_.front().size()) return;
        pieces_ = pieces_.subspan(1);
        at_ = 0;
    }
    std::span<const std::string_view> pieces_;
    std::size_t at_ = 0;  // in the first
};

}  // namespace

struct Tls::Shown {
    gnutls_certificate_credentials_t it = nullptr;
    gnutls_priority_t versions = nullptr;

    Shown() { require(gnutls_certificate_allocate_credentials(&it), "making credentials"); }
    ~Shown() {
        gnutls_certificate_free_credentials(it);
        gnutls_priority_deinit(versions);
    }
    Shown(const Shown&) = delete;
    Shown& operator=(const Shown&) = delete;

    static std::unique_ptr<const Shown> of(const Credentials& credentials) {
        auto made = std::make_unique<Shown>();
        const auto* const versions = credentials.tls_1_2 ? "NORMAL:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2"
                                                         : "NORMAL:-VERS-ALL:+VERS-TLS1.3";
        if (gnutls_priority_init(&made->versions, versions, nullptr) < 0)
            throw Unusable("this machine's GnuTLS does not permit TLS 1.3",
                           "see the system-wide configuration of GnuTLS (/etc/gnutls/config)");
        if (credentials.certificate.empty()) return made;
        const auto certificate = certificates::datum(credentials.certificate);
        const auto key = certificates::datum(credentials.key);
        const int code = gnutls_certificate_set_x509_key_mem2(
            made->it, &certificate, &key, GNUTLS_X509_FMT_PEM,
            credentials.password.empty() ? nullptr : credentials.password.c_str(), 0);
        if (code < 0)
            throw Unusable("certificate and key cannot be used: " + textOf(code) +
                               "; expected both in PEM form, and the key of this certificate",
                           "name files of axon certs issue in IceSSL.CertFile and IceSSL.KeyFile");
        return made;
    }
};

/// GnuTLS between two memories, so that it never waits: what came from the socket, and what is to go there.
///
/// A byte counts as written when the socket has taken the record that holds it, as LaneOutbox expects. Until
/// then the bytes of the last records are owed: sealed, not yet all sent, and named again by the next
/// write().
class TlsChannel final : public Channel {
  public:
    TlsChannel(std::shared_ptr<const Tls> tls, bool calls, std::string name, Wire& socket)
        : tls_(std::move(tls)), calls_(calls), name_(std::move(name)), socket_(socket) {
        gnutls_session_t made = nullptr;
        // No session is resumed: each path has a handshake of its own.
        const unsigned flags = GNUTLS_NONBLOCK | GNUTLS_NO_SIGNAL | GNUTLS_NO_TICKETS |
                               (calls_ ? GNUTLS_CLIENT | GNUTLS_FORCE_CLIENT_CERT : GNUTLS_SERVER);
        require(gnutls_init(&made, flags), "a new TLS session");
        session_.reset(made);
        require(gnutls_priority_set(made, tls_->shown_->versions), "choosing TLS");
        require(gnutls_credentials_set(made, GNUTLS_CRD_CERTIFICATE, tls_->shown_->it), "credentials");
        gnutls_session_set_ptr(made, this);
        gnutls_session_set_verify_function(made, [](gnutls_session_t session) {
            return static_cast<TlsChannel*>(gnutls_session_get_ptr(session))->judge();
        });
        if (!calls_)
            gnutls_certificate_server_set_request(
                made, tls_->caller_ == Credentials::Peer::Required ? GNUTLS_CERT_REQUIRE
                      : tls_->caller_ == Credentials::Peer::Asked  ? GNUTLS_CERT_REQUEST
                                                                   : GNUTLS_CERT_IGNORE);
        gnutls_handshake_set_max_packet_length(made, kHandshakeMax);
        gnutls_transport_set_ptr(made, this);
        gnutls_transport_set_pull_function(made, [](gnutls_transport_ptr_t at, void* into, std::size_t size) {
            return static_cast<TlsChannel*>(at)->pull(static_cast<char*>(into), size);
        });
        gnutls_transport_set_pull_timeout_function(made, [](gnutls_transport_ptr_t at, unsigned) {
            return static_cast<TlsChannel*>(at)->in_.empty() ? 0 : 1;
        });
        gnutls_transport_set_push_function(
            made, [](gnutls_transport_ptr_t at, const void* from, std::size_t size) {
                static_cast<TlsChannel*>(at)->out_.append(static_cast<const char*>(from), size);
                return static_cast<ssize_t>(size);
            });
    }

    std::span<char> room(FrameReader&) override {
        if (!read_) read_ = std::make_unique_for_overwrite<char[]>(kReadMax);
        return {read_.get(), kReadMax};
    }

    State filled(FrameReader& frames, std::size_t count) override {
        const std::lock_guard lock(mutex_);
        in_ = {read_.get(), count};
        if (state_ == State::Opening) shakeHands();
        if (state_ == State::Open) read(frames);
        in_ = {};
        return state_;
    }

    std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
        const std::lock_guard lock(mutex_);
        if (state_ != State::Open || !flush()) return std::nullopt;
        if (!out_.empty()) return 0;
        auto taken = std::exchange(owed_, 0);
        Run bytes(pieces);
        bytes.skip(taken);
        while (true) {
            std::size_t sealed = 0;
            while (sealed < kSentAtOnce) {
                const auto count = bytes.take(plain_);
                if (count == 0) break;
                // A record may have to be smaller than GnuTLS was asked for.
                for (std::size_t at = 0; at < count;) {
                    const auto sent = gnutls_record_send(session_.get(), plain_.data() + at, count - at);
                    if (sent <= 0) {
                        fail("the connection was lost");
                        return std::nullopt;
                    }
                    at += static_cast<std::size_t>(sent);
                }
                sealed += count;
            }
            if (sealed == 0) return taken;
            if (!flush()) return std::nullopt;
            if (!out_.empty()) {
                owed_ = sealed;
                return taken;
            }
            taken += sealed;
        }
    }

    std::string why() const override {
        const std::lock_guard lock(mutex_);
        return why_;
    }

  private:
    // Under mutex_, all of them; those which GnuTLS calls are called by what has it.

    ssize_t pull(char* into, std::size_t size) {
        if (in_.empty()) {
            gnutls_transport_set_errno(session_.get(), EAGAIN);
            return -1;
        }
        const auto count = std::min(size, in_.size());
        std::memcpy(into, in_.data(), count);
        in_ = in_.subspan(count);
        return static_cast<ssize_t>(count);
    }

    /// Of the peer's certificate; not 0: refused.
    int judge() noexcept {
        unsigned int count = 0;
        const auto* const list = gnutls_certificate_get_peers(session_.get(), &count);
        std::vector<std::string_view> chain;
        for (unsigned int i = 0; i < count; ++i)
            chain.emplace_back(reinterpret_cast<const char*>(list[i].data), list[i].size);
        if (chain.empty() && !calls_ && tls_->caller_ != Credentials::Peer::Required) return 0;
        const auto verdict = tls_->trust_.judgeDer(chain, tls_->now_());
        if (const auto* refused = std::get_if<std::string>(&verdict)) {
            mistrust_ = *refused;
        } else if (calls_) {
            mistrust_ = certificates::mismatch(std::get<certificates::Certificate>(verdict),
                                               certificates::Kind::Entity, name_);
        }
        return mistrust_.empty() ? 0 : GNUTLS_E_CERTIFICATE_ERROR;
    }

    void shakeHands() {
        int code = 0;
        do {
            code = gnutls_handshake(session_.get());
        } while (isNothing(code) || (code == GNUTLS_E_AGAIN && !in_.empty()));
        if (code < 0 && code != GNUTLS_E_AGAIN) {
            gnutls_alert_send_appropriate(session_.get(), code);
            flush();
            return fail(reasonOf(code));
        }
        // A new connection has room for all that either side says here.
        if (!flush() || !out_.empty()) return fail("the connection was lost");
        if (code >= 0) state_ = State::Open;
    }

    void read(FrameReader& frames) {
        while (true) {
            const auto room = frames.room();
            const auto count = gnutls_record_recv(session_.get(), room.data(), room.size());
            if (count > 0) {
                frames.filled(static_cast<std::size_t>(count));
            } else if (count == 0) {
                return fail("it closed the connection");
            } else if (count == GNUTLS_E_AGAIN) {
                if (in_.empty()) break;  // else it was a message of TLS itself, or an empty record
            } else if (!isNothing(count)) {
                return fail(reasonOf(static_cast<int>(count)));
            }
        }
        // What the socket does not take goes with the next message.
        if (!flush() || out_.size() > kUnsentMax) fail("the connection was lost");
    }

    /// What there is to send, as far as the socket takes it; false: it is over.
    bool flush() {
        std::size_t sent = 0;
        while (sent < out_.size()) {
            const auto piece = std::string_view(out_).substr(sent);
            const auto taken = socket_.write({&piece, 1});
            if (!taken) {
                fail("the connection was lost");
                return false;
            }
            if (*taken == 0) break;
            sent += *taken;
        }
        out_.erase(0, sent);
        return true;
    }

    void fail(std::string why) {
        if (state_ == State::Over) return;
        state_ = State::Over;
        why_ = std::move(why);
        out_.clear();
    }

    std::string reasonOf(int code) const {
        if (!mistrust_.empty())
            return "the certificate " + mistrust_ +
                   (calls_ ? "; fix: axon certs issue --entity NAME, with the CA of IceSSL.CAs" : "");
        if (code == GNUTLS_E_FATAL_ALERT_RECEIVED || code == GNUTLS_E_WARNING_ALERT_RECEIVED) {
            const auto* const name = gnutls_alert_get_name(gnutls_alert_get(session_.get()));
            return std::string("the other side ended TLS: ") + (name != nullptr ? name : "no reason") +
                   (calls_
                        ? "; fix: check this side's certificate (IceSSL.CertFile) with axon certs show, and "
                          "see the log of the Entity Manager"
                        : "");
        }
        if (code == GNUTLS_E_NO_CERTIFICATE_FOUND || code == GNUTLS_E_CERTIFICATE_REQUIRED)
            return "no certificate was shown (axon certs issue makes one)";
        if (state_ == State::Opening)
            return "TLS could not be set up: " + textOf(code) +
                   "; most likely the other side does not speak TLS";
        return "TLS failed: " + textOf(code);
    }

    const std::shared_ptr<const Tls> tls_;
    const bool calls_;
    const std::string name_;  // of the entity that is called
    Wire& socket_;
    mutable std::mutex mutex_;
    // Guarded by mutex_:
    Session session_;
    State state_ = State::Opening;
    std::unique_ptr<char[]> read_;  // but this: of whoever reads
    std::span<const char> in_;      // of it, what GnuTLS has not taken
    std::string out_;               // sealed, for the socket
    std::size_t owed_ = 0;          // bytes of messages in it
    std::array<char, kRecordMax> plain_;
    std::string mistrust_, why_;
};

Tls::Tls(const Credentials& credentials, WallClock now)
    : trust_(credentials.authorities),
      now_(std::move(now)),
      caller_(credentials.caller),
      shown_(Shown::of(credentials)) {}

Tls::~Tls() = default;

std::shared_ptr<const Tls> Tls::of(const Credentials& credentials, WallClock now) {
    return std::shared_ptr<const Tls>(new Tls(credentials, std::move(now)));
}

std::unique_ptr<Channel> Tls::toEntity(std::string name, Wire& socket) const {
    return std::make_unique<TlsChannel>(shared_from_this(), true, std::move(name), socket);
}

std::unique_ptr<Channel> Tls::fromCaller(Wire& socket) const {
    return std::make_unique<TlsChannel>(shared_from_this(), false, std::string(), socket);
}

}  // namespace axon::direct::lane
