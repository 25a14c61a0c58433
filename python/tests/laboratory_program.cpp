// SPDX-License-Identifier: GPL-2.0-or-later
// axon-test-laboratory: axon::testing::Laboratory in a process of its own, for tests in Python. It says where
// the server is, then carries out one command per line, {"do": "add", …}, and answers each with one line,
// {"ok": true, …}.
#include <axon/testing/laboratory.hpp>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>

#include "support/tcp_valve.hpp"

namespace {

using Json = nlohmann::json;
using namespace axon::testing;
using axon::client::Seconds;
using axon::client::Value;

Value valueOf(const Json& json) {
    if (json.is_boolean()) return json.get<bool>();
    if (json.is_number_integer()) return json.get<std::int64_t>();
    if (json.is_number()) return json.get<double>();
    return json.get<std::string>();
}
Json jsonOf(const Value& value) {
    return std::visit([](const auto& held) { return Json(held); }, value);
}
std::vector<Value> valuesOf(const Json& json) {
    std::vector<Value> out;
    for (const auto& one : json) out.push_back(valueOf(one));
    return out;
}

Script scriptOf(const Json& steps) {
    Script script;
    for (const auto& step : steps) {
        const auto& what = step.at(0).get_ref<const std::string&>();
        if (what == "after") script.after(Seconds(step.at(1).get<double>()));
        if (what == "progress") script.progress(step.at(1).get<double>());
        if (what == "feedback") script.feedback(step.at(1).get<std::string>());
        if (what == "result") script.result(step.at(1).get<std::string>(), valuesOf(step.at(2)));
        if (what == "succeed") script.succeed();
        if (what == "fail") script.fail(step.at(1).get<std::string>());
        if (what == "lost") script.robotLost(step.at(1).get<std::string>());
        if (what == "never") script.never();
        if (what == "denied") return Script::denied(step.at(1).get<std::string>());
    }
    return script;
}

class Program {
  public:
    explicit Program(Passing passing) : laboratory_(Laboratory::Options{.passing = passing}) {}
    std::string server() const { return laboratory_.server(); }

    Json carryOut(const Json& command) {
        const auto what = command.at("do").get<std::string>();
        if (what == "add") {
            auto entity = laboratory_.add(command.at("basic").get<std::string>(),
                                          command.at("services").get<std::string>());
            entities_.emplace(command.at("key").get<std::string>(), entity);
            return {};
        }
        if (what == "advance") return laboratory_.advance(Seconds(command.at("time").get<double>())), Json{};
        if (what == "valve") {
            valve_ = std::make_unique<axon::test::TcpValve>(laboratory_.server());
            return {{"at", valve_->address()}};
        }
        if (what == "cut") return valve_->cut(), Json{};
        if (what == "open") return valve_->open(), Json{};
        return ofEntity(what, entities_.at(command.at("entity").get<std::string>()), command);
    }

  private:
    static Json ofEntity(const std::string& what, ScriptedEntity& entity, const Json& command) {
        const auto text = [&](const char* key) { return command.value(key, std::string()); };
        if (what == "on") entity.on(text("service"), scriptOf(command.at("script")));
        if (what == "deny") entity.denyParameter(text("service"), text("parameter"), text("reason"));
        if (what == "standstill") entity.reportStandstill(Seconds(command.at("after").get<double>()));
        if (what == "confirm") entity.confirmStops(command.at("confirm").get<bool>());
        if (what == "active")
            entity.setServiceActive(text("service"), command.at("active").get<bool>(), text("reason"));
        if (what == "text") entity.sendText(text("text"));
        if (what == "raw") entity.sendRaw(text("text"));
        if (what == "sample")
            entity.sendSample(text("stream"), command.at("numbers").get<std::vector<double>>(),
                              text("units"));
        if (what == "lose_application") entity.loseApplication();
        if (what == "restore_application") entity.restoreApplication();
        if (what == "leave") entity.leave();
        if (what == "lose") entity.lose();
        if (what == "join") entity.join();
        if (what == "expect_stop") return {{"cause", entity.expectStop()}};
        if (what == "expect_text") return {{"text", entity.expectText()}};
        if (what == "expect_raw") return {{"text", entity.expectRaw()}};
        if (what == "uploaded") return {{"text", entity.uploaded(text("service"), text("resource"))}};
        if (what == "expect_task") {
            const auto task = entity.expectTask(text("service"));
            Json parameters = Json::object();
            for (const auto& [name, values] : task.parameters) {
                for (const auto& value : values) parameters[name].push_back(jsonOf(value));
            }
            return {{"service", task.service}, {"parameters", parameters}};
        }
        return {};
    }

    Laboratory laboratory_;
    std::map<std::string, ScriptedEntity> entities_;
    std::unique_ptr<axon::test::TcpValve> valve_;
};

}  // namespace

int main(int argc, char** argv) {
    const bool at_once = argc > 1 && std::string(argv[1]) == "--at-once";
    Program program(at_once ? Passing::AtOnce : Passing::InAdvance);
    std::cout << Json{{"server", program.server()}}.dump() << std::endl;
    for (std::string line; std::getline(std::cin, line);) {
        Json answer{{"ok", true}};
        try {
            const auto more = program.carryOut(Json::parse(line));
            if (more.is_object()) answer.update(more);
        } catch (const std::exception& error) {
            answer = {{"ok", false}, {"error", error.what()}};
        }
        std::cout << answer.dump(-1, ' ', false, Json::error_handler_t::replace) << std::endl;
    }
}
