// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/state_files.hpp"

#include <stdexcept>

namespace axon::entity_manager {

namespace fs = std::filesystem;

std::string hex(std::string_view bytes) {
    static constexpr char kDigits[] = "0123456789abcdef";
    std::string text;
    for (const char c : bytes) {
        text += kDigits[static_cast<unsigned char>(c) >> 4U];
        text += kDigits[static_cast<unsigned char>(c) & 0x0fU];
    }
    return text;
}

void makeFolder(const fs::path& folder) {
    try {
        fs::create_directories(folder);
        fs::permissions(folder, fs::perms::owner_all);
    } catch (const fs::filesystem_error& error) {
        throw std::runtime_error("the state folder " + folder.string() +
                                 " cannot be made or used: " + error.code().message() +
                                 "; fix: make it a folder of this user, or name another with "
                                 "--state DIR (Axon.State)");
    }
}

bool synchroniseFolder(const fs::path& folder) {
    const File handle(folder, O_RDONLY | O_DIRECTORY);
    return handle.isOpen() && ::fsync(handle.fd()) == 0;
}

}  // namespace axon::entity_manager
