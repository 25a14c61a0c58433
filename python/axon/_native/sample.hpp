// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "casters.hpp"

namespace axon::python {

/// The sample as an object of Python. It is read once, which copies its data; its arrays look into what was
/// read.
pybind11::object toPython(client::Sample sample);

}  // namespace axon::python
