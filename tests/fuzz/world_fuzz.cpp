// SPDX-License-Identifier: GPL-2.0-or-later
// A laboratory's description: any text is accepted or refused with its line, and what is accepted can be
// completed, checked and written as a world. All maps that it names are one small square here; map_fuzz has
// maps.
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "lab/description.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    using namespace axon::lab;
    const std::string_view text(reinterpret_cast<const char*>(bytes), size);
    try {
        constexpr const char* kMap =
            "2D-Map\nLineMinPos: 0 0\nLineMaxPos: 4000 4000\nNumLines: 4\nLINES\n0 0 4000 0\n4000 0 4000 "
            "4000\n"
            "4000 4000 0 4000\n0 4000 0 0\n";
        auto world = [&] {
            try {
                return parseWorld(text, "f", [=](const std::string&) { return std::string(kMap); });
            } catch (const BadDescription& error) {
                if (!std::string_view(error.what()).starts_with("f:")) std::abort();
                throw;
            }
        }();
        complete(world);
        validate(world);
        if (sceneOf(world).xml.empty()) std::abort();
    } catch (const BadDescription& error) {
        if (std::string_view(error.what()).empty()) std::abort();
    }
    return 0;
}
