// SPDX-License-Identifier: GPL-2.0-or-later
// A laboratory's description: any text is accepted or refused with its line, and what is accepted can be completed,
// checked and written as a world. Maps that it names are empty here; map_fuzz has those.
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "lab/description.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    using namespace axon::lab;
    const std::string_view text(reinterpret_cast<const char*>(bytes), size);
    try {
        auto world = parseWorld(text, "f", [](const std::string&) -> std::string { throw BadDescription("f: no such file"); });
        complete(world);
        validate(world);
        if (mjcf(world).empty()) std::abort();
    } catch (const BadDescription& error) {
        if (std::string_view(error.what()).empty()) std::abort();
    }
    return 0;
}
