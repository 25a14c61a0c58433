// SPDX-License-Identifier: GPL-2.0-or-later
#include "board.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <system_error>

#include "common/descriptor.hpp"

namespace axon::bench {

namespace {
[[noreturn]] void fail(const char* what) {
    throw std::system_error(errno, std::generic_category(), what);
}

// One string on the wire: its tag, its length, its characters.
constexpr std::size_t kString = 7, kNumberAt = 2;
constexpr int kNumberDigits = 5, kBitsOfDigit = 6;
}  // namespace

MappedFile::MappedFile(const std::string& file, std::size_t size, bool create) : size_(size) {
    const Descriptor opened(::open(file.c_str(), O_RDWR | (create ? O_CREAT | O_TRUNC : 0), 0600));
    if (!opened.open()) fail(file.c_str());
    if (create && ::ftruncate(opened.get(), static_cast<off_t>(size)) != 0) fail("ftruncate");
    void* memory = ::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, opened.get(), 0);
    if (memory == MAP_FAILED) fail("mmap");
    memory_ = static_cast<char*>(memory);
}

MappedFile::~MappedFile() {
    ::munmap(memory_, size_);
}

void Slot::arrived(Kind kind, std::int64_t when, const char* bytes, std::size_t size) {
    auto& row = of(kind);
    const auto number = readContent(bytes, size);
    if (!number) {
        ++corrupt;
        return;
    }
    if (*number != row.next) ++misplaced;
    row.note(*number, when);
    ++intact;
}

std::int64_t nowNs() {
    timespec t{};
    ::clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
}

std::string content(std::size_t bytes) {
    std::string all;
    all.reserve(bytes + kString);
    for (std::size_t i = 0; all.size() < bytes; ++i) {
        all += "\x0a\x05";  // field 1, five bytes
        for (std::size_t k = 0; k < kString - 2; ++k) all += static_cast<char>('a' + (i * 5 + k) % 23);
    }
    all.resize(bytes);
    setNumber(all, 0);
    return all;
}

void setNumber(std::string& content, std::uint32_t number) {
    for (int digit = 0; digit < kNumberDigits; ++digit, number >>= kBitsOfDigit)
        content[kNumberAt + static_cast<std::size_t>(digit)] =
            static_cast<char>('0' + (number & ((1U << kBitsOfDigit) - 1)));
}

std::optional<std::uint32_t> readContent(const char* begin, std::size_t size) {
    constexpr auto kNumberEnd = kNumberAt + kNumberDigits;
    thread_local std::string expected;
    if (expected.size() < size) expected = content(size);
    if (size < kNumberEnd || std::memcmp(begin, expected.data(), kNumberAt) != 0 ||
        std::memcmp(begin + kNumberEnd, expected.data() + kNumberEnd, size - kNumberEnd) != 0)
        return std::nullopt;
    std::uint32_t number = 0;
    for (int digit = kNumberDigits - 1; digit >= 0; --digit) {
        const auto value =
            static_cast<std::uint32_t>(begin[kNumberAt + static_cast<std::size_t>(digit)] - '0');
        if (value >= 1U << kBitsOfDigit) return std::nullopt;
        number = number << kBitsOfDigit | value;
    }
    return number;
}

}  // namespace axon::bench
