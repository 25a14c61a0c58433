// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>

#include "common/descriptor.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// Storage in a folder, one file for each key, KEY.state (safeName, so that no key can be a path). Values are
/// written to a new file, synchronised and renamed: after a crash there is the old or the new value. Threads:
/// one at a time; one of its own writes what is to be kept and deletes what is to be forgotten, that first,
/// and tries again each second while it cannot. Bounded: one value waits for each key. One process has the
/// folder: whose lock it cannot get is a std::runtime_error that names the other one, by the constructor.
/// Failure: std::system_error with the file's name.
class FileStorage final : public Storage {
  public:
    /// Makes the folder (mode 0700) where it is missing. A folder with files *.value, of builds before 0.1,
    /// is a std::runtime_error that says what to do. `on_thread` is called first on its thread.
    explicit FileStorage(std::filesystem::path folder, std::function<void()> on_thread = {});
    /// Tries once more to write what waits.
    ~FileStorage() override;
    std::optional<std::string> load(std::string_view key) override;
    void save(std::string_view key, std::string_view value) override;
    void keep(std::string_view key, std::string_view value) override;
    void forget(std::string_view key) override;

  private:
    /// Waits to be written; nothing = waits to be deleted.
    using Wish = std::optional<std::string>;
    std::filesystem::path pathOf(std::string_view key) const;
    std::filesystem::path write(std::string_view key, std::string_view value) const;
    void want(std::string_view key, Wish wish);
    bool carryOut(const std::string& key, const Wish& wish) const;
    void run();

    const std::filesystem::path folder_;
    Descriptor lock_;
    std::mutex mutex_;  // never held while the disk is at work
    std::condition_variable wake_;
    std::map<std::string, Wish, std::less<>> waiting_;  // guarded by mutex_
    bool ending_ = false;                               // guarded by mutex_
    std::thread thread_;                                // last: it uses the others
};

}  // namespace axon::entity_manager
