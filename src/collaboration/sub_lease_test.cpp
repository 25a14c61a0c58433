// SPDX-License-Identifier: GPL-2.0-or-later
#include "collaboration/sub_lease.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <vector>

namespace axon::collaboration {
namespace {

const std::string kKey(16, 'k');
const std::string kRun(16, 'r');

struct Sealed {
    Sealed() {
        lease.set_epoch(3);
        lease.set_number(7);
        lease.set_root(std::string(16, 'o'));
        lease.set_stop_generation(5);
        seal(lease, grant, kKey);
    }
    proto::SubLease lease;
    Grant grant{kRun, "master", "entity"};
};

TEST(SubLease, HoldsForWhatItWasSealedFor) {
    const Sealed made;
    EXPECT_TRUE(isSealed(made.lease, made.grant, kKey));
}

TEST(SubLease, HoldsForNothingElse) {
    const std::vector<std::function<void(Sealed&)>> changes{
        [](Sealed& made) { made.lease.set_epoch(4); },
        [](Sealed& made) { made.lease.set_number(8); },
        [](Sealed& made) { made.lease.set_root(std::string(16, 'p')); },
        [](Sealed& made) { made.lease.set_stop_generation(6); },
        [](Sealed& made) { made.grant.master = "another"; },
        [](Sealed& made) { made.grant.entity = "another"; },
        [](Sealed& made) { made.grant.run_id = "another"; },
        // The same text all together, divided in another place.
        [](Sealed& made) { made.grant.master = "mastere", made.grant.entity = "ntity"; },
        [](Sealed& made) { made.lease.clear_proof(); },
        [](Sealed& made) { made.lease.mutable_proof()->pop_back(); },
        [](Sealed& made) { made.lease.mutable_proof()->back() ^= 1; },
    };
    for (std::size_t i = 0; i < changes.size(); ++i) {
        Sealed made;
        changes[i](made);
        EXPECT_FALSE(isSealed(made.lease, made.grant, kKey)) << "change " << i;
    }
    const Sealed made;
    EXPECT_FALSE(isSealed(made.lease, made.grant, std::string(16, 'x')));
}

}  // namespace
}  // namespace axon::collaboration
