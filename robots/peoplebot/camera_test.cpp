// SPDX-License-Identifier: GPL-2.0-or-later
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <thread>

#include "common/descriptor.hpp"
#include "robots/peoplebot/camera_client.hpp"
#include "robots/peoplebot/camera_picture.hpp"
#include "tests/support/loopback.hpp"

namespace axon::peoplebot {
namespace {

using test::waitUntil;
using ::testing::HasSubstr;

constexpr auto kOk = "HTTP/1.1 200 OK\r\nContent-Type: image/x-portable-pixmap\r\n\r\n";

std::string ppm(int width, int height, char shade) {
    return "P6\n" + std::to_string(width) + " " + std::to_string(height) + "\n255\n" +
           std::string(static_cast<std::size_t>(width * height * 3), shade);
}
std::vector<std::uint8_t> bytes(const std::string& text) {
    return {text.begin(), text.end()};
}

TEST(PictureReader, KeepsTheNewestOfSeveralPictures) {
    PictureReader reader;
    reader.feed(bytes(kOk + ppm(4, 3, 1) + ppm(4, 3, 2) + ppm(4, 3, 3).substr(0, 20)), TimePoint{});
    const auto picture = reader.take();
    ASSERT_TRUE(picture);
    EXPECT_EQ(picture->sequence, 2U);
    EXPECT_EQ(picture->width, 4);
    EXPECT_EQ(picture->rgb, std::vector<std::uint8_t>(36, 2));
    EXPECT_FALSE(reader.take());
}

TEST(PictureReader, ByteByByteGivesTheSame) {
    PictureReader reader;
    int count = 0;
    for (const char c : kOk + ppm(2, 2, 'P') + ppm(2, 2, '6')) {
        reader.feed(bytes(std::string(1, c)), TimePoint{});
        count += reader.take() ? 1 : 0;
    }
    EXPECT_EQ(count, 2);
}

TEST(PictureReader, CommentsAndAnyBlanksAreAllowedInAHead) {
    PictureReader reader;
    reader.feed(bytes(std::string(kOk) + "P6 # made here\n2\t1\r\n255 abcdef"), TimePoint{});
    ASSERT_TRUE(reader.take());
}

TEST(PictureReader, WhatIsNoPictureIsSaid) {
    const auto refusal = [](const std::string& text) {
        PictureReader reader;
        try {
            reader.feed(bytes(text), TimePoint{});
        } catch (const BadPicture& error) {
            return std::string(error.what());
        }
        return std::string();
    };
    EXPECT_THAT(refusal("HTTP/1.1 404 Not Found\r\n\r\n"), HasSubstr("404"));
    EXPECT_THAT(refusal(std::string(9000, 'x')), HasSubstr("no HTTP"));
    EXPECT_THAT(refusal(std::string(kOk) + "P5\n1 1\n255\n"), HasSubstr("P6"));
    EXPECT_THAT(refusal(std::string(kOk) + "P6\n99999999999999999 1\n255\n"), HasSubstr("size"));
    EXPECT_THAT(refusal(std::string(kOk) + "P6\n0 1\n255\n"), HasSubstr("size"));
    EXPECT_THAT(refusal(std::string(kOk) + "P6\n1 1\n65535\n"), HasSubstr("255"));
    EXPECT_THAT(refusal(std::string(kOk) + "P6" + std::string(300, ' ')), HasSubstr("does not end"));
    EXPECT_EQ(refusal(std::string(kOk) + "P6\n1 1"), "");
}

TEST(Thumbnail, IsAveragedToTheSizeAskedForAndAJpeg) {
    CameraPicture picture{1, {}, 320, 240, std::vector<std::uint8_t>(320 * 240 * 3)};
    for (std::size_t i = 0; i < picture.rgb.size(); ++i) picture.rgb[i] = i / 3 % 2 == 0 ? 0 : 200;
    const auto small = scaled(picture, 160, 120);
    EXPECT_EQ(small.width, 160);
    EXPECT_EQ(small.height, 120);
    EXPECT_EQ(small.rgb, std::vector<std::uint8_t>(160 * 120 * 3, 100));
    const auto jpeg = toJpeg(small);
    EXPECT_EQ(jpeg.substr(0, 3), "\xFF\xD8\xFF");
    EXPECT_EQ(jpeg.substr(jpeg.size() - 2), "\xFF\xD9");
    EXPECT_LT(jpeg.size(), 5000U);
    EXPECT_EQ(scaled(small, 320, 240).width, 160);
    EXPECT_THROW(toJpeg({}), BadPicture);
}

/// Answers each connection with one text, then closes it.
class CameraServer {
  public:
    explicit CameraServer(std::string answer) : answer_(std::move(answer)) {
        sockaddr_in where{};
        where.sin_family = AF_INET;
        ::inet_pton(AF_INET, test::loopbackAddress().c_str(), &where.sin_addr);
        ::bind(listener_.get(), reinterpret_cast<sockaddr*>(&where), sizeof where);
        ::listen(listener_.get(), 4);
        socklen_t size = sizeof where;
        ::getsockname(listener_.get(), reinterpret_cast<sockaddr*>(&where), &size);
        port_ = ntohs(where.sin_port);
        thread_ = std::thread([this] { serve(); });
    }
    ~CameraServer() {
        ::shutdown(listener_.get(), SHUT_RDWR);
        thread_.join();
    }
    std::string address() const { return test::loopbackAddress() + ":" + std::to_string(port_); }
    int connections() const { return connections_; }

  private:
    void serve() {
        while (true) {
            const Descriptor accepted(::accept(listener_.get(), nullptr, nullptr));
            if (!accepted.open()) return;
            const int client = accepted.get();
            ++connections_;
            std::string request;
            std::array<char, 500> chunk{};
            while (request.find("\r\n\r\n") == std::string::npos) {
                const auto got = ::recv(client, chunk.data(), chunk.size(), 0);
                if (got <= 0) break;
                request.append(chunk.data(), static_cast<std::size_t>(got));
            }
            if (request.starts_with("GET /raw HTTP/1.1\r\n"))
                ::send(client, answer_.data(), answer_.size(), MSG_NOSIGNAL);
            ::shutdown(client, SHUT_WR);
            while (::recv(client, chunk.data(), chunk.size(), 0) > 0) {
            }
        }
    }

    const std::string answer_;
    const Descriptor listener_{::socket(AF_INET, SOCK_STREAM, 0)};
    int port_ = 0;
    std::atomic<int> connections_ = 0;
    std::thread thread_;
};

TEST(CameraClient, ReadsPicturesAndComesBackAfterEachLoss) {
    CameraServer camera(kOk + ppm(320, 240, 7));
    std::atomic<int> lost = 0;
    CameraClient client(camera.address(), {.on_lost = [&](const std::string&) { ++lost; }});
    ASSERT_TRUE(waitUntil([&] { return client.newest() && client.newest()->sequence >= 2; }));
    EXPECT_EQ(client.newest()->width, 320);
    EXPECT_GE(camera.connections(), 2);
    EXPECT_GE(lost, 1);
}

TEST(CameraClient, IsConnectedOnlyWhilePicturesAreWanted) {
    CameraServer camera(kOk + ppm(4, 4, 7));
    CameraClient client(camera.address(), {}, false);
    EXPECT_FALSE(waitUntil([&] { return camera.connections() > 0; }, std::chrono::milliseconds{100}));
    client.want(true);
    EXPECT_TRUE(waitUntil([&] { return client.newest() != nullptr; }));
    client.want(false);
    // A connection that had begun may still be counted; none after it.
    EXPECT_TRUE(waitUntil([&] {
        const int before = camera.connections();
        return !waitUntil([&] { return camera.connections() > before; }, std::chrono::milliseconds{400});
    }));
}

TEST(CameraClient, ACameraThatRefusesIsSaidWithItsStatus) {
    CameraServer camera("HTTP/1.1 503 Service Unavailable\r\n\r\n");
    std::mutex mutex;
    std::string reason;
    CameraClient client(camera.address(), {.on_lost = [&](const std::string& why) {
                            const std::lock_guard lock(mutex);
                            reason = why;
                        }});
    EXPECT_TRUE(waitUntil([&] {
        const std::lock_guard lock(mutex);
        return reason.find("503") != std::string::npos;
    }));
    EXPECT_FALSE(client.newest());
    EXPECT_THROW(CameraClient("nowhere", {}), std::invalid_argument);
}

}  // namespace
}  // namespace axon::peoplebot
