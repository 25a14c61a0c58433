// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <cstdlib>

namespace axon::test {

/// A number that whoever runs the test may choose in the environment, such as AXON_SEED or AXON_SEEDS.
inline std::uint64_t setting(const char* name, std::uint64_t otherwise) {
    const char* const given = std::getenv(name);
    return given == nullptr ? otherwise : std::strtoull(given, nullptr, 10);
}

}  // namespace axon::test
