// SPDX-License-Identifier: GPL-2.0-or-later
// What comes over a laser's serial line, at either end: however the bytes are cut, the same telegrams are
// found; what is understood of them survives writing and reading; the virtual laser and the client's session
// take anything, and no scan reaches the application that is not one of a laser that was set up.
#include <cstdint>
#include <span>

#include "lab/lms_server.hpp"
#include "robots/lms2xx/client_session.hpp"
#include "tests/fuzz/claim.hpp"

namespace {

using namespace axon;
using lms2xx::Bytes;
using lms2xx::Telegram;
using lms2xx::TelegramReader;
using std::chrono::milliseconds;

struct Application final : lms2xx::ClientSession::Port {
    void send(const Bytes& bytes) override {
        TelegramReader laser(TelegramReader::From::Host);
        require(laser.feed(bytes, TimePoint{}).size() == 1, "the client says whole telegrams");
    }
    void onOnline(const lms2xx::Setting& setting) override {
        require(setting.measuring.distanceBits().has_value(), "a laser that is online measures distances");
        online = true;
    }
    void onScan(const lms2xx::Scan& scan) override {
        require(online, "scans come from a laser that was set up");
        require(lms2xx::variantOf(scan.ranges_mm.size()).has_value(), "a scan is as long as one");
        require(scan.start_deg >= -90 &&
                    scan.start_deg + scan.step_deg * static_cast<double>(scan.ranges_mm.size() - 1) <= 90,
                "a scan lies before the laser");
        for (const auto range : scan.ranges_mm) require(range <= lms2xx::kNothing_mm, "a range is one");
    }
    void onLost(const std::string& reason) override {
        require(!reason.empty(), "a loss has a reason");
        online = false;
    }
    bool setSpeed(int /*baud*/) override { return true; }
    bool online = false;
};

/// What is understood of a telegram, written and read again.
void survives(const Telegram& telegram) {
    if (const auto scan = lms2xx::parseMeasuredValues(telegram))
        require(lms2xx::parseMeasuredValues(toAnswer(*scan)) == scan, "measured values survive");
    if (const auto measuring = lms2xx::parseMeasuring(telegram))
        require(lms2xx::parseMeasuring(toAnswer(*measuring)) == measuring, "a configuration survives");
    if (const auto answer = lms2xx::parseVariantAnswer(telegram))
        require(lms2xx::parseVariantAnswer(toAnswer(*answer)) == answer, "a variant survives");
}

std::vector<TelegramReader::Item> readInPieces(TelegramReader::From from,
                                               std::span<const std::uint8_t> stream, std::size_t piece) {
    TelegramReader reader(from);
    std::vector<TelegramReader::Item> found;
    for (std::size_t at = 0; at < stream.size(); at += piece)
        for (auto& item : reader.feed(stream.subspan(at, std::min(piece, stream.size() - at)), TimePoint{}))
            found.push_back(std::move(item));
    return found;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    if (size == 0) return 0;
    const std::span<const std::uint8_t> stream(bytes + 1, size - 1);
    const std::size_t piece = 1 + bytes[0];

    for (const auto from : {TelegramReader::From::Laser, TelegramReader::From::Host}) {
        const auto found = readInPieces(from, stream, piece);
        require(readInPieces(from, stream, stream.size() + 1) == found,
                "however the stream is cut, the same is found");
        for (const auto& item : found) {
            if (item.kind != TelegramReader::Item::Kind::Telegram) continue;
            require(readInPieces(from, lms2xx::encode(item.telegram), 1000) == std::vector{item},
                    "a telegram survives");
            survives(item.telegram);
        }
    }

    Application application;
    lms2xx::ClientSession client(application);
    lab::LmsServer laser(true);
    lab::BodyReadings body;
    body.laser_mm.assign(181, 1000);
    TimePoint now{};
    client.begin(now, {.baud = 9600});
    for (std::size_t at = 0; at < stream.size(); at += piece) {
        const auto part = stream.subspan(at, std::min(piece, stream.size() - at));
        client.receive(part, now);
        client.tick(now);
        (void)laser.receive(part, now);
        body.laser_scanned = at % 2 == 0;
        (void)laser.step(milliseconds{4}, body);
        require(laser.scanning().readings() <= lab::LaserSettings::kMaximumReadings,
                "the laser scans as lasers do");
        now += milliseconds{4};
    }
    client.end("the end");
    return 0;
}
