// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/control.hpp"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

namespace axon::lab {
namespace {

using Json = nlohmann::json;

/// What is wrong with a request; the message says what was expected.
class BadRequest : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

constexpr auto kKnown =
    "pause, resume, speed, step, reset, move, block, unblock, fault, mend, truth, forget-touches, picture, "
    "path";

double number(const Json& request, const char* key, std::optional<double> otherwise = std::nullopt) {
    const auto found = request.find(key);
    if (found == request.end()) {
        if (otherwise) return *otherwise;
        throw BadRequest(fmt::format("expected a number \"{}\"", key));
    }
    if (!found->is_number() || !std::isfinite(found->get<double>()))
        throw BadRequest(fmt::format("\"{}\": expected a number", key));
    return *found;
}

std::string text(const Json& request, const char* key) {
    const auto found = request.find(key);
    if (found == request.end() || !found->is_string() || found->get_ref<const std::string&>().empty())
        throw BadRequest(fmt::format("expected a text \"{}\"", key));
    return *found;
}

/// To so many decimals; + 0.0 makes -0 a 0.
double rounded(double value, int decimals) {
    const double scale = std::pow(10, decimals);
    return std::round(value * scale) / scale + 0.0;
}

template <class Placements>
std::optional<std::size_t> indexOf(const Placements& placements, const std::string& name) {
    for (std::size_t i = 0; i < placements.size(); ++i) {
        if (placements[i].name == name) return i;
    }
    return std::nullopt;
}

void move(Laboratory& laboratory, const WorldDescription& world, const Json& request) {
    const auto name = text(request, "name");
    if (const auto robot = indexOf(world.robots, name)) {
        const auto now = laboratory.physics().truth(*robot);
        laboratory.physics().placeRobot(*robot, number(request, "x", now.x_m), number(request, "y", now.y_m),
                                        number(request, "theta", now.theta_deg));
        return;
    }
    for (const auto& object : laboratory.physics().truthOfObjects()) {
        if (object.name != name) continue;
        laboratory.physics().placeObject(name, number(request, "x", object.x_m),
                                         number(request, "y", object.y_m), number(request, "z", object.z_m),
                                         number(request, "theta", object.theta_deg));
        return;
    }
    laboratory.physics().moveObstacle(name, number(request, "x"), number(request, "y"),
                                      number(request, "theta", 0));
}

void setFault(Laboratory& laboratory, const WorldDescription& world, const Json& request, bool broken) {
    const auto name = text(request, "name");
    const auto kind = text(request, "kind");
    const double which = number(request, "which", 0);
    if (which < 0 || which > 100 || which != std::floor(which))
        throw BadRequest("\"which\": expected a whole number from 0");
    if (const auto device = indexOf(world.devices, name)) {
        laboratory.device(*device).setFault(kind, static_cast<std::size_t>(which), broken);
        return;
    }
    const auto robot = indexOf(world.robots, name);
    if (!robot) throw BadRequest(fmt::format("no robot or device is called \"{}\"", name));
    Fault fault;
    fault.which = static_cast<int>(which);
    if (kind == "dead-sonar")
        fault.kind = Fault::Kind::DeadSonar;
    else if (kind == "stuck-gripper")
        fault.kind = Fault::Kind::StuckGripper;
    else if (kind == "slipping-wheel")
        fault.kind = Fault::Kind::SlippingWheel;
    else if (kind == "flat-battery")
        fault.kind = Fault::Kind::FlatBattery;
    else
        throw BadRequest(
            "\"kind\" of a robot: expected dead-sonar, stuck-gripper, slipping-wheel or flat-battery");
    laboratory.physics().setFault(*robot, fault, broken);
}

Json truthOf(const Laboratory& laboratory, const WorldDescription& world) {
    const auto& physics = laboratory.physics();
    Json truth{{"time_s", rounded(std::chrono::duration<double>(laboratory.age()).count(), 3)},
               {"robots", Json::array()},
               {"objects", Json::array()}};
    for (const auto& kind : deviceKinds()) truth[kind.noun + "s"] = Json::array();
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        const auto t = physics.truth(i);
        truth["robots"].push_back({{"name", world.robots[i].name},
                                   {"x_m", rounded(t.x_m, 4)},
                                   {"y_m", rounded(t.y_m, 4)},
                                   {"theta_deg", rounded(t.theta_deg, 2)},
                                   {"speed_m_s", rounded(t.speed_m_s, 4)},
                                   {"rotation_deg_s", rounded(t.rotation_deg_s, 2)},
                                   {"lift_mm", rounded(t.lift_mm, 2)},
                                   {"opening_mm", rounded(t.opening_mm, 2)},
                                   {"touched", t.touched}});
    }
    for (std::size_t i = 0; i < world.devices.size(); ++i) {
        Json device{{"name", world.devices[i].name}};
        for (const auto& measure : physics.device(i).truth()) {
            if (const auto* number = std::get_if<double>(&measure.value)) {
                device[measure.name] = rounded(*number, 2);
                continue;
            }
            auto& list = device[measure.name] = Json::array();
            for (const double number : std::get<std::vector<double>>(measure.value))
                list.push_back(rounded(number, 2));
        }
        truth[deviceKind(world.devices[i].kind)->noun + "s"].push_back(std::move(device));
    }
    for (const auto& object : physics.truthOfObjects()) {
        truth["objects"].push_back({{"name", object.name},
                                    {"x_m", rounded(object.x_m, 4)},
                                    {"y_m", rounded(object.y_m, 4)},
                                    {"z_m", rounded(object.z_m, 4)},
                                    {"theta_deg", rounded(object.theta_deg, 2)},
                                    {"tilt_deg", rounded(object.tilt_deg, 2)},
                                    {"speed_m_s", rounded(object.speed_m_s, 4)},
                                    {"on", object.on}});
    }
    return truth;
}

}  // namespace

std::string Control::truth() const {
    return truthOf(laboratory_, world_).dump(-1, ' ', false, Json::error_handler_t::replace);
}

Control::Reply Control::handle(std::string_view line) {
    Json answer{{"ok", true}};
    std::optional<Duration> until;
    std::future<void> work;
    try {
        const auto request = Json::parse(line, nullptr, false);
        if (!request.is_object()) throw BadRequest(R"(expected one JSON object, such as {"do":"truth"})");
        const auto what = text(request, "do");
        if (what == "pause" || what == "resume") {
            operator_.pause(what == "pause");
        } else if (what == "speed") {
            const double factor = number(request, "factor");
            if (factor < 0.01 || factor > 100) throw BadRequest("\"factor\": expected 0.01 to 100");
            operator_.setSpeed(factor);
        } else if (what == "step") {
            const double ms = number(request, "ms");
            if (ms < 0 || ms > 3.6e6) throw BadRequest("\"ms\": expected 0 to 3600000");
            if (!operator_.paused())
                throw BadRequest("time runs by itself; fix: pause first, or start axon-lab with --step");
            until = laboratory_.age() + std::chrono::nanoseconds(std::llround(ms * 1e6));
            answer["time_s"] = rounded(std::chrono::duration<double>(*until).count(), 3);
        } else if (what == "reset") {
            operator_.reset();
        } else if (what == "move") {
            move(laboratory_, world_, request);
        } else if (what == "block") {
            Box box;
            box.name = text(request, "name");
            box.x = number(request, "x");
            box.y = number(request, "y");
            box.z = number(request, "z", 0);
            box.dx = number(request, "dx", 0.4);
            box.dy = number(request, "dy", 0.4);
            box.height = number(request, "height", 0.6);
            box.theta = number(request, "theta", 0);
            laboratory_.physics().addObstacle(box);
        } else if (what == "unblock") {
            laboratory_.physics().removeObstacle(text(request, "name"));
        } else if (what == "fault" || what == "mend") {
            setFault(laboratory_, world_, request, what == "fault");
        } else if (what == "truth") {
            answer.update(truthOf(laboratory_, world_));
            answer["paused"] = operator_.paused();
            answer["speed"] = operator_.speed();
        } else if (what == "forget-touches") {
            laboratory_.physics().forgetTouches();
        } else if (what == "picture" || what == "path") {
            work = operator_.writePicture(text(request, "file"), what == "path");
        } else {
            throw BadRequest(fmt::format("\"do\": \"{}\": expected one of {}", what, kKnown));
        }
    } catch (const std::exception& error) {
        return {failed(error), std::nullopt, {}};
    }
    return {answer.dump(-1, ' ', false, Json::error_handler_t::replace), until, std::move(work)};
}

std::string Control::failed(const std::exception& error) {
    return Json{{"ok", false}, {"error", error.what()}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace axon::lab
