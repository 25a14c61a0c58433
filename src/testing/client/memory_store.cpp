// SPDX-License-Identifier: GPL-2.0-or-later
#include "testing/client/memory_store.hpp"

#include <axon/transfer.pb.h>

namespace axon::testing {

namespace {
using entity_manager::Later;

/// There is no file; an application that looks for it would say so.
std::string pathOf(const std::pair<std::string, std::string>& name) {
    return "/memory/" + name.first + "/" + name.second;
}
Refusal noTransfer() {
    return {RefusalCode::UnknownResource, "There is no such upload.", {}};
}
}  // namespace

std::optional<std::string> MemoryStore::load(std::string_view key) {
    const std::lock_guard lock(mutex_);
    const auto found = values_.find(key);
    return found == values_.end() ? std::nullopt : std::optional(found->second);
}
void MemoryStore::save(std::string_view key, std::string_view value) {
    const std::lock_guard lock(mutex_);
    values_.insert_or_assign(std::string(key), std::string(value));
}
void MemoryStore::forget(std::string_view key) {
    const std::lock_guard lock(mutex_);
    values_.erase(std::string(key));
}

Later<Result<std::uint64_t>> MemoryStore::begin(const proto::ResourceOffer& offer, const std::string&) {
    const std::lock_guard lock(mutex_);
    transfers_.insert_or_assign(offer.transfer_id(),
                                Transfer{{offer.service(), offer.resource()}, offer.size(), {}});
    return Result<std::uint64_t>(0);
}

Result<void> MemoryStore::write(std::string_view transfer_id, std::uint64_t offset,
                                std::string_view content) {
    const std::lock_guard lock(mutex_);
    const auto found = transfers_.find(transfer_id);
    if (found == transfers_.end() || offset != found->second.content.size()) return noTransfer();
    found->second.content += content;
    return {};
}

Later<Result<std::string>> MemoryStore::check(std::string_view transfer_id) {
    const std::lock_guard lock(mutex_);
    const auto found = transfers_.find(transfer_id);
    if (found == transfers_.end()) return Result<std::string>(noTransfer());
    if (found->second.content.size() != found->second.size)
        return Result<std::string>(
            Refusal{RefusalCode::HashMismatch, "Its size is not the one that was offered.", {}});
    return Result<std::string>(pathOf(found->second.of));
}

Later<Result<std::string>> MemoryStore::place(std::string_view transfer_id) {
    const std::lock_guard lock(mutex_);
    const auto found = transfers_.find(transfer_id);
    if (found == transfers_.end()) return Result<std::string>(noTransfer());
    const auto name = found->second.of;
    resources_.insert_or_assign(name, std::move(found->second.content));
    transfers_.erase(found);
    return Result<std::string>(pathOf(name));
}

void MemoryStore::drop(std::string_view transfer_id) {
    const std::lock_guard lock(mutex_);
    transfers_.erase(std::string(transfer_id));
}
void MemoryStore::remove(std::string_view service, std::string_view resource) {
    const std::lock_guard lock(mutex_);
    resources_.erase({std::string(service), std::string(resource)});
}
std::optional<std::string> MemoryStore::find(std::string_view service, std::string_view resource) {
    const Name name{std::string(service), std::string(resource)};
    const std::lock_guard lock(mutex_);
    return resources_.contains(name) ? std::optional(pathOf(name)) : std::nullopt;
}
std::optional<std::string> MemoryStore::content(std::string_view service, std::string_view resource) const {
    const std::lock_guard lock(mutex_);
    const auto found = resources_.find({std::string(service), std::string(resource)});
    return found == resources_.end() ? std::nullopt : std::optional(found->second);
}

}  // namespace axon::testing
