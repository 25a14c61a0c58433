// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/slots.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <new>
#include <system_error>
#include <utility>

#include "audit/line.hpp"

namespace axon::audit {

namespace {

/// Before the slots: memory of another edition of this program is not read.
struct Beginning {
    static constexpr std::uint64_t kEdition = 0x41584f4e41554431U;  // "AXONAUD1"
    std::uint64_t edition = 0, slot_bytes = 0, slots = 0;
    bool operator==(const Beginning&) const = default;
};
constexpr std::size_t kBeginning = 64;
static_assert(sizeof(Beginning) <= kBeginning && alignof(Ring::Slot) <= kBeginning);
static_assert(std::atomic<std::size_t>::is_always_lock_free, "else its lock is another one in each process");

std::string said(int error) {
    return std::generic_category().message(error);
}

}  // namespace

std::string Slots::nameOf(const std::filesystem::path& folder, const std::string& name) {
    std::error_code ignored;
    const auto place = std::filesystem::weakly_canonical(folder, ignored) / name;
    return "/axon-audit-" + std::to_string(::geteuid()) + '-' + hashOf(place.string()).substr(0, 32);
}

Slots::Slots(const std::filesystem::path& folder, const std::string& name, std::size_t slots)
    : name_(nameOf(folder, name)) {
    slots = std::bit_ceil(std::max<std::size_t>(slots, 2));
    if (share(slots)) return;
    fd_.reset();
    own_ = std::make_unique<Ring::Slot[]>(slots);
    all_ = {own_.get(), slots};
    takeLeft();
}

Slots::~Slots() {
    if (mapped_ != nullptr) ::munmap(mapped_, bytes_);
}

bool Slots::share(std::size_t slots) {
    fd_ = Descriptor(::shm_open(name_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
    struct stat facts {};
    if (!fd_.open() || ::fstat(fd_.get(), &facts) != 0) {
        why_not_ = "shared memory cannot be had: " + said(errno);
        return false;
    }
    // Names in shared memory are anybody's to take.
    if (facts.st_uid != ::geteuid() || (facts.st_mode & 0077U) != 0 || !S_ISREG(facts.st_mode)) {
        why_not_ = "the shared memory " + name_ + " is not this user's alone; fix: delete it from /dev/shm";
        return false;
    }
    if (::flock(fd_.get(), LOCK_EX | LOCK_NB) != 0) {
        why_not_ = "another process has the shared memory " + name_;
        return false;
    }
    bytes_ = kBeginning + slots * sizeof(Ring::Slot);
    const Beginning expected{Beginning::kEdition, sizeof(Ring::Slot), slots};
    const bool fits = static_cast<std::size_t>(facts.st_size) == bytes_;
    // All of it now: memory that is not there would end the process where it is written to.
    const int none = fits || ::ftruncate(fd_.get(), 0) == 0
                         ? ::posix_fallocate(fd_.get(), 0, static_cast<off_t>(bytes_))
                         : errno;
    if (none != 0) {
        ::shm_unlink(name_.c_str());
        why_not_ = "shared memory cannot be had: " + said(none);
        return false;
    }
    auto* const mapped = ::mmap(nullptr, bytes_, PROT_READ | PROT_WRITE, MAP_SHARED, fd_.get(), 0);
    if (mapped == MAP_FAILED) {
        why_not_ = "shared memory cannot be had: " + said(errno);
        return false;
    }
    mapped_ = mapped;
    auto* const bytes = static_cast<std::byte*>(mapped);
    Beginning found;
    std::memcpy(&found, bytes, sizeof found);
    all_ = {reinterpret_cast<Ring::Slot*>(bytes + kBeginning), slots};
    if (found == expected) return true;
    for (auto& slot : all_) new (&slot) Ring::Slot;
    takeLeft();
    std::memcpy(bytes, &expected, sizeof expected);
    return true;
}

std::vector<Ring::Kept> Slots::takeLeft() {
    const auto mask = all_.size() - 1;
    std::vector<std::pair<std::size_t, std::size_t>> left;  // whose turn it was, and where
    for (std::size_t i = 0; i < all_.size(); ++i) {
        const auto turn = all_[i].turn.load(std::memory_order_acquire);
        if (turn != 0 && ((turn - 1) & mask) == i && all_[i].kept.sound()) left.emplace_back(turn, i);
    }
    std::sort(left.begin(), left.end());
    std::vector<Ring::Kept> notes;
    notes.reserve(left.size());
    for (const auto& [turn, at] : left) notes.push_back(all_[at].kept);
    for (std::size_t i = 0; i < all_.size(); ++i) all_[i].turn.store(i, std::memory_order_release);
    return notes;
}

void Slots::forget() {
    if (fd_.open()) ::shm_unlink(name_.c_str());
}

}  // namespace axon::audit
