// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/ssc32/ssc32_client.hpp"

#include <atomic>

#include "robots/common/stream_thread.hpp"

namespace axon::ssc32 {

class Ssc32Client::Worker final : public ClientSession::Port, public robots::StreamThread::Session {
  public:
    Worker(robots::StreamOpener open, std::vector<std::size_t> channels, Callbacks callbacks,
           Duration silence_limit, std::shared_ptr<const Clock> clock)
        : callbacks_(std::move(callbacks)),
          session_(*this, std::move(channels), silence_limit),
          stream_(std::move(open), *this, "the controller", std::move(clock)) {}

    ~Worker() override { stream_.finish(); }

    void start() { stream_.start(); }
    bool online() const { return online_; }
    bool sendLines(const std::string& lines) { return online_ && write(lines); }
    void askPulses() { pulses_wanted_ = true; }

    // ClientSession::Port, on the stream's thread.
    void send(const std::string& bytes) override { write(bytes); }
    void onOnline(const std::vector<int>& pulses_us) override {
        online_ = true;
        stream_.succeeded();
        if (callbacks_.on_online) callbacks_.on_online(pulses_us);
    }
    void onPulses(const std::vector<int>& pulses_us) override {
        if (callbacks_.on_pulses) callbacks_.on_pulses(pulses_us);
    }
    void onStatus(bool moving) override {
        if (callbacks_.on_status) callbacks_.on_status(moving);
    }
    void onLost(const std::string& reason) override {
        online_ = false;
        if (!stream_.finishing()) unreachable(reason);
    }

    // StreamThread::Session.
    void begin(TimePoint now) override { session_.begin(now); }
    void receive(std::span<const std::uint8_t> bytes, TimePoint now) override {
        session_.receive(bytes, now);
    }
    void tick(TimePoint now) override {
        if (pulses_wanted_.exchange(false)) session_.askPulses();
        session_.tick(now);
    }
    bool closed() const override { return session_.state() == ClientSession::State::Closed; }
    void end(const std::string& reason) override { session_.end(reason); }
    void unreachable(const std::string& reason) override {
        if (callbacks_.on_lost) callbacks_.on_lost(reason);
    }

  private:
    bool write(const std::string& bytes) {
        return stream_.write({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()});
    }

    const Callbacks callbacks_;
    ClientSession session_;  // confined to the stream's thread
    std::atomic<bool> online_ = false;
    std::atomic<bool> pulses_wanted_ = false;
    robots::StreamThread stream_;  // last: its thread uses all of the above
};

Ssc32Client::Ssc32Client(robots::StreamOpener open, std::vector<std::size_t> channels, Callbacks callbacks,
                         Duration silence_limit, std::shared_ptr<const Clock> clock)
    : worker_(std::make_unique<Worker>(std::move(open), std::move(channels), std::move(callbacks),
                                       silence_limit, std::move(clock))) {}
Ssc32Client::~Ssc32Client() = default;
void Ssc32Client::start() {
    worker_->start();
}
bool Ssc32Client::online() const {
    return worker_->online();
}
bool Ssc32Client::send(const std::string& lines) {
    return worker_->sendLines(lines);
}
void Ssc32Client::askPulses() {
    worker_->askPulses();
}

}  // namespace axon::ssc32
