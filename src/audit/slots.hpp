// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "audit/ring.hpp"
#include "common/descriptor.hpp"

namespace axon::audit {

/// The slots of a Ring, in memory that outlives a kill of the process: a POSIX shared memory object of the
/// trail's own, which the next life of the program finds. Nothing of it is on a disk, so nobody who writes
/// into it ever waits for one; a restart of the machine loses it.
///
/// Where there can be no such memory (none is left, or another process of this user has it) they are in
/// memory that ends with the process; whyNot() says why.
///
/// Threads: one. Ownership: whoever has it gives the slots to a Ring, which must not outlive it. Life: the
/// object stays until forget() is called.
class Slots {
  public:
    /// `folder` and `name` are the trail's. `slots`: rounded up to a power of two.
    Slots(const std::filesystem::path& folder, const std::string& name, std::size_t slots);
    ~Slots();
    Slots(const Slots&) = delete;
    Slots& operator=(const Slots&) = delete;

    /// What a life that was killed has left in them, in its order; they are empty then. To be called before a
    /// Ring has them.
    std::vector<Ring::Kept> takeLeft();
    std::span<Ring::Slot> all() const { return all_; }
    /// Empty where they outlive the process.
    const std::string& whyNot() const { return why_not_; }
    /// Nothing waits in them any more: the object goes with the process.
    void forget();

    /// The name of the object, for shm_open(3).
    static std::string nameOf(const std::filesystem::path& folder, const std::string& name);

  private:
    bool share(std::size_t slots);

    const std::string name_;
    std::string why_not_;
    Descriptor fd_;  // locked as long as it is open
    void* mapped_ = nullptr;
    std::size_t bytes_ = 0;
    std::unique_ptr<Ring::Slot[]> own_;
    std::span<Ring::Slot> all_;
};

}  // namespace axon::audit
