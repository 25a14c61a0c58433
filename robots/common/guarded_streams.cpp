// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/guarded_streams.hpp"

#include <mutex>
#include <utility>
#include <vector>

namespace axon::robots {
namespace {

constexpr int kDrain = 64;  // reads, of a device that does not stop sending

class GuardedStream final : public ByteStream {
  public:
    GuardedStream(std::unique_ptr<ByteStream> stream, std::shared_ptr<DeviceGuard> guard,
                  const std::string& stop)
        : stream_(std::move(stream)), guard_(std::move(guard)), stop_(stop.begin(), stop.end()) {}
    ~GuardedStream() override {
        // What was to be the last order may have found no room.
        if (failed_ && !given_up_) stream_->write(stop_);
        guard_->release();
    }
    GuardedStream(const GuardedStream&) = delete;
    GuardedStream& operator=(const GuardedStream&) = delete;

    int descriptor() const override { return stream_->descriptor(); }
    int read(std::span<std::uint8_t> into) override {
        if (guard_->beat()) return stream_->read(into);
        // A guard that is gone has stopped nothing; one that is there may have met half an order of this
        // process.
        const std::lock_guard lock(writing_);
        if (!std::exchange(given_up_, true)) {
            stream_->write(stop_);
            // A connection that is closed with something unread is reset, and may lose what was written last.
            for (int i = 0; i < kDrain && stream_->read(into) > 0; ++i) continue;
        }
        return -1;
    }
    bool write(std::span<const std::uint8_t> bytes) override {
        const std::lock_guard lock(writing_);
        if (given_up_ || guard_->stopped()) return false;
        failed_ = !stream_->write(bytes);
        return !failed_;
    }
    LineSpeed speed() const override { return stream_->speed(); }
    bool setSpeed(int baud) override { return stream_->setSpeed(baud); }

  private:
    const std::unique_ptr<ByteStream> stream_;
    const std::shared_ptr<DeviceGuard> guard_;
    const std::vector<std::uint8_t> stop_;
    std::mutex writing_;     // read() writes as well; held for one write, which does not wait
    bool failed_ = false;    // guarded by writing_; the last order was not taken
    bool given_up_ = false;  // guarded by writing_; no order of another thread may follow the stop
};

}  // namespace

StreamOpener guardedStreams(StreamOpener open, DeviceGuard::Options options) {
    auto stop = options.stop;
    auto guard = std::make_shared<DeviceGuard>(std::move(options));
    return [open = std::move(open), guard = std::move(guard),
            stop = std::move(stop)](Duration timeout) -> Result<std::unique_ptr<ByteStream>> {
        auto opened = open(timeout);
        if (!opened) return opened;
        auto stream = std::move(opened).value();
        if (!guard->watch(stream->descriptor()))
            return Refusal{RefusalCode::Overloaded,
                           "the robot is not driven without its guard, and that cannot be started",
                           {}};
        return std::unique_ptr<ByteStream>(std::make_unique<GuardedStream>(std::move(stream), guard, stop));
    };
}

}  // namespace axon::robots
