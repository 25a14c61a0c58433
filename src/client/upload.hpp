// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "axon/client.hpp"
#include "client/base/session_observer.hpp"
#include "common/refusal.hpp"
#include "common/result.hpp"

namespace axon::client {

/// A file on its way to an entity, as its reader sees it: SHA-256 first, then pieces. Throws nothing; a file
/// that cannot be read is a refusal. Confined to the thread that uploads.
class ResourceFile {
  public:
    /// A file of more than `most` bytes (0 = no bound) is TOO_LARGE, before it is read.
    static Result<ResourceFile> open(const std::filesystem::path& path, std::uint64_t most = 0);
    std::uint64_t size() const { return size_; }
    const std::string& sha256() const { return sha256_; }
    /// Fewer bytes than asked for only at the end of the file.
    Result<std::string> read(std::uint64_t offset, std::size_t count);

  private:
    std::string name_;
    std::ifstream file_;
    std::uint64_t size_ = 0;
    std::string sha256_;
};

/// The window of one upload, between the thread that uploads and the one that hears of credits.
class UploadWindow {
  public:
    /// The first credit says where to begin: what is there already is not sent again. Later ones only go on.
    void credit(std::uint64_t offset, std::uint64_t limit);
    void finish(Refusal refusal);

    struct Turn {
        std::uint64_t from = 0, to = 0;  ///< may be sent now; empty when ended
        std::optional<Refusal> ended;
    };
    /// Waits until something may be sent beyond `sent`, or the upload has ended. The session's deadlines end
    /// every upload, so this returns.
    Turn next(std::optional<std::uint64_t> sent, std::uint64_t size);

  private:
    std::mutex mutex_;
    std::condition_variable changed_;
    bool begun_ = false;  // guarded by mutex_, like the rest
    std::uint64_t begin_ = 0, limit_ = 0;
    std::optional<Refusal> ended_;
};

/// CheckOut::upload(): offers the file, and sends it as far as the credits of the Entity Manager reach. On
/// the user's thread, which reads the file with no lock held.
Result<void> upload(Client::Session& session, const Held& held, std::string_view service,
                    std::string_view resource, const std::filesystem::path& path,
                    const std::function<void(std::uint64_t, std::uint64_t)>& progress,
                    const std::stop_token& give_up);

}  // namespace axon::client
