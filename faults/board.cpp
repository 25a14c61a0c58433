// SPDX-License-Identifier: GPL-2.0-or-later
#include "board.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>

#include "common/descriptor.hpp"

namespace axon::faults {

namespace {
[[noreturn]] void fail(const char* what) {
    throw std::system_error(errno, std::generic_category(), what);
}
constexpr std::size_t bytes(std::size_t slots) {
    return sizeof(Desk) + slots * sizeof(Slot);
}
}  // namespace

std::int64_t nowNs() {
    timespec t{};
    ::clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
}

void Slot::stopped(std::uint32_t cause) {
    auto& mark = marks[stops.load() % kMarks];
    mark.cause = cause;
    mark.at = nowNs();
    ++stops;  // after the mark, which is then whole
}

const StopMark* Slot::firstStop(std::uint32_t before, std::int64_t since) const {
    const auto count = stops.load();
    // A stop that came between the reading of the counter and the fault is not the fault's.
    for (auto i = std::max(before, count > kMarks ? count - static_cast<std::uint32_t>(kMarks) : 0);
         i != count; ++i)
        if (marks[i % kMarks].at >= since) return &marks[i % kMarks];
    return nullptr;
}

Board::Board(const std::string& file, std::size_t slots, bool create) : count_(slots) {
    const Descriptor opened(
        ::open(file.c_str(), O_RDWR | O_CLOEXEC | (create ? O_CREAT | O_TRUNC : 0), 0600));
    if (!opened.open()) fail(file.c_str());
    // Fresh pages are zero, which is how slots begin.
    if (create && ::ftruncate(opened.get(), static_cast<off_t>(bytes(slots))) != 0) fail("ftruncate");
    memory_ = ::mmap(nullptr, bytes(slots), PROT_READ | PROT_WRITE, MAP_SHARED, opened.get(), 0);
    if (memory_ == MAP_FAILED) fail("mmap");
    desk_ = static_cast<Desk*>(memory_);
    slots_ = reinterpret_cast<Slot*>(static_cast<char*>(memory_) + sizeof(Desk));
}

Board::~Board() {
    ::munmap(memory_, bytes(count_));
}

}  // namespace axon::faults
