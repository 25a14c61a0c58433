// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "casters.hpp"

/// The parts of the module. Each adds its classes; bindValues() comes first.
namespace axon::python {

void bindValues(pybind11::module_& module);
void bindFeed(pybind11::module_& module);
void bindSamples(pybind11::module_& module);
void bindClient(pybind11::module_& module);

}  // namespace axon::python
