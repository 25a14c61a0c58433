// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstddef>
#include <cstdint>

#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// How the last runs went that this entity was the master of, newest first, for people who ask later. It
/// outlives the process: a run that an earlier life began and did not end is UNKNOWN. Bounded by number and
/// bytes: the oldest go, and of a large run parameters and results are left out. Threads: the core's strand.
class RunRecords {
  public:
    static constexpr int kRuns = 32;
    static constexpr std::size_t kBytes = 512 * 1024;     ///< together
    static constexpr std::size_t kRunBytes = 128 * 1024;  ///< of one

    /// What cannot be read in the storage counts as none.
    explicit RunRecords(Storage& storage);

    /// In the place of what was kept of the same run; does not wait for the disk.
    void keep(const proto::RunRecord& record);
    /// The newest `most`; 0 = all. `present`: the run as it is now, in the place of what was kept of it at
    /// its beginning; null when there is none.
    proto::RunHistory history(const proto::RunRecord* present, std::uint32_t most) const;

  private:
    Storage& storage_;
    proto::RunHistory runs_;
};

}  // namespace axon::entity_manager
