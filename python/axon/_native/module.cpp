// SPDX-License-Identifier: GPL-2.0-or-later
#include "bindings.hpp"
#include "gil.hpp"

PYBIND11_MODULE(_native, module) {
    using namespace axon::python;
    module.doc() =
        "The C++ client library of Axon. Programs use the package axon, which says what everything here "
        "means.";
    prepareForForks();
    bindValues(module);
    bindFeed(module);
    bindSamples(module);
    bindClient(module);
    module.def("end_of_interpreter", &endOfInterpreter);
}
