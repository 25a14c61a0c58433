// SPDX-License-Identifier: MIT
#include "entity_interfacer/handshakes.hpp"

#include <arpa/inet.h>
#include <axon/link.pb.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "common/message_frame.hpp"
#include "common/release.hpp"
#include "entity_interfacer/axon/entity_interfacer.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;

constexpr auto kHelloTime = 1s;
constexpr auto kOutOfDescriptors = 100ms;

std::chrono::milliseconds watchdogFrom(std::uint32_t ms, std::chrono::milliseconds usual) {
    if (ms == 0) return usual;
    return std::clamp(std::chrono::milliseconds{ms}, 20ms, 10000ms);
}

}  // namespace

std::uint16_t Handshakes::listen(const LinkPorts& where) {
    users_ = where.users;
    for (unsigned port = where.ports.first; port <= where.ports.last; ++port) {
        Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
        const int on = 1;
        ::setsockopt(socket.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);  // TIME_WAIT of a former run
        sockaddr_in at{};
        at.sin_family = AF_INET;
        at.sin_port = htons(static_cast<std::uint16_t>(port));
        inet_pton(AF_INET, where.address.c_str(), &at.sin_addr);
        if (::bind(socket.get(), reinterpret_cast<const sockaddr*>(&at), sizeof at) == 0 &&
            ::listen(socket.get(), 128) == 0) {
            listener_ = std::move(socket);
            return static_cast<std::uint16_t>(port);
        }
        if (errno != EADDRINUSE)
            throw Misconfiguration(
                "axon: cannot listen on " + where.address + ":" + std::to_string(port) + ": " +
                std::strerror(errno) +
                "; expected an address of this machine; fix: correct Axon.Address or Options::address");
    }
    throw Misconfiguration("axon: every port of " + std::to_string(where.ports.first) + "-" +
                           std::to_string(where.ports.last) + " on " + where.address +
                           " is in use; expected a free one; fix: widen the range in ports.cfg of both the "
                           "application and its Entity Manager");
}

TimePoint Handshakes::awaitAt(TimePoint now, std::vector<pollfd>& wait) const {
    const bool listening = accept_again_ <= now;
    wait.push_back({listening ? listener_.get() : -1, POLLIN, 0});
    auto due = listening ? TimePoint::max() : accept_again_;
    for (const auto& pending : pending_) {
        wait.push_back({pending.socket.get(), POLLIN, 0});
        due = std::min(due, pending.deadline);
    }
    return due;
}

bool Handshakes::handle(std::span<const pollfd> waited) {
    const auto polled = pending_.size();
    std::vector<bool> forget(polled, false);
    for (std::size_t i = 0; i < polled; ++i) {
        if (waited[i + 1].revents != 0) forget[i] = readHello(pending_[i]);
        if (pending_[i].deadline <= clock_.now()) forget[i] = true;
    }
    for (std::size_t i = polled; i-- > 0;)
        if (forget[i]) pending_.erase(pending_.begin() + static_cast<std::ptrdiff_t>(i));
    return waited[0].revents != 0 && accept();
}

void Handshakes::close() {
    pending_.clear();
    listener_.reset();
}

bool Handshakes::accept() {
    for (int burst = 0; burst < 64; ++burst) {
        Descriptor socket(::accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
        if (!socket.open()) {
            // The connection stays in the backlog, so that polling at once would spin.
            if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM)
                accept_again_ = clock_.now() + kOutOfDescriptors;
            return false;
        }
        const int on = 1;
        ::setsockopt(socket.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
        if (pending_.size() >= kMax) {
            // A half-linked Entity Manager is worth more than a stranger that has said nothing yet.
            auto oldest = std::find_if(pending_.begin(), pending_.end(),
                                       [](const Pending& p) { return p.nonce.empty(); });
            if (oldest == pending_.end()) return false;
            pending_.erase(oldest);
        }
        pending_.emplace_back();
        pending_.back().socket = std::move(socket);
        pending_.back().deadline = clock_.now() + kHelloTime;
        if (readHello(pending_.back())) pending_.pop_back();  // its Hello is usually here already
    }
    return true;
}

bool Handshakes::readHello(Pending& pending) {
    std::array<char, kHelloMax> buffer;
    const auto got = ::recv(pending.socket.get(), buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (got == 0) return true;
    if (got < 0) return errno != EAGAIN && errno != EINTR;
    if (!pending.nonce.empty()) return true;  // nothing may be sent before both lanes are welcome
    pending.reader.feed({buffer.data(), static_cast<std::size_t>(got)});
    std::string payload;
    if (!pending.reader.next(payload)) {
        if (!pending.reader.failed()) return false;
        refuse(pending, RefusalCode::Malformed, "first frame: " + pending.reader.error());
        return true;
    }
    proto::EmToEi message;
    if (!message.ParseFromString(payload) || !message.has_hello()) {
        refuse(pending, RefusalCode::Malformed,
               "expected Hello as the first frame; fix: see docs/reference/ei-link.md");
        return true;
    }
    return onHello(pending, message.hello());
}

bool Handshakes::onHello(Pending& pending, const proto::Hello& hello) {
    const auto no = [&](RefusalCode code, const std::string& message) {
        refuse(pending, code, message);
        return true;
    };
    if (hello.protocol() != kProtocol)
        return no(RefusalCode::NotSupported,
                  "protocol " + std::to_string(hello.protocol()) +
                      (isRelease(hello.release()) ? " of release " + hello.release() : "") + ": expected " +
                      std::to_string(kProtocol) + "; fix: use an Entity Manager of this version (" +
                      kRelease + ")");
    if (hello.application() != application_)
        return no(RefusalCode::UnknownEntity,
                  "this is the robot application '" + application_ +
                      "'; fix: correct the application's name in the Entity Manager's configuration, unless "
                      "its application listens on another port");
    if (!hello.instance().empty() && hello.instance() != instance_)
        return no(RefusalCode::UnknownEntity,
                  "this is instance '" + instance_ + "' of '" + application_ + "'");
    if (const auto stranger = users_.check(pending.socket.get()))
        return no(stranger->code, stranger->message);
    // Who links with us takes it that we have stopped.
    if (others_.stopFailed())
        return no(RefusalCode::WrongState, "the stop callback of '" + application_ +
                                               "' throws and is called again until it returns; fix: repair "
                                               "what it stops, or restart the application");
    if (hello.nonce().size() < 8 || hello.nonce().size() > 64)
        return no(RefusalCode::Malformed, "nonce: expected 8 to 64 bytes, the same on both connections");
    if (const auto manager = others_.linkedWith())
        return no(RefusalCode::AlreadyHeld, "'" + application_ + "' is linked with another Entity Manager (" +
                                                *manager + "); fix: end that one first");
    const auto half =
        std::find_if(pending_.begin(), pending_.end(), [](const Pending& p) { return !p.nonce.empty(); });
    if (hello.lane() == proto::LANE_SIGNAL) {
        if (half != pending_.end())
            return no(RefusalCode::AlreadyHeld, "another Entity Manager (" + half->manager +
                                                    ") is linking with '" + application_ + "'");
        pending.nonce = hello.nonce();
        pending.manager = hello.manager();
        pending.release = hello.release();
        pending.busy = watchdogFrom(hello.watchdog_busy_ms(), 250ms);
        pending.idle = watchdogFrom(hello.watchdog_idle_ms(), 500ms);
        welcome(pending, hello, nullptr);
        return false;
    }
    if (hello.lane() != proto::LANE_DATA)
        return no(RefusalCode::Malformed, "lane: expected LANE_SIGNAL or LANE_DATA");
    if (half == pending_.end()) return no(RefusalCode::WrongState, "expected the signal connection first");
    if (half->nonce != hello.nonce())
        return no(RefusalCode::AlreadyHeld,
                  "another Entity Manager (" + half->manager + ") is linking with '" + application_ + "'");
    welcome(pending, hello, nullptr);
    others_.linkWith({std::move(half->socket), std::move(half->reader), std::move(pending.socket),
                      std::move(pending.reader), half->manager, half->release, half->busy, half->idle});
    // The half itself goes at its deadline; without a nonce it reserves nothing, without a socket it reads
    // nothing.
    half->nonce.clear();
    half->deadline = clock_.now();
    return true;
}

void Handshakes::refuse(Pending& pending, RefusalCode code, const std::string& message) {
    proto::Refusal refusal;
    refusal.set_code(static_cast<proto::RefusalCode>(code));
    refusal.set_message(message);
    welcome(pending, proto::Hello{}, &refusal);
}

void Handshakes::welcome(Pending& pending, const proto::Hello& hello, const proto::Refusal* refusal) {
    proto::EiToEm message;
    auto& welcome = *message.mutable_welcome();
    welcome.set_protocol(kProtocol);
    welcome.set_application(application_);
    welcome.set_instance(instance_);
    welcome.set_lane(hello.lane());
    welcome.set_nonce(hello.nonce());
    welcome.set_release(kRelease);
    if (refusal != nullptr) *welcome.mutable_refusal() = *refusal;
    std::string frame;
    appendFrameOf(frame, message);
    [[maybe_unused]] const auto sent =
        ::send(pending.socket.get(), frame.data(), frame.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
}

}  // namespace axon
