// SPDX-License-Identifier: MIT
#pragma once
#include <pybind11/pybind11.h>

#include <axon/entity_interfacer.hpp>
#include <memory>
#include <string>

namespace axon::python {

namespace py = pybind11;

/// A clock of a test, as axon_entity.testing hands it to the options of an Interfacer. Both modules know it.
struct ClockOfTest {
    std::shared_ptr<const Clock> clock;
};

/// Converts a Python bool, int, float or str. Throws py::type_error with `what` in its text.
Value toValue(const py::handle& object, const std::string& what);
py::object fromValue(const Value& value);

}  // namespace axon::python
