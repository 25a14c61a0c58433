// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/state_files.hpp"

#include <sodium.h>

#include <array>
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

std::string safeName(std::string_view name) {
    std::string safe;
    for (const char c : name) {
        const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                           c == '-' || c == '_' || c == ' ';
        safe += plain ? std::string(1, c) : "%" + hex({&c, 1});
    }
    if (safe.empty()) return "%";
    // Longer than a file system's names may be: the beginning, for people, and a hash, for uniqueness.
    if (safe.size() <= 200) return safe;
    std::array<unsigned char, crypto_generichash_BYTES> hash{};
    crypto_generichash(hash.data(), hash.size(), reinterpret_cast<const unsigned char*>(name.data()),
                       name.size(), nullptr, 0);
    return safe.substr(0, 100) + '%' + hex({reinterpret_cast<const char*>(hash.data()), 16});
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
