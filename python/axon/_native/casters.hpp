// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <axon/client.hpp>

/// How values of the client library become values of Python, and back. Every source file of this module that
/// binds something includes it, so that all of them agree.
///
/// Durations are float, in seconds. Points in time are float, in seconds since 1970. Enumerations are those
/// of axon.states, and refusal codes those of axon.refusals, which have the same numbers.
namespace axon::python {

/// The Python enumeration for a number, or the number itself if the enumeration does not have it.
inline pybind11::object enumerator(const char* module, const char* type, int number) {
    const auto enumeration = pybind11::module_::import(module).attr(type);
    try {
        return enumeration(number);
    } catch (const pybind11::error_already_set&) {
        return pybind11::int_(number);
    }
}

/// Text from outside, which need not be UTF-8.
inline pybind11::str text(std::string_view utf8) {
    auto* const made = PyUnicode_DecodeUTF8(utf8.data(), static_cast<Py_ssize_t>(utf8.size()), "replace");
    if (!made) throw pybind11::error_already_set();
    return pybind11::reinterpret_steal<pybind11::str>(made);
}

}  // namespace axon::python

namespace pybind11::detail {

template <>
struct type_caster<axon::client::Seconds> {
    PYBIND11_TYPE_CASTER(axon::client::Seconds, const_name("float"));
    bool load(handle from, bool) {
        if (PyBool_Check(from.ptr())) return false;
        const double number = PyFloat_AsDouble(from.ptr());
        if (number == -1.0 && PyErr_Occurred()) return PyErr_Clear(), false;
        if (number != number)
            throw value_error("a time in seconds was expected, and this is not a number (nan)");
        value = axon::client::Seconds(number);
        return true;
    }
    static handle cast(axon::client::Seconds time, return_value_policy, handle) {
        return PyFloat_FromDouble(time.count());
    }
};

template <>
struct type_caster<std::chrono::system_clock::time_point> {
    PYBIND11_TYPE_CASTER(std::chrono::system_clock::time_point, const_name("float"));
    bool load(handle, bool) { return false; }
    static handle cast(std::chrono::system_clock::time_point time, return_value_policy, handle) {
        return PyFloat_FromDouble(axon::client::Seconds(time.time_since_epoch()).count());
    }
};

/// bool is looked at before int, of which it is a kind. Anything else that is a number by its methods counts
/// as one: those of NumPy do.
template <>
struct type_caster<axon::client::Value> {
    PYBIND11_TYPE_CASTER(axon::client::Value, const_name("bool | int | float | str"));
    bool load(handle from, bool) {
        auto* const object = from.ptr();
        if (PyBool_Check(object)) return value = object == Py_True, true;
        if (PyUnicode_Check(object)) return value = pybind11::cast<std::string>(from), true;
        if (PyFloat_Check(object)) return value = PyFloat_AS_DOUBLE(object), true;
        if (PyIndex_Check(object)) {
            const auto number = reinterpret_steal<object_>(PyNumber_Index(object));
            if (!number) return PyErr_Clear(), false;
            int too_large = 0;
            const long long whole = PyLong_AsLongLongAndOverflow(number.ptr(), &too_large);
            if (too_large) throw value_error("a number of 64 bits was expected, and this one is larger");
            return value = static_cast<std::int64_t>(whole), true;
        }
        if (const auto method = reinterpret_steal<object_>(PyObject_GetAttrString(object, "item"));
            method && PyObject_HasAttrString(object, "dtype")) {  // a scalar of NumPy
            const auto plain = reinterpret_steal<object_>(PyObject_CallNoArgs(method.ptr()));
            if (plain && !PyObject_HasAttrString(plain.ptr(), "dtype")) return load(plain, true);
        }
        PyErr_Clear();
        return false;
    }
    static handle cast(const axon::client::Value& from, return_value_policy, handle) {
        if (const auto* const whole = std::get_if<std::int64_t>(&from)) return PyLong_FromLongLong(*whole);
        if (const auto* const number = std::get_if<double>(&from)) return PyFloat_FromDouble(*number);
        if (const auto* const truth = std::get_if<bool>(&from)) return PyBool_FromLong(*truth);
        return axon::python::text(std::get<std::string>(from)).release();
    }

  private:
    using object_ = pybind11::object;
};

#define AXON_ENUMERATION(type, module, name)                                                 \
    template <>                                                                              \
    struct type_caster<type> {                                                               \
        PYBIND11_TYPE_CASTER(type, const_name(name));                                        \
        bool load(handle from, bool) {                                                       \
            const long number = PyLong_AsLong(from.ptr());                                   \
            if (number == -1 && PyErr_Occurred()) return PyErr_Clear(), false;               \
            value = static_cast<type>(number);                                               \
            return true;                                                                     \
        }                                                                                    \
        static handle cast(type from, return_value_policy, handle) {                         \
            return axon::python::enumerator(module, name, static_cast<int>(from)).release(); \
        }                                                                                    \
    }
AXON_ENUMERATION(axon::RefusalCode, "axon.refusals", "RefusalCode");
AXON_ENUMERATION(axon::EntityState, "axon.states", "EntityState");
AXON_ENUMERATION(axon::Presence, "axon.states", "Presence");
AXON_ENUMERATION(axon::Role, "axon.states", "Role");
AXON_ENUMERATION(axon::client::TaskState, "axon.states", "TaskState");
AXON_ENUMERATION(axon::client::RunState, "axon.states", "RunState");
AXON_ENUMERATION(axon::client::ParameterKind, "axon.states", "ParameterKind");
AXON_ENUMERATION(axon::client::DataType, "axon.states", "DataType");
AXON_ENUMERATION(axon::client::ServiceKind, "axon.states", "ServiceKind");
AXON_ENUMERATION(axon::client::OnFailure, "axon.states", "OnFailure");
#undef AXON_ENUMERATION

}  // namespace pybind11::detail
