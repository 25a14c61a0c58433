// SPDX-License-Identifier: GPL-2.0-or-later
// camera-entity FOLDER_OF_PROFILES PORTS_FILE: sends a picture of 640 x 480 pixels 30 times a second, and a
// scan. Its service Nothing does nothing, for the benchmark of round trips.
#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <cmath>
#include <iostream>
#include <thread>

namespace {

using namespace std::chrono_literals;

axon::Image picture(std::uint64_t number) {
    axon::Image image{640, 480, "rgb8", std::string(640 * 480 * 3, '\0')};
    for (std::size_t y = 0; y < 480; ++y) {
        for (std::size_t x = 0; x < 640; ++x) {
            auto* const pixel = &image.pixels[(y * 640 + x) * 3];
            pixel[0] = static_cast<char>(x / 3), pixel[1] = static_cast<char>(y / 2);
        }
    }
    image.pixels[0] = static_cast<char>(number % 256);
    return image;
}

axon::Scan scan() {
    axon::Scan out{-1.5707963, 3.1415927 / 180, 8.0, {}, {}};
    for (int beam = 0; beam <= 180; ++beam) {
        const double angle = out.start_angle + beam * out.step;
        out.ranges.push_back(static_cast<float>(std::min(2.0 / std::max(std::cos(angle), 0.2), 9.0)));
    }
    return out;
}

}  // namespace

int main(int argc, char** argv) try {
    if (argc != 3) return std::cerr << "camera-entity FOLDER_OF_PROFILES PORTS_FILE\n", 2;
    const std::filesystem::path profiles = argv[1];
    axon::EntityInterfacer interfacer({.application = "Camera", .ports_file = argv[2]});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");
    interfacer.onTask("Nothing", [](axon::Task&) {});
    auto eye = interfacer.stream("eye");
    auto around = interfacer.stream("scan");
    std::jthread sends([&](const std::stop_token& end) {
        auto image = picture(0);
        auto next = std::chrono::steady_clock::now();
        for (std::uint64_t number = 1; !end.stop_requested(); ++number) {
            image.pixels[0] = static_cast<char>(number % 256);
            eye.send(image);
            around.send(scan());
            std::this_thread::sleep_until(next += 33'333us);
        }
    });
    interfacer.onText([&](const std::string& text, const std::string&) { interfacer.sendInfoMsg(text); });
    interfacer.run();
    return 0;
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
