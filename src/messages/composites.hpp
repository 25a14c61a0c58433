// SPDX-License-Identifier: MIT
#pragma once
#include <axon/profile.pb.h>

#include <cstddef>
#include <string>
#include <vector>

namespace axon {

/// What the composite services of a profile come down to. The profile reader checks them with it, the Entity
/// Manager runs them by it, so a profile that the one accepts is one that the other can run. All numbers are
/// positions in the profile, from 0. docs/reference/profiles.md explains composites to users.
struct Composites {
    /// The way to one simple service: the composites around it, outermost first, and it itself last.
    using Part = std::vector<int>;
    /// A parameter or resource of a part that the composite shows under the name "Part.Name".
    struct View {
        int service;
        int item;
        bool operator==(const View&) const = default;
    };
    struct Fault {
        int service;
        bool error;  ///< else a warning
        std::string expected;
        std::string fix;
    };

    static constexpr std::size_t kParts = 256;                 ///< of one composite
    static constexpr std::size_t kPartsTogether = 4096;        ///< of all composites of a profile
    static constexpr int kLevels = 8;                          ///< of composites within composites
    static constexpr std::size_t kShownBytes = 1024UL * 1024;  ///< of all that the composites show, together

    /// Of each service, in the order in which they run. A simple service has one, itself; a composite that
    /// has a fault, or lists nothing, none.
    std::vector<std::vector<Part>> parts;
    std::vector<std::vector<View>> params;     ///< of each composite, in the order of its parts
    std::vector<std::vector<View>> resources;  ///< of each composite, in the order of its parts
    std::vector<Fault> faults;
};

/// INPUT or CONFIG: what a client may set.
bool isSettable(const proto::CtrlParam& meta);

/// "Part.Name".
std::string viewName(const proto::ServicesProfile& profile, int service, const std::string& name);

/// Any thread; no recursion, so the profile may be of any form. References to services that are not there,
/// and those that close a circle, are passed over: they are the reader's to report.
///
/// A composite shows what its parts need and give: their INPUT and CONFIG parameters and their resources,
/// those of the composites among them too, and the OUTPUT and FEEDBACK of the simple ones. It does not show
/// what a composite around the part declares itself as an INPUT or CONFIG of the same name: that value is the
/// part's.
Composites readComposites(const proto::ServicesProfile& profile);

}  // namespace axon
