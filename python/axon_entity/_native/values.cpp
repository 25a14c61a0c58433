// SPDX-License-Identifier: MIT
#include "values.hpp"

#include <cstdint>

namespace axon::python {

Value toValue(const py::handle& object, const std::string& what) {
    if (py::isinstance<py::bool_>(object)) return object.cast<bool>();
    if (py::isinstance<py::str>(object)) return object.cast<std::string>();
    if (PyFloat_Check(object.ptr())) return object.cast<double>();
    if (PyIndex_Check(object.ptr())) {
        const auto whole = py::reinterpret_steal<py::object>(PyNumber_Index(object.ptr()));
        if (!whole) throw py::error_already_set();
        const auto value = PyLong_AsLongLong(whole.ptr());
        if (value == -1 && PyErr_Occurred() != nullptr) {
            PyErr_Clear();
            throw py::value_error(what + ": expected an integer of 64 bits");
        }
        return static_cast<std::int64_t>(value);
    }
    if (const double value = PyFloat_AsDouble(object.ptr()); PyErr_Occurred() == nullptr) return value;
    PyErr_Clear();
    const std::string name = py::str(py::type::handle_of(object).attr("__name__"));
    throw py::type_error(what + ": expected bool, int, float or str, found " + name);
}

py::object fromValue(const Value& value) {
    return std::visit([](const auto& one) { return py::object(py::cast(one)); }, value);
}

}  // namespace axon::python
