// SPDX-License-Identifier: GPL-2.0-or-later
#include "channel/stop_measurement.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

#include "common/descriptor.hpp"
#include "datagrams/datagram_lane.hpp"
#include "datagrams/signal_socket.hpp"
#include "datagrams/stop_repeater.hpp"
#include "datagrams/stop_sentry.hpp"

namespace axon::faults {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kStopBytes = 8;          // number of the flow, number of the stop
constexpr std::uint32_t kNoStop = 0xffffffff;  // a heartbeat
constexpr auto kSetUp = 60s;

[[noreturn]] void fail(const std::string& what) {
    throw std::runtime_error(what + ": " + std::strerror(errno));
}

sockaddr_in addressOf(const char* text, std::uint16_t port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    ::inet_pton(AF_INET, text, &address.sin_addr);
    return address;
}

/// As the product does it, or as Ice alone does.
void prepare(int fd, const Sending& sending) {
    const int on = 1;
    ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    if (sending.options) datagrams::prepareSignalSocket(fd);
}

bool readable(int fd, Duration time) {
    pollfd waiting{fd, POLLIN, 0};
    return ::poll(&waiting, 1, static_cast<int>(time / 1ms)) == 1;
}

/// When each stop was sent and when it first arrived, by whichever way.
class Ledger {
  public:
    Ledger(std::size_t flows, std::size_t per_flow)
        : per_flow_(per_flow), sent_(flows * per_flow), arrived_(flows * per_flow) {}
    void sent(std::size_t flow, std::size_t stop, TimePoint at) {
        sent_[flow * per_flow_ + stop] = at.time_since_epoch().count();
    }
    void arrived(std::size_t flow, std::size_t stop, TimePoint at) {
        if (flow * per_flow_ + stop >= arrived_.size() || stop >= per_flow_) return;
        std::int64_t none = 0;
        if (arrived_[flow * per_flow_ + stop].compare_exchange_strong(none, at.time_since_epoch().count()))
            ++count_;
    }
    std::size_t count() const { return count_; }
    std::vector<double> milliseconds() const {
        std::vector<double> all;
        for (std::size_t i = 0; i < sent_.size(); ++i)
            all.push_back(arrived_[i] == 0 ? std::numeric_limits<double>::infinity()
                                           : static_cast<double>(arrived_[i] - sent_[i]) / 1e6);
        std::sort(all.begin(), all.end());
        return all;
    }

  private:
    const std::size_t per_flow_;
    std::vector<std::atomic<std::int64_t>> sent_, arrived_;
    std::atomic<std::size_t> count_{0};
};

struct Connections {
    std::vector<Descriptor> left, right;  // by the number of the flow
};

Connections connectAll(const TwoSides& sides, const Sending& sending, std::size_t flows) {
    sides.enter(Side::Right);
    const Descriptor listening(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    auto at = addressOf(TwoSides::kRight, 0);
    socklen_t size = sizeof at;
    if (::bind(listening.get(), reinterpret_cast<sockaddr*>(&at), sizeof at) != 0 ||
        ::listen(listening.get(), 1024) != 0 ||
        ::getsockname(listening.get(), reinterpret_cast<sockaddr*>(&at), &size) != 0)
        fail("listening on the right side");
    Connections connections;
    sides.enter(Side::Left);
    for (std::size_t flow = 0; flow < flows; ++flow) {
        Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
        if (::connect(socket.get(), reinterpret_cast<sockaddr*>(&at), sizeof at) != 0 && errno != EINPROGRESS)
            fail("connecting to the right side");
        connections.left.push_back(std::move(socket));
    }
    const auto deadline = std::chrono::steady_clock::now() + kSetUp;
    for (auto& socket : connections.left) {
        pollfd waiting{socket.get(), POLLOUT, 0};
        int error = 0;
        socklen_t error_size = sizeof error;
        const auto left = std::max<Duration>(deadline - std::chrono::steady_clock::now(), 0ns);
        if (::poll(&waiting, 1, static_cast<int>(left / 1ms)) != 1 ||
            ::getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &error, &error_size) != 0 || error != 0)
            fail("a connection over the channel was not made within " + std::to_string(kSetUp / 1s) + " s");
        prepare(socket.get(), sending);
        const auto number = static_cast<std::uint32_t>(&socket - connections.left.data());
        (void)!::send(socket.get(), &number, sizeof number, MSG_NOSIGNAL);
    }
    connections.right.resize(flows);
    for (std::size_t i = 0; i < flows; ++i) {
        if (!readable(listening.get(), kSetUp)) fail("a connection over the channel was not accepted");
        Descriptor socket(::accept4(listening.get(), nullptr, nullptr, SOCK_CLOEXEC));
        prepare(socket.get(), sending);
        std::uint32_t number = 0;
        if (!readable(socket.get(), kSetUp) ||
            ::recv(socket.get(), &number, sizeof number, MSG_WAITALL) != sizeof number || number >= flows)
            fail("a connection over the channel did not say which it is");
        connections.right[number] = std::move(socket);
    }
    return connections;
}

/// Reads the right ends of all connections.
class TcpReceiver {
  public:
    TcpReceiver(const std::vector<Descriptor>& sockets, Ledger& ledger) : sockets_(sockets), ledger_(ledger) {
        thread_ = std::thread([this] { run(); });
    }
    ~TcpReceiver() {
        ending_ = true;
        thread_.join();
    }

  private:
    void run() {
        const SteadyClock clock{};
        std::vector<std::string> pending(sockets_.size());
        std::vector<pollfd> waiting;
        for (const auto& socket : sockets_) waiting.push_back({socket.get(), POLLIN, 0});
        while (!ending_) {
            if (::poll(waiting.data(), waiting.size(), 50) <= 0) continue;
            const auto now = clock.now();
            for (std::size_t i = 0; i < waiting.size(); ++i) {
                if (waiting[i].revents == 0) continue;
                char bytes[512];
                const auto got = ::recv(waiting[i].fd, bytes, sizeof bytes, MSG_DONTWAIT);
                if (got <= 0) {
                    if (got == 0) waiting[i].fd = -1;
                    continue;
                }
                pending[i].append(bytes, static_cast<std::size_t>(got));
                while (pending[i].size() >= kStopBytes) {
                    std::uint32_t numbers[2];
                    std::memcpy(numbers, pending[i].data(), sizeof numbers);
                    pending[i].erase(0, kStopBytes);
                    if (numbers[0] != kNoStop) ledger_.arrived(numbers[0], numbers[1], now);
                }
            }
        }
    }
    const std::vector<Descriptor>& sockets_;
    Ledger& ledger_;
    std::atomic<bool> ending_{false};
    std::thread thread_;
};

/// The product's own pieces on either side: one lease for each flow.
class Datagrams {
  public:
    Datagrams(const TwoSides& sides, std::size_t flows, Ledger& ledger, RandomSource& random)
        : sentries_(flows), ledger_(ledger), repeater_(clock_) {
        const Sender sender{Id128::uuid(random).toString(), "client1", Role::Operator};
        sides.enter(Side::Right);
        right_ = std::make_unique<datagrams::DatagramLane>(
            "right", datagrams::Endpoint{*datagrams::parseAddress(TwoSides::kRight), 0}, clock_,
            [this](const datagrams::DatagramLane& lane, const datagrams::Endpoint& from,
                   std::string_view bytes) { return received(lane, from, bytes); },
            nullptr);
        sides.enter(Side::Left);
        for (std::size_t flow = 0; flow < flows; ++flow) {
            const LeaseNumber lease{1, static_cast<std::int32_t>(flow) + 1};
            const auto key = Id128::random(random).bytes();
            sentries_[flow].hold(lease, key, sender);
            repeater_.admit(std::to_string(flow), {right_->local(), lease, key, *Id128::parse(sender.id)});
        }
        left_ = std::make_unique<datagrams::DatagramLane>(
            "left", datagrams::Endpoint{*datagrams::parseAddress(TwoSides::kLeft), 0}, clock_,
            [this](const datagrams::DatagramLane&, const datagrams::Endpoint& from, std::string_view bytes) {
                const std::lock_guard lock(mutex_);
                return repeater_.onDatagram(from, bytes).has_value();
            },
            [this](const datagrams::DatagramLane& lane) {
                const std::lock_guard lock(mutex_);
                repeater_.onTimer();
                send(lane);
                return repeater_.nextDeadline();
            });
    }
    void stop(std::size_t flow, std::size_t stop) {
        {
            const std::lock_guard lock(mutex_);
            repeater_.stop(std::to_string(flow), static_cast<std::int64_t>(stop) + 1, 0);
            send(*left_);
        }
        left_->wake();
    }
    std::size_t copies() const { return copies_; }

  private:
    void send(const datagrams::DatagramLane& lane) {
        for (const auto& out : repeater_.take()) {
            ++copies_;
            lane.send(out.to, {out.bytes.data(), out.bytes.size()});
        }
    }
    bool received(const datagrams::DatagramLane& lane, const datagrams::Endpoint& from,
                  std::string_view bytes) {
        const auto lease = datagrams::leaseOf(bytes);
        if (!lease || static_cast<std::size_t>(lease->number) > sentries_.size()) return false;
        const auto flow = static_cast<std::size_t>(lease->number) - 1;
        const auto judged = sentries_[flow].judge(bytes);
        if (judged.verdict == datagrams::StopSentry::Verdict::Refused) return false;
        ledger_.arrived(flow, static_cast<std::size_t>(judged.datagram.sequence) - 1, clock_.now());
        auto ack = judged.datagram;
        ack.kind = datagrams::StopDatagram::Kind::Ack;
        const auto answer = datagrams::encode(ack, judged.key);
        lane.send(from, {answer.data(), answer.size()});
        return true;
    }

    const SteadyClock clock_{};
    std::vector<datagrams::StopSentry> sentries_;
    Ledger& ledger_;
    std::mutex mutex_;
    datagrams::StopRepeater repeater_;  // guarded by mutex_
    std::atomic<std::size_t> copies_{0};
    std::unique_ptr<datagrams::DatagramLane> right_, left_;
};

double percentile(const std::vector<double>& sorted, double share) {
    const auto rank = static_cast<std::size_t>(std::ceil(share * static_cast<double>(sorted.size())));
    return sorted[std::clamp<std::size_t>(rank, 1, sorted.size()) - 1];
}

}  // namespace

Figures measureStops(const TwoSides& sides, const Sending& sending, const Workload& workload,
                     std::uint64_t seed) {
    const auto per_flow = (workload.stops + workload.flows - 1) / workload.flows;
    const auto total = per_flow * workload.flows;
    Ledger ledger(workload.flows, per_flow);
    SeededRandom random(seed);
    const auto connections = connectAll(sides, sending, workload.flows);
    const TcpReceiver receiver(connections.right, ledger);
    std::unique_ptr<Datagrams> datagrams;
    if (sending.datagrams) datagrams = std::make_unique<Datagrams>(sides, workload.flows, ledger, random);

    for (std::size_t i = 0; i < workload.heartbeats; ++i) {
        const std::uint32_t nobodys[2] = {kNoStop, kNoStop};
        for (const auto& socket : connections.left)
            (void)!::send(socket.get(), nobodys, sizeof nobodys, MSG_NOSIGNAL | MSG_DONTWAIT);
        std::this_thread::sleep_for(workload.heartbeat);
    }

    struct Due {
        Duration at;
        std::uint32_t flow, stop;
    };
    std::vector<Due> plan;
    for (std::uint32_t flow = 0; flow < workload.flows; ++flow) {
        Duration at{};
        for (std::uint32_t stop = 0; stop < per_flow; ++stop) {
            const double fraction = static_cast<double>(random.next() >> 11U) * 0x1.0p-53;
            at += std::chrono::duration_cast<Duration>(workload.pause *
                                                       (stop == 0 ? fraction : 0.5 + fraction));
            plan.push_back({at, flow, stop});
        }
    }
    std::sort(plan.begin(), plan.end(), [](const Due& a, const Due& b) { return a.at < b.at; });

    const SteadyClock clock{};
    const auto begin = clock.now();
    for (const auto& due : plan) {
        std::this_thread::sleep_until(begin + due.at);
        const std::uint32_t numbers[2] = {due.flow, due.stop};
        ledger.sent(due.flow, due.stop, clock.now());
        (void)!::send(connections.left[due.flow].get(), numbers, sizeof numbers, MSG_NOSIGNAL | MSG_DONTWAIT);
        if (datagrams) datagrams->stop(due.flow, due.stop);
    }
    const auto end = clock.now() + workload.patience;
    while (ledger.count() < total && clock.now() < end) std::this_thread::sleep_for(5ms);

    const auto all = ledger.milliseconds();
    Figures figures;
    figures.n = total;
    figures.never = total - ledger.count();
    figures.p50_ms = percentile(all, 0.5);
    figures.p99_ms = percentile(all, 0.99);
    figures.max_ms = all.back();
    figures.copies = datagrams ? static_cast<double>(datagrams->copies()) / static_cast<double>(total) : 0;
    return figures;
}

}  // namespace axon::faults
