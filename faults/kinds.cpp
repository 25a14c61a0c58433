// SPDX-License-Identifier: GPL-2.0-or-later
#include "kinds.hpp"

#include <algorithm>

namespace axon::faults {

bool Run::goOn() {
    progress(report.trials, trials);
    return !interrupted() && report.trials < trials;
}

std::uint64_t Run::among(std::uint64_t least, std::uint64_t most) {
    return least + random.next() % (most - least + 1);
}

const std::vector<Kind>& kinds() {
    static const std::vector<Kind> all = [] {
        auto every = stopKinds();
        for (const auto& more : {loginKinds, commandKinds, loadKinds})
            for (auto& kind : more()) every.push_back(std::move(kind));
        std::stable_sort(every.begin(), every.end(),
                         [](const Kind& a, const Kind& b) { return a.trial < b.trial; });
        return every;
    }();
    return all;
}

const Kind* findKind(const std::string& name) {
    for (const auto& kind : kinds())
        if (kind.name == name) return &kind;
    return nullptr;
}

}  // namespace axon::faults
