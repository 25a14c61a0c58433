// SPDX-License-Identifier: GPL-2.0-or-later
// Fuzzy rules: any text is accepted or refused with its line, and what is accepted gives a number for each
// output, whatever the inputs.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>
#include <vector>

#include "robots/fuzzy/engine.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    using namespace axon::fuzzy;
    const std::string_view text(reinterpret_cast<const char*>(bytes), size);
    try {
        const auto engine = Engine::parse(text, "f");
        for (const double value : {-1e9, -1.0, 0.0, 0.5, 300.0, 1e9}) {
            const auto outputs = engine.evaluate(std::vector<double>(engine.inputs().size(), value));
            if (outputs.size() != engine.outputs().size()) std::abort();
            for (const double output : outputs)
                if (!std::isfinite(output)) std::abort();
        }
    } catch (const BadRules& error) {
        if (!std::string_view(error.what()).starts_with("f")) std::abort();
    }
    return 0;
}
