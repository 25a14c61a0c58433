// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <string>

#include "certificates/certificate.hpp"

namespace axon::certificates {

/// For tests: what the action says is unusable, with the fix; "accepted" where nothing is.
inline std::string complaint(const std::function<void()>& action) {
    try {
        action();
    } catch (const Unusable& unusable) {
        return std::string(unusable.what()) + "; fix: " + unusable.fix();
    }
    return "accepted";
}

}  // namespace axon::certificates
