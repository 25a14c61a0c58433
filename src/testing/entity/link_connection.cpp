// SPDX-License-Identifier: MIT
#include "testing/entity/link_connection.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <random>
#include <utility>

#include "common/message_frame.hpp"
#include "testing/entity/axon/testing/failure.hpp"

namespace axon::testing {

namespace {

using namespace std::chrono_literals;
using Steady = std::chrono::steady_clock;
constexpr std::uint32_t kProtocol = 1;
constexpr auto kAnswer = 1s;  // to Hello, and to an attempt to connect
constexpr auto kSearchAgain = 20ms;
constexpr auto kBeatMost = 100ms;  // an application notices soon that its manager is back

/// What a port has to offer: a connection that is welcome, or why there is none.
struct Attempt {
    Descriptor socket;
    FrameReader reader;
    std::string why;    ///< empty: nothing listens
    bool ours = false;  ///< it is the application that is looked for
};

int millisecondsUntil(Steady::time_point end) {
    return static_cast<int>(
        std::max<std::int64_t>(std::chrono::ceil<std::chrono::milliseconds>(end - Steady::now()).count(), 0));
}

bool ready(int socket, short what, Steady::time_point end) {
    pollfd wait{socket, what, 0};
    return ::poll(&wait, 1, millisecondsUntil(end)) == 1;
}

Attempt knock(const LinkTarget& target, std::uint16_t port, const proto::EmToEi& hello) {
    Attempt attempt;
    const auto end = Steady::now() + kAnswer;
    Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_port = htons(port);
    inet_pton(AF_INET, target.address.c_str(), &at.sin_addr);
    if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&at), sizeof at) != 0) {
        int error = errno;
        socklen_t size = sizeof error;
        if (error != EINPROGRESS || !ready(socket.get(), POLLOUT, end) ||
            ::getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &error, &size) != 0 || error != 0)
            return attempt;
    }
    const int on = 1;
    ::setsockopt(socket.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    std::string frame;
    appendFrameOf(frame, hello);
    if (::send(socket.get(), frame.data(), frame.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(frame.size()))
        return attempt;
    attempt.why = "another kind of program listens at port " + std::to_string(port);
    proto::EiToEm answer;
    std::string payload;
    while (!attempt.reader.next(payload)) {
        std::array<char, 4096> buffer;
        if (attempt.reader.failed() || !ready(socket.get(), POLLIN, end)) return attempt;
        const auto got = ::recv(socket.get(), buffer.data(), buffer.size(), 0);
        if (got <= 0) return attempt;
        attempt.reader.feed({buffer.data(), static_cast<std::size_t>(got)});
    }
    if (!answer.ParseFromString(payload) || !answer.has_welcome()) return attempt;
    const auto& welcome = answer.welcome();
    if (welcome.refusal().code() == proto::UNKNOWN_ENTITY) {
        attempt.why = "at port " + std::to_string(port) + " is '" + welcome.application() + "'" +
                      (welcome.instance().empty() ? "" : " (" + welcome.instance() + ")");
        return attempt;
    }
    attempt.ours = true;
    attempt.why = welcome.refusal().message();
    if (welcome.refusal().code() == proto::OK) attempt.socket = std::move(socket);
    return attempt;
}

}  // namespace

LinkConnection::LinkConnection(const LinkTarget& target, std::uint32_t generation, Events events,
                               std::chrono::milliseconds within)
    : events_(std::move(events)),
      beat_every_(std::min<std::chrono::milliseconds>(target.watchdog / 5, kBeatMost)),
      generation_(generation) {
    search(target, within);
    beat();
    thread_ = std::thread([this] { run(); });
}

LinkConnection::~LinkConnection() {
    ending_ = true;
    wake_.wake();
    if (thread_.joinable()) thread_.join();
}

void LinkConnection::search(const LinkTarget& target, std::chrono::milliseconds within) {
    proto::EmToEi message;
    auto& hello = *message.mutable_hello();
    hello.set_protocol(kProtocol);
    hello.set_application(target.application);
    hello.set_instance(target.instance);
    hello.set_manager("a test");
    hello.set_watchdog_busy_ms(static_cast<std::uint32_t>(target.watchdog.count()));
    hello.set_watchdog_idle_ms(static_cast<std::uint32_t>(target.watchdog.count()));
    std::random_device random;
    std::string nonce;
    while (nonce.size() < 16) nonce += static_cast<char>(random());
    hello.set_nonce(nonce);

    const auto end = Steady::now() + within;
    std::string found, refused;
    do {
        found.clear();
        for (unsigned port = target.first_port; port <= target.last_port; ++port) {
            hello.set_lane(proto::LANE_SIGNAL);
            auto signal = knock(target, static_cast<std::uint16_t>(port), message);
            if (!signal.ours && !signal.why.empty()) found += (found.empty() ? "" : "; ") + signal.why;
            if (!signal.ours) continue;
            refused = signal.why;
            if (!signal.socket.open()) break;
            hello.set_lane(proto::LANE_DATA);
            auto data = knock(target, static_cast<std::uint16_t>(port), message);
            refused = data.why;
            if (!data.socket.open()) break;
            signal_.socket = std::move(signal.socket);
            signal_.reader = std::move(signal.reader);
            data_.socket = std::move(data.socket);
            data_.reader = std::move(data.reader);
            port_ = static_cast<std::uint16_t>(port);
            return;
        }
        ::poll(nullptr, 0, static_cast<int>(kSearchAgain / 1ms));
    } while (Steady::now() < end);
    const auto ports = target.first_port == target.last_port
                           ? std::to_string(target.first_port)
                           : std::to_string(target.first_port) + "-" + std::to_string(target.last_port);
    const auto expected = "the robot application '" + target.application + "' at " + target.address + ":" +
                          ports + " within " + std::to_string(within.count()) + " ms";
    if (!refused.empty()) throw Failure(Failure::Kind::Refused, expected, "it refused the link: " + refused);
    throw Failure(Failure::Kind::NotInTime, expected, found.empty() ? "nothing listens there" : found);
}

void LinkConnection::setBeating(bool beating) {
    beating_ = beating;
    wake_.wake();
}

void LinkConnection::sendSignal(const proto::EmToEi& message) {
    send(signal_, message);
}
void LinkConnection::sendData(const proto::EmToEi& message) {
    send(data_, message);
}

void LinkConnection::send(Lane& lane, const proto::EmToEi& message) {
    std::string frame;
    if (!appendFrameOf(frame, message))
        throw Failure(Failure::Kind::Misuse, "a message of at most 1 MiB", "this one is larger");
    const std::lock_guard lock(lane.mutex);
    const auto end = Steady::now() + 5s;
    for (std::size_t sent = 0; sent < frame.size();) {
        const auto now = ::send(lane.socket.get(), frame.data() + sent, frame.size() - sent, MSG_NOSIGNAL);
        if (now > 0)
            sent += static_cast<std::size_t>(now);
        else if (now < 0 && errno == EINTR)
            continue;
        else if (now >= 0 || errno != EAGAIN || !ready(lane.socket.get(), POLLOUT, end))
            break;  // the reading thread sees the end of the connection, and why
    }
}

void LinkConnection::beat() {
    proto::EmToEi message;
    message.mutable_beat()->set_sequence(++beats_);
    message.mutable_beat()->set_stop_generation(generation_);
    sendSignal(message);
}

void LinkConnection::run() {
    auto next_beat = Steady::now() + beat_every_;
    // Some may have come together with the Welcome.
    bool reads = handle(data_) && handle(signal_);
    while (!ending_ && reads) {
        std::array<pollfd, 3> wait{pollfd{wake_.fd(), POLLIN, 0}, pollfd{signal_.socket.get(), POLLIN, 0},
                                   pollfd{data_.socket.get(), POLLIN, 0}};
        ::poll(wait.data(), wait.size(), millisecondsUntil(next_beat));
        if (wait[0].revents != 0) wake_.drain();
        // Data first: the last words of an application come after all that it has said.
        if (wait[2].revents != 0) reads = read(data_);
        if (wait[1].revents != 0) reads = read(signal_) && reads;
        if (Steady::now() < next_beat) continue;
        if (beating_) beat();
        next_beat = Steady::now() + beat_every_;
    }
    if (ending_) return;
    closed_ = true;  // what has come is read to its end
    while (read(data_)) {
    }
    while (read(signal_)) {
    }
    ::shutdown(signal_.socket.get(), SHUT_RDWR);
    ::shutdown(data_.socket.get(), SHUT_RDWR);
    events_.closed(last_words_.empty() ? "it closed the link without a word" : last_words_);
}

/// False: nothing more comes.
bool LinkConnection::read(Lane& lane) {
    const auto room = lane.reader.room();
    const auto got = ::recv(lane.socket.get(), room.data(), room.size(), MSG_DONTWAIT);
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) return !closed_;
    if (got <= 0) {
        closed_ = true;
        return false;
    }
    lane.reader.filled(static_cast<std::size_t>(got));
    return handle(lane);
}

/// What has been read. False: nothing more can be understood.
bool LinkConnection::handle(Lane& lane) {
    proto::EiToEm message;
    while (const auto payload = lane.reader.nextView()) {
        if (!message.ParseFromArray(payload->data(), static_cast<int>(payload->size()))) {
            last_words_ = "it sent a message that cannot be read";
            return false;
        }
        if (message.has_end()) last_words_ = message.end().reason();
        if (!message.has_beat()) events_.message(message);
    }
    if (lane.reader.failed()) last_words_ = lane.reader.error();
    return !lane.reader.failed();
}

}  // namespace axon::testing
