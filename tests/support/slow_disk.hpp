// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <filesystem>

namespace axon::test {

/// A disk that takes its time, below everything that this process does to files of one folder: the functions
/// of the C library that touch them (open, write, rename, unlink, stat, …) are those of slow_disk.cpp, which
/// wait first. Reading is as fast as ever, and so are files that were opened before the folder was named.
///
/// In another program: preload the library, with the folder in AXON_SLOW_DISK. Each call takes two seconds
/// while the file
/// `<folder>/../slow` exists.
void makeSlow(const std::filesystem::path& folder, std::chrono::milliseconds each);
/// So many calls have waited.
std::uint64_t slowCalls();

}  // namespace axon::test
