// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <array>
#include <cerrno>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>

#include "common/descriptor.hpp"
#include "common/frame.hpp"
#include "common/refusal.hpp"
#include "direct/lane/frames.hpp"
#include "direct/lane/opening.hpp"
#include "direct/lane/tls_channel.hpp"
#include "direct/proof.hpp"
#include "support/tcp_silence.hpp"

namespace axon::test {

/// Somebody at the data port of an Entity Manager's direct paths, who says what a test wants, over TLS where
/// it is given that. Threads: the test's, which waits up to 5 s for an answer.
class LaneStranger {
  public:
    /// `name`: of the entity whose certificate is expected.
    explicit LaneStranger(const std::string& endpoint, const direct::lane::Tls* tls = nullptr,
                          const std::string& name = {}) {
        const auto colon = endpoint.rfind(':');
        sockaddr_in to{};
        to.sin_family = AF_INET;
        to.sin_port = htons(static_cast<std::uint16_t>(std::stoi(endpoint.substr(colon + 1))));
        ::inet_pton(AF_INET, endpoint.substr(0, colon).c_str(), &to.sin_addr);
        const timeval patience{5, 0};
        ::setsockopt(socket_.get(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
        if (::connect(socket_.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0)
            throw std::runtime_error("LaneStranger: nobody listens at " + endpoint);
        channel_ =
            tls != nullptr ? tls->toEntity(name, wire_) : std::make_unique<direct::lane::PlainChannel>(wire_);
        channel_state_ = channel_->filled(reader_, 0);
        while (channel_state_ == direct::lane::Channel::State::Opening && receive()) {
        }
    }
    LaneStranger(const LaneStranger&) = delete;
    LaneStranger& operator=(const LaneStranger&) = delete;
    /// The handshake is done, where there is one.
    bool channelOpen() const { return channel_state_ == direct::lane::Channel::State::Open; }

    direct::Claim claim{};
    std::string proof;  ///< of the Entity Manager, after open()
    std::string text;   ///< of its refusal

    /// The nonce that this connection was given; it is in the claim from then on.
    Id128 awaitNonce() {
        const auto greeting = awaitFrame();
        if (greeting && greeting->size() == 21) claim.nonce = Id128::fromBytes(greeting->substr(5)).value();
        return claim.nonce;
    }
    /// The claim, proved with this key, for the nonce in the claim. How it is refused; Ok when it is not.
    RefusalCode open(const std::string& key) {
        say(claimFrame(direct::proofOf(claim, direct::Prover::Client, key)));
        return awaitAnswer();
    }
    std::string claimFrame(const std::string& its_proof) const {
        std::string content;
        for (const auto number : {direct::lane::kContract, static_cast<std::uint32_t>(claim.lease.epoch),
                                  static_cast<std::uint32_t>(claim.lease.number)})
            for (const unsigned shift : {24U, 16U, 8U, 0U})
                content += static_cast<char>(number >> shift & 0xFFU);
        content += claim.client.bytes() + claim.path.bytes() + its_proof;
        return direct::lane::frameOf(direct::lane::Kind::Claim, content);
    }
    /// Internal where the connection is closed instead.
    RefusalCode awaitAnswer() {
        const auto answer = awaitFrame();
        if (!answer) return RefusalCode::Internal;
        if (answer->front() == static_cast<char>(direct::lane::Kind::Proof)) {
            proof = answer->substr(1);
            return RefusalCode::Ok;
        }
        direct::lane::Fields fields(*answer);
        fields.number(1);
        const auto code = static_cast<RefusalCode>(fields.number(4));
        text = fields.rest();
        return code;
    }
    void send(direct::Keeping keeping, const Header& head, const std::string& content) {
        const auto bytes = direct::lane::headOf(keeping, head, content.size());
        if (bytes) say(std::string(bytes->view()) + content);
    }
    void say(const std::string& bytes) {
        for (std::string_view left(bytes); !left.empty();) {
            const auto taken = channel_->write({&left, 1});
            if (!taken) return;  // it is closed, which the test asks for
            left.remove_prefix(*taken);
        }
    }
    /// Under TLS, not by it.
    void sayInClear(std::string_view bytes) { static_cast<void>(wire_.write({&bytes, 1})); }
    /// Nothing where the connection is closed, or nothing comes.
    std::optional<std::string> awaitFrame() {
        std::string frame;
        while (!reader_.next(frame))
            if (!receive()) return std::nullopt;
        return frame;
    }
    /// Says no more; the other side then closes the connection when it has read everything.
    void finish() { ::shutdown(socket_.get(), SHUT_WR); }
    /// Of this end, "a.b.c.d:port".
    std::string address() const { return endpointOf(socket_.get(), ::getsockname); }
    /// Without an end of the connection. Whether that could be done.
    bool fallSilent() { return deafen(socket_.get()); }
    /// Whether the other side has closed the connection by now; what it has said is forgotten.
    bool isClosed() {
        std::array<char, 4096> bytes{};
        ssize_t came = 1;
        while (came > 0) came = ::recv(socket_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT);
        return came == 0 || errno == ECONNRESET;
    }
    /// Reads until the other side has closed the connection.
    bool awaitClosed() {
        while (awaitFrame()) {
        }
        return closed_;
    }

  private:
    struct Socket final : direct::lane::Wire {
        explicit Socket(const Descriptor& its_socket) : socket(its_socket) {}
        std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
            std::size_t all = 0;
            for (auto piece : pieces) {
                all += piece.size();
                while (!piece.empty()) {
                    const auto sent = ::send(socket.get(), piece.data(), piece.size(), MSG_NOSIGNAL);
                    if (sent <= 0) return std::nullopt;
                    piece.remove_prefix(static_cast<std::size_t>(sent));
                }
            }
            return all;
        }
        const Descriptor& socket;
    };
    bool receive() {
        const auto room = channel_->room(reader_);
        const auto came = ::recv(socket_.get(), room.data(), room.size(), 0);
        closed_ = came == 0 || (came < 0 && errno == ECONNRESET);
        if (came > 0) channel_state_ = channel_->filled(reader_, static_cast<std::size_t>(came));
        return came > 0;
    }

    Descriptor socket_{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
    Socket wire_{socket_};
    FrameReader reader_{direct::lane::kMessageFrameMax};
    std::unique_ptr<direct::lane::Channel> channel_;
    direct::lane::Channel::State channel_state_ = direct::lane::Channel::State::Opening;
    bool closed_ = false;
};

}  // namespace axon::test
