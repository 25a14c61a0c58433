// SPDX-License-Identifier: MIT
#include "common/refusal.hpp"

#include <algorithm>
#include <array>

namespace axon {
namespace {

constexpr std::array kRefusals{
#define AXON_REFUSAL(enumerator, name, number, exit, decided_by, meaning, remedy) \
    RefusalEntry{RefusalCode::enumerator, #name, exit, decided_by, meaning, remedy},
#include "common/axon/refusals.def"
#undef AXON_REFUSAL
};
static_assert(std::is_sorted(kRefusals.begin(), kRefusals.end(),
                             [](const RefusalEntry& a, const RefusalEntry& b) { return a.code < b.code; }));

}  // namespace

std::span<const RefusalEntry> refusals() {
    return kRefusals;
}

const RefusalEntry& refusalEntry(RefusalCode code) {
    const auto found = std::find_if(kRefusals.begin(), kRefusals.end(),
                                    [code](const RefusalEntry& entry) { return entry.code == code; });
    if (found == kRefusals.end()) return refusalEntry(RefusalCode::Internal);
    return *found;
}

std::string_view refusalName(RefusalCode code) {
    return refusalEntry(code).name;
}

std::string remedyFor(RefusalCode code, std::string_view entity, std::string_view holder) {
    std::string text;
    auto rest = refusalEntry(code).remedy;
    for (auto brace = rest.find('{'); brace != std::string_view::npos; brace = rest.find('{')) {
        text += rest.substr(0, brace);
        const auto end = std::min(rest.find('}', brace), rest.size() - 1) + 1;
        text += rest.substr(brace, end - brace) == "{holder}" ? holder : entity;
        rest.remove_prefix(end);
    }
    return text += rest;
}

}  // namespace axon
