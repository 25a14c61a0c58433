// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "entity_manager/ports/ports.hpp"

namespace axon::testing {

/// What an Entity Manager keeps, in memory: its small values, and resources that were uploaded. It outlives
/// the Entity Managers that an entity has one after the other, as a state folder does. Threads: any.
class MemoryStore final : public entity_manager::Storage, public entity_manager::ResourceStore {
  public:
    std::optional<std::string> load(std::string_view key) override;
    void save(std::string_view key, std::string_view value) override;
    void forget(std::string_view key) override;

    entity_manager::Later<Result<std::uint64_t>> begin(const proto::ResourceOffer& offer,
                                                       const std::string& owner) override;
    Result<void> write(std::string_view transfer_id, std::uint64_t offset, std::string_view content) override;
    entity_manager::Later<Result<std::string>> check(std::string_view transfer_id) override;
    entity_manager::Later<Result<std::string>> place(std::string_view transfer_id) override;
    /// An upload that was broken off begins again.
    void suspend(std::string_view transfer_id) override { drop(transfer_id); }
    void drop(std::string_view transfer_id) override;
    void remove(std::string_view service, std::string_view resource) override;
    std::optional<std::string> find(std::string_view service, std::string_view resource) override;

    std::optional<std::string> content(std::string_view service, std::string_view resource) const;

  private:
    using Name = std::pair<std::string, std::string>;
    struct Transfer {
        Name of;
        std::uint64_t size;
        std::string content;
    };
    mutable std::mutex mutex_;
    std::map<std::string, std::string, std::less<>> values_;  // these three guarded by mutex_
    std::map<std::string, Transfer, std::less<>> transfers_;
    std::map<Name, std::string> resources_;
};

}  // namespace axon::testing
