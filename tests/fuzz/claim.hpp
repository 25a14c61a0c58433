// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdio>
#include <cstdlib>

/// Ends the process, which libFuzzer and the replay take for a finding, where a claim about the parser does
/// not hold.
inline void require(bool holds, const char* claim) {
    if (holds) return;
    std::fprintf(stderr, "not true: %s\n", claim);
    std::abort();
}
