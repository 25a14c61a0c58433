// SPDX-License-Identifier: MIT
#include "words.hpp"

#include <iostream>

namespace {
int failures = 0;

void expect(bool holds, const char* claim) {
    if (holds) return;
    ++failures;
    std::cerr << "failed: " << claim << '\n';
}
}  // namespace

int main() {
    const auto argument = readArgument("Distance=1000");
    expect(argument && argument->name == "Distance", "the name is before the '='");
    expect(argument && std::get<std::string>(argument->values.at(0)) == "1000", "the value is behind it");
    expect(!readArgument("Distance") && !readArgument("=1000"), "a word without a name is no argument");
    return failures;
}
