// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/upload_desk.hpp"

#include <algorithm>
#include <utility>

#include "messages/text.hpp"

namespace axon::entity_manager {

namespace {

Refusal checkFileName(const std::string& name) {
    const bool confined = !name.empty() && name.size() <= UploadDesk::kMaxName && name != "." &&
                          name.find("..") == std::string::npos && name.find('/') == std::string::npos &&
                          name.find('\\') == std::string::npos &&
                          std::none_of(name.begin(), name.end(), [](char c) {
                              return static_cast<unsigned char>(c) < 0x20 || c == 0x7f;
                          });
    if (confined) return {};
    return {RefusalCode::BadName,
            "File name " + inQuotes(name) +
                " is not allowed: expected 1 to 255 bytes without '/', '\\', \"..\" and control characters.",
            {}};
}

}  // namespace

UploadDesk::UploadDesk(ResourceStore& store, std::uint64_t bytes_max, std::uint64_t window)
    : store_(store), bytes_max_(bytes_max), window_(std::max<std::uint64_t>(window, kMaxChunk)) {}

Result<UploadDesk::Progress> UploadDesk::offer(const proto::ResourceOffer& offer, int service, int resource) {
    if (!Id128::fromBytes(offer.transfer_id()))
        return Refusal{RefusalCode::Malformed, "transfer_id must be 16 bytes.", {}};
    if (offer.sha256().size() != 32) return Refusal{RefusalCode::Malformed, "sha256 must be 32 bytes.", {}};
    if (auto refusal = checkFileName(offer.file_name()); !refusal.ok()) return refusal;
    if (offer.size() > bytes_max_)
        return Refusal{RefusalCode::TooLarge,
                       "The file has " + std::to_string(offer.size()) + " bytes; at most " +
                           std::to_string(bytes_max_) +
                           " are taken (resource_bytes_max in the Entity Manager's configuration).",
                       {}};
    for (const auto& [id, upload] : uploads_)
        if (id == offer.transfer_id() || (upload.service == service && upload.resource == resource))
            return Refusal{
                RefusalCode::Duplicate, "This resource is being uploaded already. Wait for its end.", {}};
    if (uploads_.size() >= kMaxUploads)
        return Refusal{RefusalCode::Overloaded,
                       std::to_string(kMaxUploads) + " uploads are under way already. Wait for one to end.",
                       {}};
    const auto here = store_.begin(offer);
    if (!here) return here.refusal();
    auto& upload = uploads_[offer.transfer_id()];
    upload.offer = offer;
    upload.service = service;
    upload.resource = resource;
    upload.received = std::min(here.value(), offer.size());
    upload.credited = upload.received;
    return advance(offer.transfer_id(), upload);
}

Result<UploadDesk::Progress> UploadDesk::chunk(const proto::ResourceChunk& chunk) {
    const auto at = uploads_.find(chunk.transfer_id());
    if (at == uploads_.end())
        return Refusal{RefusalCode::UnknownResource,
                       "There is no such upload (any more). Offer the resource again.",
                       {}};
    auto& upload = at->second;
    const auto size = chunk.content().size();
    Refusal refusal;
    if (size == 0 || size > kMaxChunk)
        refusal = {RefusalCode::TooLarge,
                   "A chunk must have 1 to 65536 bytes; this one has " + std::to_string(size) + ".",
                   {}};
    else if (chunk.offset() != upload.received)
        refusal = {RefusalCode::Malformed,
                   "Expected the chunk at offset " + std::to_string(upload.received) + ", found " +
                       std::to_string(chunk.offset()) + ". Offer the resource again to resume.",
                   {}};
    else if (size > upload.offer.size() - upload.received)
        refusal = {RefusalCode::TooLarge, "The chunk goes beyond the size that was offered.", {}};
    else if (upload.received + size > upload.credited)
        refusal = {RefusalCode::TooLarge, "The chunk goes beyond the window. Wait for credit.", {}};
    else if (auto written = store_.write(chunk.transfer_id(), chunk.offset(), chunk.content()); !written)
        refusal = written.refusal();
    if (!refusal.ok()) {
        store_.suspend(chunk.transfer_id());
        end(chunk.transfer_id());
        return refusal;
    }
    upload.received += size;
    return advance(at->first, upload);
}

Result<UploadDesk::Progress> UploadDesk::advance(const std::string& transfer_id, Upload& upload) {
    const auto waiting = store_.waiting(transfer_id);
    if (!waiting) {
        const std::string id = transfer_id;
        store_.suspend(id);
        end(id);
        return waiting.refusal();
    }
    const auto written = upload.received - std::min(waiting.value(), upload.received);
    if (waiting.value() > 0 && !upload.begun) return Progress{written, 0, false};
    if (waiting.value() == 0 && written == upload.offer.size()) return Progress{written, 0, true};
    // New credit when half of the old is used: few reverse messages, and the client need not pause.
    if (upload.begun && (upload.credited - written > window_ / 2 || upload.received == upload.offer.size()))
        return Progress{written, 0, false};
    upload.begun = true;
    upload.credited = written + window_;
    return Progress{written, window_, false};
}

std::vector<std::pair<UploadDesk::Upload, Result<UploadDesk::Progress>>> UploadDesk::written() {
    std::vector<std::pair<Upload, Result<Progress>>> news;
    for (auto at = uploads_.begin(); at != uploads_.end();) {
        auto& [id, upload] = *at++;  // it may end
        const auto before = upload;
        auto progress = advance(id, upload);
        if (!progress || progress->window > 0 || progress->complete) news.emplace_back(before, std::move(progress));
    }
    return news;
}

bool UploadDesk::endedLately(std::string_view transfer_id) const {
    return std::find(ended_.begin(), ended_.end(), transfer_id) != ended_.end();
}

const UploadDesk::Upload* UploadDesk::find(std::string_view transfer_id) const {
    const auto at = uploads_.find(transfer_id);
    return at == uploads_.end() ? nullptr : &at->second;
}

Result<std::string> UploadDesk::finish(std::string_view transfer_id) {
    const std::string id(transfer_id);
    auto path = store_.finish(id);
    if (!path) store_.suspend(id);
    end(id);
    return path;
}

std::vector<UploadDesk::Upload> UploadDesk::suspendAll() {
    std::vector<Upload> suspended;
    while (!uploads_.empty()) {
        const auto id = uploads_.begin()->first;
        store_.suspend(id);
        suspended.push_back(std::move(uploads_.begin()->second));
        end(id);
    }
    return suspended;
}

void UploadDesk::end(const std::string& transfer_id) {
    ended_.push_back(transfer_id);
    if (ended_.size() > 2 * kMaxUploads) ended_.pop_front();
    uploads_.erase(transfer_id);
}

}  // namespace axon::entity_manager
