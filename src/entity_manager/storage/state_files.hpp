// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

#include "common/descriptor.hpp"

// What both that keep something in the state folder do with its files.
namespace axon::entity_manager {

/// An open file, closed at the end. A new one is this user's alone.
class File {
  public:
    File(const std::filesystem::path& path, int flags) : fd_(::open(path.c_str(), flags | O_CLOEXEC, 0600)) {}
    bool isOpen() const { return fd_.open(); }
    int fd() const { return fd_.get(); }
    Descriptor release() { return std::move(fd_); }

    bool writeAll(std::string_view bytes) const {
        while (!bytes.empty()) {
            const auto n = ::write(fd_.get(), bytes.data(), bytes.size());
            if (n < 0 && errno == EINTR) continue;
            if (n <= 0) return false;
            bytes.remove_prefix(static_cast<std::size_t>(n));
        }
        return true;
    }

  private:
    Descriptor fd_;
};

/// Two digits for each byte.
std::string hex(std::string_view bytes);

/// The name as a file's: letters, digits, '-', '_' and ' ' stay, other bytes become "%" and two digits, so
/// that no name is a path. Different names stay different.
std::string safeName(std::string_view name);

/// Makes the folder (mode 0700) where it is missing. Throws std::runtime_error that says how to fix it.
void makeFolder(const std::filesystem::path& folder);

/// What has been renamed or deleted in it outlives a loss of power from now on. False: it may not.
bool synchroniseFolder(const std::filesystem::path& folder);

}  // namespace axon::entity_manager
