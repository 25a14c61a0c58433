// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "casters.hpp"

namespace axon::python {

/// The sample as an object of Python. Its arrays look into the memory of the sample; nothing is copied.
pybind11::object toPython(client::Sample sample);

}  // namespace axon::python
