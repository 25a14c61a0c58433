// SPDX-License-Identifier: GPL-2.0-or-later
#include "datagrams/datagram_lane.hpp"

#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <system_error>

#include "datagrams/signal_socket.hpp"

namespace axon::datagrams {
namespace {

using namespace std::chrono_literals;

constexpr int kReadsPerRound = 64;
constexpr int kRefusedInARow = 64;
constexpr Duration kRest = 1ms;
constexpr Duration kLongestWait = 1h;
constexpr int kSignalPriority = 10;    // as the signal lane's other threads
constexpr std::size_t kLongest = 512;  // longer than any datagram of ours

sockaddr_in toSocket(const Endpoint& endpoint) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(endpoint.address);
    address.sin_port = htons(endpoint.port);
    return address;
}

Endpoint fromSocket(const sockaddr_in& address) {
    return {ntohl(address.sin_addr.s_addr), ntohs(address.sin_port)};
}

}  // namespace

DatagramLane::DatagramLane(std::string thread_name, Endpoint bind, const Clock& clock, Received received,
                           Due due)
    : thread_name_(std::move(thread_name)),
      clock_(clock),
      received_(std::move(received)),
      due_(std::move(due)) {
    const auto fail = [&](const char* what) {
        const auto error = errno;
        throw std::system_error(error, std::generic_category(), what + (" " + bind.toString()));
    };
    if (!wake_.open()) fail("eventfd for datagrams at");
    socket_ = Descriptor(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    if (!socket_.open()) fail("socket for datagrams at");
    prepareDatagramSocket(socket_.get());
    auto address = toSocket(bind);
    if (::bind(socket_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
        fail("cannot receive datagrams at");
    socklen_t size = sizeof address;
    if (::getsockname(socket_.get(), reinterpret_cast<sockaddr*>(&address), &size) != 0)
        fail("getsockname of");
    local_ = fromSocket(address);
    thread_ = std::thread([this] { run(); });
}

DatagramLane::~DatagramLane() {
    ending_ = true;
    wake();
    thread_.join();
}

void DatagramLane::send(const Endpoint& to, std::string_view bytes) const {
    const auto address = toSocket(to);
    (void)::sendto(socket_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT | MSG_NOSIGNAL,
                   reinterpret_cast<const sockaddr*>(&address), sizeof address);
}

void DatagramLane::wake() const {
    wake_.wake();
}

void DatagramLane::run() {
    pthread_setname_np(pthread_self(), thread_name_.substr(0, 15).c_str());
    sched_param parameters{};
    parameters.sched_priority = kSignalPriority;
    // Refused where not permitted; the signal lane's communicator says so for all.
    pthread_setschedparam(pthread_self(), SCHED_RR, &parameters);
    while (!ending_) {
        const auto next = due_ ? due_(*this) : TimePoint::max();
        const auto wait = std::clamp<Duration>(clock_.realTimeUntil(next), 0ns, kLongestWait);
        const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(wait);
        const timespec time{static_cast<time_t>(seconds.count()),
                            static_cast<long>((wait - seconds).count())};
        std::array<pollfd, 2> waiting{{{wake_.fd(), POLLIN, 0}, {socket_.get(), POLLIN, 0}}};
        if (::ppoll(waiting.data(), waiting.size(), &time, nullptr) < 0 && errno != EINTR) return;
        wake_.drain();
        for (int i = 0; i < kReadsPerRound && !ending_ && readSome(); ++i) {
        }
        if (refused_in_a_row_ >= kRefusedInARow) {
            refused_in_a_row_ = 0;
            rest(kRest);
        }
    }
}

bool DatagramLane::readSome() {
    std::array<char, kLongest> bytes;
    sockaddr_in from{};
    socklen_t size = sizeof from;
    const auto got = ::recvfrom(socket_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT | MSG_TRUNC,
                                reinterpret_cast<sockaddr*>(&from), &size);
    if (got < 0) return errno != EAGAIN && errno != EWOULDBLOCK;  // an ICMP error of what was sent is no end
    const bool whole = static_cast<std::size_t>(got) <= bytes.size();
    const bool worth =
        received_(*this, fromSocket(from), {bytes.data(), whole ? static_cast<std::size_t>(got) : 0});
    refused_in_a_row_ = worth ? 0 : refused_in_a_row_ + 1;
    return true;
}

/// Datagrams wait meanwhile, or are dropped by the kernel.
void DatagramLane::rest(Duration time) const {
    const timespec rest{0, static_cast<long>(time.count())};
    pollfd waiting{wake_.fd(), POLLIN, 0};
    (void)::ppoll(&waiting, 1, &rest, nullptr);
}

}  // namespace axon::datagrams
