// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/arcos_client.hpp"

#include <atomic>
#include <cmath>
#include <mutex>
#include <optional>
#include <utility>

#include "robots/common/stream_thread.hpp"

namespace axon::arcos {

class ArcosClient::Worker final : public ClientSession::Port, public robots::StreamThread::Session {
  public:
    Worker(robots::StreamOpener open, Callbacks callbacks, Duration silence_limit,
           std::shared_ptr<const Clock> clock)
        : callbacks_(std::move(callbacks)),
          session_(*this, silence_limit),
          stream_(std::move(open), *this, "the robot", std::move(clock)) {}

    ~Worker() override { finish(); }

    void finish() {
        if (finished_.exchange(true)) return;
        command(encodeCommand(Command::EStop));
        command(encodeCommand(Command::Close));
        stream_.finish();
    }

    void start() { stream_.start(); }

    RobotState state() const {
        const std::lock_guard lock(state_mutex_);
        return state_;
    }

    bool command(const Bytes& bytes) { return online_ && stream_.write(bytes); }

    void newScan(LaserScan scan) {
        const std::lock_guard lock(scan_mutex_);
        scan_ = std::move(scan);
    }

    // ClientSession::Port, on the stream's thread.
    void send(const Bytes& bytes) override { stream_.write(bytes); }
    bool setSpeed(int baud) override { return stream_.setSpeed(baud); }

    void onOnline(const RobotIdentity& identity) override {
        online_ = true;
        stream_.succeeded();
        publish(session_.robot());
        if (callbacks_.on_online) callbacks_.on_online(identity);
    }

    void onState(const RobotState& state) override {
        publish(state);
        if (callbacks_.on_state) callbacks_.on_state(state);
    }

    void onLost(const std::string& reason) override {
        online_ = false;
        publish(session_.robot());
        unreachable(reason);
    }

    // StreamThread::Session.
    void begin(TimePoint now) override { session_.begin(now, stream_.speed()); }
    void receive(std::span<const std::uint8_t> bytes, TimePoint now) override {
        if (auto scan = takeScan()) session_.newScan(*std::move(scan));
        session_.receive(bytes, now);
    }
    void tick(TimePoint now) override { session_.tick(now); }
    bool closed() const override { return session_.state() == ClientSession::State::Closed; }
    void end(const std::string& reason) override { session_.end(reason); }
    void unreachable(const std::string& reason) override {
        if (callbacks_.on_lost) callbacks_.on_lost(reason);
    }

  private:
    std::optional<LaserScan> takeScan() {
        const std::lock_guard lock(scan_mutex_);
        return std::exchange(scan_, std::nullopt);
    }

    void publish(const RobotState& state) {
        const std::lock_guard lock(state_mutex_);
        state_ = state;
    }

    const Callbacks callbacks_;
    ClientSession session_;  // confined to the stream's thread

    std::atomic<bool> finished_ = false;
    std::atomic<bool> online_ = false;

    mutable std::mutex state_mutex_;
    RobotState state_;  // guarded by state_mutex_

    std::mutex scan_mutex_;
    std::optional<LaserScan> scan_;  // guarded by scan_mutex_: the newest that the session has not got yet

    robots::StreamThread stream_;  // last: its thread uses all of the above
};

ArcosClient::ArcosClient(robots::StreamOpener open, Callbacks callbacks, Duration silence_limit,
                         std::shared_ptr<const Clock> clock)
    : worker_(
          std::make_unique<Worker>(std::move(open), std::move(callbacks), silence_limit, std::move(clock))) {}
ArcosClient::~ArcosClient() = default;
void ArcosClient::start() {
    worker_->start();
}

void ArcosClient::finish() {
    worker_->finish();
}

RobotState ArcosClient::state() const {
    return worker_->state();
}
bool ArcosClient::command(Command command) {
    return worker_->command(encodeCommand(command));
}
bool ArcosClient::command(Command command, int argument) {
    return worker_->command(encodeCommand(command, argument));
}
bool ArcosClient::command(Command command, std::string_view text) {
    return worker_->command(encodeCommand(command, text));
}

void ArcosClient::newScan(LaserScan scan) {
    worker_->newScan(std::move(scan));
}

bool ArcosClient::drive(double forward_mm_s, double left_deg_s) {
    auto bytes = encodeCommand(Command::Vel, static_cast<int>(std::lround(forward_mm_s)));
    const auto rotation = encodeCommand(Command::RVel, static_cast<int>(std::lround(left_deg_s)));
    bytes.insert(bytes.end(), rotation.begin(), rotation.end());
    return worker_->command(bytes);
}

bool ArcosClient::stop() {
    return worker_->command(encodeCommand(Command::EStop));
}

}  // namespace axon::arcos
