// SPDX-License-Identifier: MIT
// axon_entity._testing: the scripted Entity Manager for Python. Typed by axon_entity/_testing.pyi.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <axon/testing/scripted_manager.hpp>

#include "values.hpp"

namespace py = pybind11;
namespace testing = axon::testing;
using axon::python::ClockOfTest;
using axon::python::fromValue;
using axon::python::toValue;

namespace {

/// What a test waits for, it waits for without the interpreter: the application under test needs it.
using Others = py::call_guard<py::gil_scoped_release>;

py::list toList(const std::vector<axon::Value>& values) {
    py::list list;
    for (const auto& value : values) list.append(fromValue(value));
    return list;
}

axon::Parameter toParameter(const std::string& name, const py::handle& value, const std::string& units) {
    axon::Parameter parameter{name, {}, units};
    if (py::isinstance<py::list>(value) || py::isinstance<py::tuple>(value))
        for (const auto& one : value) parameter.values.push_back(toValue(one, "parameter '" + name + "'"));
    else
        parameter.values.push_back(toValue(value, "parameter '" + name + "'"));
    return parameter;
}

std::vector<axon::Parameter> toParameters(const py::dict& given) {
    std::vector<axon::Parameter> parameters;
    for (const auto& [name, value] : given)
        parameters.push_back(toParameter(name.cast<std::string>(), value, {}));
    return parameters;
}

testing::ScriptedManager::Options toOptions(const py::dict& settings) {
    testing::ScriptedManager::Options options;
    for (const auto& [key, value] : settings) {
        const auto name = key.cast<std::string>();
        if (name == "application")
            options.application = value.cast<std::string>();
        else if (name == "instance")
            options.instance = value.cast<std::string>();
        else if (name == "port")
            options.port = value.cast<std::uint16_t>();
        else if (name == "first_port")
            options.first_port = value.cast<std::uint16_t>();
        else if (name == "last_port")
            options.last_port = value.cast<std::uint16_t>();
        else if (name == "patience")
            options.patience = std::chrono::milliseconds(std::int64_t(value.cast<double>() * 1000));
        else if (name == "watchdog")
            options.watchdog = std::chrono::milliseconds(std::int64_t(value.cast<double>() * 1000));
        else if (name == "clock")
            options.clock = value.cast<testing::ManualClock>();
        else
            throw py::type_error("unknown setting '" + name + "'");
    }
    return options;
}

const char* toString(testing::Failure::Kind kind) {
    using Kind = testing::Failure::Kind;
    switch (kind) {
        case Kind::NotInTime:
            return "not in time";
        case Kind::Otherwise:
            return "otherwise";
        case Kind::Refused:
            return "refused";
        case Kind::LinkLost:
            return "link lost";
        case Kind::Misuse:
            return "misuse";
    }
    return "otherwise";
}

void defineFailure(py::module_& module) {
    static PyObject* failure = PyErr_NewExceptionWithDoc(
        "axon_entity.testing.Failure", "An expectation that was not met.", PyExc_AssertionError, nullptr);
    module.attr("Failure") = py::handle(failure);
    py::register_exception_translator([](std::exception_ptr thrown) {
        try {
            std::rethrow_exception(std::move(thrown));
        } catch (const testing::Failure& error) {
            auto object = py::handle(failure)(error.what());
            object.attr("kind") = toString(error.kind());
            object.attr("expected") = error.expected();
            object.attr("happened") = error.happened();
            PyErr_SetObject(failure, object.ptr());
        }
    });
}

void defineResults(py::module_& module) {
    py::class_<testing::Registration>(module, "Registration")
        .def_readonly("name", &testing::Registration::name)
        .def_readonly("category", &testing::Registration::category)
        .def_readonly("type", &testing::Registration::type)
        .def_readonly("descr", &testing::Registration::descr)
        .def_readonly("services", &testing::Registration::services);
    py::class_<testing::Answer>(module, "Answer")
        .def_readonly("granted", &testing::Answer::granted)
        .def_readonly("code", &testing::Answer::code)
        .def_readonly("reason", &testing::Answer::reason);
    py::class_<testing::Ending>(module, "Ending")
        .def_readonly("state", &testing::Ending::state)
        .def_readonly("reason", &testing::Ending::reason)
        .def_property_readonly("results", [](const testing::Ending& ending) {
            py::dict results;
            for (const auto& [name, values] : ending.results) results[py::str(name)] = toList(values);
            return results;
        });
    py::class_<testing::StopDone>(module, "StopDone")
        .def_readonly("generation", &testing::StopDone::generation)
        .def_readonly("standstill_follows", &testing::StopDone::standstill_follows);
    py::class_<testing::LinkEnding>(module, "LinkEnding")
        .def_readonly("reason", &testing::LinkEnding::reason)
        .def_readonly("stopped", &testing::LinkEnding::stopped);
    py::class_<testing::StreamSample>(module, "StreamSample")
        .def_readonly("sequence", &testing::StreamSample::sequence)
        .def_readonly("numbers", &testing::StreamSample::numbers)
        .def_readonly("units", &testing::StreamSample::units)
        .def_property_readonly("data",
                               [](const testing::StreamSample& sample) { return py::bytes(sample.bytes); });
}

void defineTask(py::module_& module) {
    using Task = testing::ScriptedTask;
    py::class_<Task>(module, "ScriptedTask")
        .def_property_readonly("id", &Task::id)
        .def_property_readonly("service", &Task::service)
        .def("expect_granted", &Task::expectGranted, Others())
        .def("expect_denied", &Task::expectDenied, Others())
        .def("expect_feedback", &Task::expectFeedback, py::arg("containing") = "", Others())
        .def("expect_progress", &Task::expectProgress, py::arg("at_least") = 0.0, Others())
        .def("expect_result",
             [](Task& task, const std::string& name) {
                 std::vector<axon::Value> values;
                 {
                     const py::gil_scoped_release others;
                     values = task.expectResult(name);
                 }
                 return toList(values);
             })
        .def("expect_succeeded", &Task::expectSucceeded, Others())
        .def("expect_failed", &Task::expectFailed, Others())
        .def("expect_stopped", &Task::expectStopped, Others())
        .def("expect_cancelled", &Task::expectCancelled, Others())
        .def("pause", &Task::pause, Others())
        .def("resume", &Task::resume, Others())
        .def("cancel", &Task::cancel, Others());
}

void defineManager(py::module_& module) {
    using Manager = testing::ScriptedManager;
    using Cause = axon::StopSignal::Cause;
    struct WithoutInterpreter {  // the destructor waits for a thread
        void operator()(Manager* manager) const {
            const py::gil_scoped_release others;
            delete manager;
        }
    };
    py::class_<Manager, std::unique_ptr<Manager, WithoutInterpreter>>(module, "ScriptedManager")
        .def(py::init([](const py::dict& settings) { return new Manager(toOptions(settings)); }))
        .def("connect", &Manager::connect, Others())
        .def("disconnect", &Manager::disconnect, Others())
        .def("silence", &Manager::silence, Others())
        .def_property_readonly("linked", &Manager::linked)
        .def("run",
             [](Manager& manager, const std::string& service, const py::dict& given) {
                 const auto parameters = toParameters(given);
                 const py::gil_scoped_release others;
                 return manager.run(service, parameters);
             })
        .def("set_parameter",
             [](Manager& manager, const std::string& service, const std::string& name,
                const py::object& value, const std::string& units) {
                 const auto parameter = toParameter(name, value, units);
                 const py::gil_scoped_release others;
                 return manager.setParameter(service, parameter);
             })
        .def(
            "upload",
            [](Manager& manager, const std::string& service, const std::string& resource,
               const std::string& file) { return manager.upload(service, resource, file); },
            Others())
        .def(
            "send_text",
            [](Manager& manager, const std::string& text, const std::string& from) {
                manager.sendText(text, from);
            },
            Others())
        .def("send_raw",
             [](Manager& manager, const std::vector<py::bytes>& blocks, const std::string& from) {
                 const std::vector<std::string> copies(blocks.begin(), blocks.end());
                 const py::gil_scoped_release others;
                 manager.sendRaw(copies, from);
             })
        .def("want_stream", &Manager::wantStream, Others())
        .def(
            "stop", [](Manager& manager, Cause cause) { return manager.stop(cause); },
            py::arg("cause") = Cause::Requested, Others())
        .def("expect_standstill", &Manager::expectStandstill, Others())
        .def("expect_text", &Manager::expectText, py::arg("containing") = "", Others())
        .def("expect_raw",
             [](Manager& manager) {
                 std::vector<std::string> blocks;
                 {
                     const py::gil_scoped_release others;
                     blocks = manager.expectRaw();
                 }
                 py::list list;
                 for (const auto& block : blocks) list.append(py::bytes(block));
                 return list;
             })
        .def("expect_sample", &Manager::expectSample, Others())
        .def("expect_position", &Manager::expectPosition, Others())
        .def("expect_inactive", &Manager::expectInactive, Others())
        .def("expect_active", &Manager::expectActive, Others())
        .def("expect_link_ended", &Manager::expectLinkEnded, Others());
}

}  // namespace

PYBIND11_MODULE(_testing, module) {
    module.doc() = "The scripted Entity Manager for Python; use axon_entity.testing, which is built on it.";
    py::module_::import("axon_entity._native");  // the types that both have
    defineFailure(module);
    defineResults(module);
    py::class_<testing::ManualClock>(module, "ManualClock")
        .def(py::init<>())
        .def(
            "advance",
            [](testing::ManualClock& clock, double seconds) {
                clock.advance(std::chrono::nanoseconds(std::int64_t(seconds * 1e9)));
            },
            Others())
        .def_property_readonly("elapsed",
                               [](const testing::ManualClock& clock) {
                                   return std::chrono::duration<double>(clock.elapsed()).count();
                               })
        .def("shared", [](const testing::ManualClock& clock) { return ClockOfTest{clock.shared()}; });
    defineTask(module);
    defineManager(module);
}
