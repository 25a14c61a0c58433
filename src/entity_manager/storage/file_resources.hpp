// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// Resources in <folder>/resources/<service>/<resource>/: the file "content", and beside it "stored" once the
/// disk has it. What is still arriving, and what the robot application has not accepted yet, lies in
/// <folder>/incoming/, named by its SHA-256 and size, so that a later offer of the same content resumes and a
/// different one does not; beside it,
/// ".state" says how much has been hashed, and for whom it is kept. What nobody goes on with is deleted when
/// it has not grown for kIncomingKept, and before that, the oldest first, when more than `kept_bytes` of it
/// is there. Service and resource names become safe folder names (letters, digits, '-', '_', ' ' stay; any
/// other byte is %XX). A resource whose profile gives a url lies there instead (resource_places.hpp).
///
/// One thread does everything that the disk may delay, in the order of the calls: a gigabyte would hold up
/// the strand, and the robot would stop for want of heartbeats. Another synchronises what place() has put
/// there and then writes "stored"; a file that has none, because the power was lost before, is not found by a
/// next life and is uploaded again.
///
/// Threads: one at a time; two of its own. Bounded: what waits to be written by whoever calls write(), who
/// asks waiting() first; begin() takes nothing new above kBacklog bytes or kJobs pieces of work that wait,
/// and write() no more pieces than that; kUnsynchronised files wait for their thread, of more the oldest is
/// not marked. Failure: refusals; the message names the file. A disk that is full is OVERLOADED.
class FileResourceStore final : public ResourceStore {
  public:
    static constexpr std::size_t kUnsynchronised = 64;
    static constexpr std::chrono::hours kIncomingKept{24};
    static constexpr std::uint64_t kBacklog = 8U << 20U;
    static constexpr std::size_t kJobs = 4096;

    explicit FileResourceStore(std::filesystem::path folder, std::uint64_t kept_bytes = 1ULL << 30U);
    ~FileResourceStore() override;

    Later<Result<std::uint64_t>> begin(const proto::ResourceOffer& offer, const std::string& owner) override;
    Result<void> write(std::string_view transfer_id, std::uint64_t offset, std::string_view content) override;
    Result<std::uint64_t> waiting(std::string_view transfer_id) const override;
    void onAnswer(std::function<void()> come) override;
    Later<Result<std::string>> check(std::string_view transfer_id) override;
    Later<Result<std::string>> place(std::string_view transfer_id) override;
    void suspend(std::string_view transfer_id) override;
    void drop(std::string_view transfer_id) override;
    void remove(std::string_view service, std::string_view resource) override;
    std::optional<std::string> find(std::string_view service, std::string_view resource) override;
    /// At once where no resource has a url.
    Later<std::vector<ResourcePlace>> locate(const ResourceRoots& roots,
                                             std::vector<ResourceQuery> queries) override;
    Later<std::vector<std::string>> absent(std::vector<std::string> files) override;

  private:
    class Transfer;
    class Synchroniser;
    class Worker;
    std::filesystem::path placeOf(std::string_view service, std::string_view resource) const;
    std::shared_ptr<Transfer> take(std::string_view transfer_id);
    void findStored();
    // On the worker's thread.
    const std::string* urlOf(const std::string& service, const std::string& resource) const;
    Result<std::string> putInPlace(Transfer& transfer);
    void close(Transfer& transfer);
    void discard(Transfer& transfer);
    void tidyIncoming();

    const std::filesystem::path folder_;
    const std::uint64_t kept_bytes_;
    std::map<std::string, std::shared_ptr<Transfer>, std::less<>> transfers_;
    std::mutex mutex_;  // never held while the disk is at work
    std::map<std::filesystem::path, std::uint64_t>
        stored_;                            // guarded by mutex_: places of what find() finds; bytes
    std::set<std::filesystem::path> open_;  // the worker's: what of incoming/ is being used
    ResourceRoots roots_;                   // the worker's; this and the next as locate() was told
    std::map<std::pair<std::string, std::string>, std::string> urls_;
    std::unique_ptr<Synchroniser> synchroniser_;
    std::unique_ptr<Worker> worker_;  // last: its thread uses the others
};

}  // namespace axon::entity_manager
