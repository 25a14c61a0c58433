// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>

#include "entity_manager/ports.hpp"

namespace axon::entity_manager {

/// Storage in a folder, one file for each key, named by the key's hexadecimal digits so that no key can be a
/// path. Values are written to a new file, synchronised and renamed: after a crash there is the old or the
/// new value. Threads: one at a time; one of its own writes what is to be kept, and tries again each second
/// while it cannot. Bounded: one value waits for each key. Failure: std::system_error with the file's name.
class FileStorage final : public Storage {
  public:
    /// Makes the folder (mode 0700) where it is missing.
    explicit FileStorage(std::filesystem::path folder);
    /// Tries once more to write what waits.
    ~FileStorage() override;
    std::optional<std::string> load(std::string_view key) override;
    void save(std::string_view key, std::string_view value) override;
    void keep(std::string_view key, std::string_view value) override;
    void forget(std::string_view key) override;

  private:
    std::filesystem::path pathOf(std::string_view key) const;
    std::filesystem::path write(std::string_view key, std::string_view value) const;
    void run();

    const std::filesystem::path folder_;
    std::mutex mutex_;  // held for a rename or a removal: what is forgotten does not come back
    std::condition_variable wake_;
    std::map<std::string, std::string, std::less<>> waiting_;  // guarded by mutex_
    bool ending_ = false;                                      // guarded by mutex_
    std::thread thread_;                                       // last: it uses the others
};

/// Resources in <folder>/resources/<service>/<resource>/: the file "content" once it is complete, and beside
/// it "stored" once the disk has it. What is still arriving lies in <folder>/incoming/, named by its SHA-256
/// and size, so that a later offer of the same content resumes and a different one does not; beside it,
/// ".state" says how much has been hashed. It goes with its holder (dropSuspended), and what an earlier life
/// has left there when it has not grown for kIncomingKept. Service and resource names become safe folder
/// names (letters, digits, '-', '_', ' ' stay; any other byte is %XX).
///
/// No call waits for the disk to write or synchronise what was uploaded, or reads what has arrived before: a gigabyte would
/// hold up the strand, and the robot would stop for want of heartbeats. One thread writes and hashes what write()
/// takes, and notes and closes what is suspended. Another synchronises what finish() has put in its place and then
/// writes "stored"; a file that has none, because the power was lost before, is not found by a next life and is
/// uploaded again. begin() and finish() open and rename in the caller's thread.
///
/// Threads: one at a time; two of its own. Bounded: what waits to be written by whoever calls write(), who asks
/// waiting() first, and begin() takes nothing new above kBacklog; kUnsynchronised files wait for their thread, of more the
/// oldest is not marked. Failure: refusals; the message names the file. A disk that is full is OVERLOADED, and so is one
/// that has not yet got rid of a dropped or failed transfer when the same content is offered again (kPatience); a
/// suspended one just goes on, written or not.
class FileResourceStore final : public ResourceStore {
  public:
    static constexpr std::size_t kUnsynchronised = 64;
    static constexpr std::chrono::hours kIncomingKept{24};
    static constexpr std::uint64_t kBacklog = 8U << 20U;
    static constexpr std::chrono::milliseconds kPatience{40};  ///< below the shortest watchdog of the link

    explicit FileResourceStore(std::filesystem::path folder);
    ~FileResourceStore() override;

    Result<std::uint64_t> begin(const proto::ResourceOffer& offer) override;
    Result<void> write(std::string_view transfer_id, std::uint64_t offset, std::string_view content) override;
    Result<std::uint64_t> waiting(std::string_view transfer_id) const override;
    void onWritten(std::function<void()> changed) override;
    Result<std::string> finish(std::string_view transfer_id) override;
    void suspend(std::string_view transfer_id) override;
    void dropSuspended() override;
    void remove(std::string_view service, std::string_view resource) override;
    std::optional<std::string> find(std::string_view service, std::string_view resource) override;

  private:
    struct Transfer;
    class Synchroniser;
    class Writer;
    std::filesystem::path placeOf(std::string_view service, std::string_view resource) const;
    void dropIncoming(std::filesystem::file_time_type older_than);

    std::filesystem::path folder_;
    std::map<std::string, std::shared_ptr<Transfer>, std::less<>> transfers_;
    std::set<std::filesystem::path> placed_;  ///< in this life: found whether the disk has them or not
    std::unique_ptr<Synchroniser> synchroniser_;
    std::unique_ptr<Writer> writer_;
};

}  // namespace axon::entity_manager
