// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <new>
#include <string>

namespace axon::bench {

/// A file mapped into memory for as long as this lives. Throws std::system_error.
class MappedFile {
  public:
    MappedFile(const std::string& file, std::size_t size, bool create);
    ~MappedFile();
    MappedFile(const MappedFile&) = delete;
    MappedFile& operator=(const MappedFile&) = delete;
    char* memory() const { return memory_; }

  private:
    std::size_t size_;
    char* memory_;
};

/// Objects made of atomics in a file that the processes of a run map: how those that measure tell the one
/// that reports. Fresh memory is zero, which is what an object of T begins with.
template <class T>
class SharedArray {
  public:
    SharedArray(const std::string& file, std::size_t count, bool create)
        : count_(count), file_(file, sizeof(Head) + count * sizeof(T), create) {}
    T& operator[](std::size_t i) { return items()[i]; }
    std::size_t size() const { return count_; }
    /// How many of those who write it are ready.
    std::atomic<std::uint32_t>& ready() { return head().ready; }
    /// Set by the process that reports: they begin, or go on.
    std::atomic<std::uint32_t>& go() { return head().go; }

  private:
    struct alignas(64) Head {
        std::atomic<std::uint32_t> ready, go;
    };
    Head& head() { return *std::launder(reinterpret_cast<Head*>(file_.memory())); }
    T* items() { return std::launder(reinterpret_cast<T*>(file_.memory() + sizeof(Head))); }

    std::size_t count_;
    MappedFile file_;
};

}  // namespace axon::bench
