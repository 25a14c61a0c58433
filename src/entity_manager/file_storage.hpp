// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "entity_manager/ports.hpp"

namespace axon::entity_manager {

/// Storage in a folder, one file for each key, named by the key's hexadecimal digits so that no key can be a
/// path. Values are written to a new file, synchronised and renamed: after a crash there is the old or the
/// new value. Threads: one at a time. Failure: std::system_error with the file's name.
class FileStorage final : public Storage {
  public:
    /// Makes the folder (mode 0700) where it is missing.
    explicit FileStorage(std::filesystem::path folder);
    std::optional<std::string> load(std::string_view key) override;
    void save(std::string_view key, std::string_view value) override;

  private:
    std::filesystem::path pathOf(std::string_view key) const;
    std::filesystem::path folder_;
};

/// Resources in <folder>/resources/<service>/<resource>/: the file "content" once it is complete, and beside
/// it "stored" once the disk has it. What is still arriving lies in <folder>/incoming/, named by its SHA-256
/// and size, so that a later offer of the same content resumes and a different one does not; beside it,
/// ".state" says how much has been hashed. Service and resource names become safe folder names (letters,
/// digits, '-', '_', ' ' stay; any other byte is %XX).
///
/// No call waits for the disk to synchronise, or reads what has arrived before: a gigabyte would hold up the
/// strand, and the robot would stop for want of heartbeats. A thread of its own synchronises what finish()
/// has put in its place and then writes "stored"; a file that has none, because the power was lost before, is
/// not found by a next life and is uploaded again.
///
/// Threads: one at a time; one of its own. Bounded: kUnsynchronised files wait for that thread, of more the
/// oldest is not marked. Failure: refusals; the message names the file. A disk that is full is OVERLOADED.
class FileResourceStore final : public ResourceStore {
  public:
    static constexpr std::size_t kUnsynchronised = 64;

    explicit FileResourceStore(std::filesystem::path folder);
    ~FileResourceStore() override;

    Result<std::uint64_t> begin(const proto::ResourceOffer& offer) override;
    Result<void> write(std::string_view transfer_id, std::uint64_t offset, std::string_view content) override;
    Result<std::string> finish(std::string_view transfer_id) override;
    void suspend(std::string_view transfer_id) override;
    void remove(std::string_view service, std::string_view resource) override;
    std::optional<std::string> find(std::string_view service, std::string_view resource) override;

  private:
    struct Transfer;
    class Synchroniser;
    std::filesystem::path placeOf(std::string_view service, std::string_view resource) const;

    std::filesystem::path folder_;
    std::map<std::string, std::unique_ptr<Transfer>, std::less<>> transfers_;
    std::set<std::filesystem::path> placed_;  ///< in this life: found whether the disk has them or not
    std::unique_ptr<Synchroniser> synchroniser_;
};

}  // namespace axon::entity_manager
