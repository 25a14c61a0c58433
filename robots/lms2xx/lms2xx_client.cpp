// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/lms2xx/lms2xx_client.hpp"

#include "robots/common/stream_thread.hpp"

namespace axon::lms2xx {

class Lms2xxClient::Worker final : public ClientSession::Port, public robots::StreamThread::Session {
  public:
    Worker(robots::StreamOpener open, Callbacks callbacks, Duration silence_limit,
           std::shared_ptr<const Clock> clock)
        : callbacks_(std::move(callbacks)),
          session_(*this, silence_limit),
          stream_(std::move(open), *this, "the laser", std::move(clock)) {}
    ~Worker() override { stream_.finish(); }

    void start() { stream_.start(); }

    // ClientSession::Port, on the stream's thread.
    void send(const Bytes& bytes) override { stream_.write(bytes); }
    bool setSpeed(int baud) override { return stream_.setSpeed(baud); }
    void onOnline(const Setting& setting) override {
        stream_.succeeded();
        if (callbacks_.on_online) callbacks_.on_online(setting);
    }
    void onScan(const Scan& scan) override {
        if (callbacks_.on_scan) callbacks_.on_scan(scan);
    }
    void onLost(const std::string& reason) override {
        if (!stream_.finishing()) unreachable(reason);
    }

    // StreamThread::Session.
    void begin(TimePoint now) override { session_.begin(now, stream_.speed()); }
    void receive(std::span<const std::uint8_t> bytes, TimePoint now) override {
        session_.receive(bytes, now);
    }
    void tick(TimePoint now) override { session_.tick(now); }
    bool closed() const override { return session_.state() == ClientSession::State::Closed; }
    void end(const std::string& reason) override { session_.end(reason); }
    void unreachable(const std::string& reason) override {
        if (callbacks_.on_lost) callbacks_.on_lost(reason);
    }

  private:
    const Callbacks callbacks_;
    ClientSession session_;        // confined to the stream's thread
    robots::StreamThread stream_;  // last: its thread uses all of the above
};

Lms2xxClient::Lms2xxClient(robots::StreamOpener open, Callbacks callbacks, Duration silence_limit,
                           std::shared_ptr<const Clock> clock)
    : worker_(
          std::make_unique<Worker>(std::move(open), std::move(callbacks), silence_limit, std::move(clock))) {}
Lms2xxClient::~Lms2xxClient() = default;
void Lms2xxClient::start() {
    worker_->start();
}

}  // namespace axon::lms2xx
