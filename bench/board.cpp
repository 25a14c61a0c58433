// SPDX-License-Identifier: GPL-2.0-or-later
#include "board.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>

namespace axon::bench {

namespace {
[[noreturn]] void fail(const char* what) { throw std::system_error(errno, std::generic_category(), what); }
constexpr char kFiller = 'a';
}  // namespace

Board::Board(const std::string& file, std::size_t slots, bool create) : count_(slots) {
    const int fd = ::open(file.c_str(), O_RDWR | (create ? O_CREAT | O_TRUNC : 0), 0600);
    if (fd < 0) fail(file.c_str());
    const auto size = static_cast<off_t>((slots + 1) * sizeof(Slot));  // fresh pages are zero: empty slots
    if (create && ::ftruncate(fd, size) != 0) fail("ftruncate");
    void* memory = ::mmap(nullptr, static_cast<std::size_t>(size), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    ::close(fd);
    if (memory == MAP_FAILED) fail("mmap");
    slots_ = static_cast<Slot*>(memory);
}

Board::~Board() { ::munmap(slots_, (count_ + 1) * sizeof(Slot)); }

std::int64_t nowNs() {
    timespec t{};
    ::clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
}

std::string batch(std::size_t bytes) {
    std::string content(bytes, kFiller);
    for (std::size_t i = 0; i < bytes; ++i) content[i] = static_cast<char>(kFiller + i % 23);
    return content;
}

bool batchIntact(const char* begin, std::size_t size) {
    // Every 61st byte and the last: a lost, shifted or swapped block shows, and the check costs less than the transport.
    for (std::size_t i = 0; i < size; i += 61)
        if (begin[i] != static_cast<char>(kFiller + i % 23)) return false;
    return size > 0 && begin[size - 1] == static_cast<char>(kFiller + (size - 1) % 23);
}

}  // namespace axon::bench
