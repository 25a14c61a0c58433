// SPDX-License-Identifier: MIT
// plotter-entity [FOLDER_OF_PROFILES [PORTS_FILE]]: a simulated plotter.
#include <axon/entity_interfacer.hpp>
#include <cmath>
#include <fstream>
#include <iostream>
#include <sstream>

namespace {

using Seconds = std::chrono::duration<double>;

struct Point {
    double x = 0, y = 0;
};

/// Throws std::runtime_error with a text for the person who has written the file.
std::vector<Point> readDrawing(const std::filesystem::path& file) {
    std::vector<Point> points;
    std::ifstream lines(file);
    for (std::string line; std::getline(lines, line);) {
        std::istringstream words(line);
        Point point;
        if (!(words >> point.x >> point.y))
            throw std::runtime_error("line " + std::to_string(points.size() + 1) +
                                     ": expected two numbers from 0 to 1, such as 0.5 1");
        points.push_back(point);
    }
    if (points.size() < 2) throw std::runtime_error("expected two points or more");
    return points;
}

}  // namespace

int main(int argc, char** argv) try {
    if (argc > 1 && *argv[1] == '-')
        return std::cout << "plotter-entity [FOLDER_OF_PROFILES [PORTS_FILE]]\n", 0;
    const std::filesystem::path profiles = argc > 1 ? argv[1] : ".";
    axon::EntityInterfacer interfacer({.application = "Plotter", .ports_file = argc > 2 ? argv[2] : ""});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");

    // [parameter]
    interfacer.onParameter([](const std::string&, const axon::Parameter& parameter) {
        if (parameter.name == "Color" && parameter.text() == "red")
            return axon::Decision::deny("the red pen is empty");
        return axon::Decision::grant();
    });
    // [end]
    // [config]
    interfacer.onConfig([](const std::string&, const axon::Parameter& parameter) {
        std::cout << parameter.name << " is " << parameter.number() << ' ' << parameter.units << std::endl;
    });
    // [end]
    // [resource]
    interfacer.onResource([](const std::string&, const std::string&, const std::filesystem::path& file) {
        try {
            readDrawing(file);
            return axon::Decision::grant();
        } catch (const std::runtime_error& error) {
            return axon::Decision::deny(error.what());
        }
    });
    // [end]
    // [draw]
    auto pen = interfacer.stream("pen");
    interfacer.onTask("Draw", [&](axon::Task& task) {
        const auto points = readDrawing(task.resource("Drawing"));
        const auto size_mm = task.number("Size");
        constexpr double kPeriod_s = 0.02;
        double drawn_mm = 0;
        for (std::size_t i = 1; i < points.size(); ++i) {
            const auto &from = points[i - 1], &to = points[i];
            const double line_mm = std::hypot(to.x - from.x, to.y - from.y) * size_mm;
            for (double done_mm = 0; done_mm < line_mm;) {
                if (!task.waitFor(Seconds(kPeriod_s))) return;
                done_mm = std::min(line_mm, done_mm + task.number("Speed") * kPeriod_s);
                const double part = done_mm / line_mm;
                pen.send({(from.x + (to.x - from.x) * part) * size_mm,
                          (from.y + (to.y - from.y) * part) * size_mm},
                         "mm");
            }
            drawn_mm += line_mm;
            task.result("Drawn", drawn_mm, "mm");
            task.progress(double(i) / double(points.size() - 1));
        }
        task.result("Length", drawn_mm, "mm");
    });
    // [end]
    interfacer.run();
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
