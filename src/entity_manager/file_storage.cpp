// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/file_storage.hpp"

#include <axon/transfer.pb.h>
#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <stdexcept>
#include <system_error>
#include <utility>
#include <vector>

namespace axon::entity_manager {

namespace fs = std::filesystem;

namespace {

class File {
  public:
    File(const fs::path& path, int flags) : fd_(::open(path.c_str(), flags | O_CLOEXEC, 0600)) {}
    ~File() {
        if (fd_ >= 0) ::close(fd_);
    }
    File(const File&) = delete;
    File& operator=(const File&) = delete;
    bool isOpen() const { return fd_ >= 0; }
    int fd() const { return fd_; }

    bool writeAll(std::string_view bytes) const {
        while (!bytes.empty()) {
            const auto n = ::write(fd_, bytes.data(), bytes.size());
            if (n < 0 && errno == EINTR) continue;
            if (n <= 0) return false;
            bytes.remove_prefix(static_cast<std::size_t>(n));
        }
        return true;
    }

  private:
    int fd_;
};

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
    fs::create_directories(folder);
    fs::permissions(folder, fs::perms::owner_all);
}

[[noreturn]] void fail(const char* what, const fs::path& path) {
    throw std::system_error(errno, std::generic_category(), std::string(what) + ' ' + path.string());
}

void synchroniseFolder(const fs::path& folder) {
    const File handle(folder, O_RDONLY | O_DIRECTORY);
    if (handle.isOpen()) ::fsync(handle.fd());
}

Refusal storeRefusal(const char* what, const fs::path& path) {
    const auto error = errno;
    const bool full = error == ENOSPC || error == EDQUOT;
    return {full ? RefusalCode::Overloaded : RefusalCode::Internal,
            std::string("The Entity Manager cannot ") + what + ' ' + path.string() + ": " +
                std::generic_category().message(error) + '.',
            {}};
}

}  // namespace

FileStorage::FileStorage(fs::path folder) : folder_(std::move(folder)) {
    makeFolder(folder_);
}

fs::path FileStorage::pathOf(std::string_view key) const {
    return folder_ / (hex(key) + ".value");
}

std::optional<std::string> FileStorage::load(std::string_view key) {
    const auto path = pathOf(key);
    const File file(path, O_RDONLY);
    if (!file.isOpen()) {
        if (errno == ENOENT) return std::nullopt;
        fail("cannot open", path);
    }
    std::string value;
    std::array<char, 4096> part{};
    while (true) {
        const auto n = ::read(file.fd(), part.data(), part.size());
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) fail("cannot read", path);
        if (n == 0) return value;
        value.append(part.data(), static_cast<std::size_t>(n));
    }
}

void FileStorage::save(std::string_view key, std::string_view value) {
    const auto path = pathOf(key);
    auto fresh = path;
    fresh += ".new";
    {
        const File file(fresh, O_WRONLY | O_CREAT | O_TRUNC);
        if (!file.isOpen() || !file.writeAll(value) || ::fsync(file.fd()) != 0) fail("cannot write", fresh);
    }
    if (::rename(fresh.c_str(), path.c_str()) != 0) fail("cannot replace", path);
    synchroniseFolder(folder_);
}

struct FileResourceStore::Transfer {
    std::string service;
    std::string resource;
    std::string sha256;
    std::uint64_t size = 0;
    std::uint64_t written = 0;
    fs::path path;
    File file;
    crypto_hash_sha256_state hash{};

    explicit Transfer(const fs::path& incoming)
        : path(incoming), file(incoming, O_RDWR | O_CREAT | O_NOFOLLOW) {
        crypto_hash_sha256_init(&hash);
    }
    void feed(std::string_view bytes) {
        crypto_hash_sha256_update(&hash, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
    }
};

FileResourceStore::FileResourceStore(fs::path folder) : folder_(std::move(folder)) {
    if (sodium_init() < 0) throw std::runtime_error("libsodium could not be initialised.");
    makeFolder(folder_ / "resources");
    makeFolder(folder_ / "incoming");
}

FileResourceStore::~FileResourceStore() = default;

fs::path FileResourceStore::placeOf(std::string_view service, std::string_view resource) const {
    return folder_ / "resources" / safeName(service) / safeName(resource);
}

Result<std::uint64_t> FileResourceStore::begin(const proto::ResourceOffer& offer) {
    const auto incoming = folder_ / "incoming" / (hex(offer.sha256()) + '-' + std::to_string(offer.size()));
    for (const auto& [id, other] : transfers_)
        if (other->path == incoming)
            return Refusal{
                RefusalCode::Duplicate, "The same content is being uploaded already. Wait for its end.", {}};
    auto transfer = std::make_unique<Transfer>(incoming);
    if (!transfer->file.isOpen()) return storeRefusal("open", incoming);
    transfer->service = offer.service();
    transfer->resource = offer.resource();
    transfer->sha256 = offer.sha256();
    transfer->size = offer.size();
    // What is there already is read once, so that finish() need not read the whole file again.
    std::vector<char> part(64 * 1024);
    while (true) {
        const auto n = ::read(transfer->file.fd(), part.data(), part.size());
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return storeRefusal("read", incoming);
        if (n == 0) break;
        transfer->feed({part.data(), static_cast<std::size_t>(n)});
        transfer->written += static_cast<std::uint64_t>(n);
    }
    if (transfer->written > transfer->size) {
        if (::ftruncate(transfer->file.fd(), 0) != 0 || ::lseek(transfer->file.fd(), 0, SEEK_SET) != 0)
            return storeRefusal("empty", incoming);
        crypto_hash_sha256_init(&transfer->hash);
        transfer->written = 0;
    }
    const auto here = transfer->written;
    transfers_[offer.transfer_id()] = std::move(transfer);
    return here;
}

Result<void> FileResourceStore::write(std::string_view transfer_id, std::uint64_t offset,
                                      std::string_view content) {
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end()) return Refusal{RefusalCode::UnknownResource, "There is no such upload.", {}};
    auto& transfer = *at->second;
    if (offset != transfer.written || content.size() > transfer.size - transfer.written)
        return Refusal{RefusalCode::Malformed, "The chunk does not continue the upload.", {}};
    if (!transfer.file.writeAll(content)) {
        auto refusal = storeRefusal("write", transfer.path);
        // A part of the chunk may be there: what was complete before it still is.
        [[maybe_unused]] const auto cut =
            ::ftruncate(transfer.file.fd(), static_cast<off_t>(transfer.written));
        return refusal;
    }
    transfer.feed(content);
    transfer.written += content.size();
    return {};
}

Result<std::string> FileResourceStore::finish(std::string_view transfer_id) {
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end()) return Refusal{RefusalCode::UnknownResource, "There is no such upload.", {}};
    const auto transfer = std::move(at->second);
    transfers_.erase(at);
    std::array<unsigned char, crypto_hash_sha256_BYTES> digest{};
    crypto_hash_sha256_final(&transfer->hash, digest.data());
    if (transfer->written != transfer->size ||
        std::string_view(reinterpret_cast<const char*>(digest.data()), digest.size()) != transfer->sha256) {
        std::error_code ignored;
        fs::remove(transfer->path, ignored);
        return Refusal{
            RefusalCode::HashMismatch,
            "What arrived has not the SHA-256 that was offered; it was deleted. Upload the file again.",
            {}};
    }
    if (::fsync(transfer->file.fd()) != 0) return storeRefusal("write", transfer->path);
    const auto place = placeOf(transfer->service, transfer->resource);
    std::error_code error;
    fs::create_directories(place, error);
    const auto path = place / "content";
    if (error || ::rename(transfer->path.c_str(), path.c_str()) != 0)
        return storeRefusal("put in its place", path);
    synchroniseFolder(place);
    return fs::absolute(path).string();
}

void FileResourceStore::suspend(std::string_view transfer_id) {
    const auto at = transfers_.find(transfer_id);
    if (at != transfers_.end()) transfers_.erase(at);
}

void FileResourceStore::remove(std::string_view service, std::string_view resource) {
    std::error_code ignored;
    fs::remove_all(placeOf(service, resource), ignored);
}

std::optional<std::string> FileResourceStore::find(std::string_view service, std::string_view resource) {
    const auto path = placeOf(service, resource) / "content";
    std::error_code error;
    if (!fs::is_regular_file(path, error) || error) return std::nullopt;
    return fs::absolute(path).string();
}

}  // namespace axon::entity_manager
