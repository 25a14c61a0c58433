// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/inputs/upload_desk.hpp"

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

Result<UploadDesk::Progress> UploadDesk::offer(const proto::ResourceOffer& offer, int service, int resource,
                                               const Sender& asker, const std::string& owner, TimePoint now) {
    if (!Id128::fromBytes(offer.transfer_id()))
        return Refusal{RefusalCode::Malformed, "transfer_id must be 16 bytes.", {}};
    if (offer.sha256().size() != 32) return Refusal{RefusalCode::Malformed, "sha256 must be 32 bytes.", {}};
    if (auto refusal = checkFileName(offer.file_name()); !refusal.ok()) return refusal;
    if (offer.size() > bytes_max_)
        return Refusal{
            RefusalCode::TooLarge,
            "The file has " + std::to_string(offer.size()) + " bytes, and this entity takes at most " +
                std::to_string(bytes_max_) +
                ". Upload a smaller one, or raise Axon.ResourceBytesMax in the configuration of its Entity "
                "Manager.",
            {}};
    for (const auto& [id, upload] : uploads_)
        if (id == offer.transfer_id() || (upload.service == service && upload.resource == resource))
            return Refusal{
                RefusalCode::Duplicate, "This resource is being uploaded already. Wait for its end.", {}};
    if (uploads_.size() >= kMaxUploads)
        return Refusal{RefusalCode::Overloaded,
                       std::to_string(kMaxUploads) + " uploads are under way already. Wait for one to end.",
                       {}};
    auto& upload = uploads_[offer.transfer_id()];
    upload.offer = offer;
    upload.service = service;
    upload.resource = resource;
    upload.asker = asker;
    upload.told = now;
    upload.opened = store_.begin(offer, owner);
    return advance(offer.transfer_id(), upload);
}

Result<UploadDesk::Progress> UploadDesk::chunk(const proto::ResourceChunk& chunk) {
    const auto at = uploads_.find(chunk.transfer_id());
    if (at == uploads_.end())
        return Refusal{RefusalCode::UnknownResource,
                       "There is no such upload, or it has ended. Offer the resource again.",
                       {}};
    auto& upload = at->second;
    if (upload.step == Upload::Step::Placing) return Progress{};  // nothing of it is missing
    const auto size = chunk.content().size();
    Refusal refusal;
    if (size == 0 || size > kMaxChunk)
        refusal = {RefusalCode::TooLarge,
                   "A chunk must have 1 to 65536 bytes; this one has " + std::to_string(size) + ".",
                   {}};
    else if (upload.step == Upload::Step::Opening)
        refusal = {RefusalCode::Malformed, "The chunk came before the first credit. Wait for it.", {}};
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
        suspend(chunk.transfer_id());
        return refusal;
    }
    upload.received += size;
    return advance(at->first, upload);
}

Result<UploadDesk::Progress> UploadDesk::advance(const std::string& transfer_id, Upload& upload) {
    using Step = Upload::Step;
    const std::string id = transfer_id;  // it may be a part of what ends
    if (upload.step == Step::Opening) {
        if (!upload.opened->ready()) return Progress{};
        const auto here = upload.opened->value();
        if (!here) {
            end(id);
            return here.refusal();
        }
        upload.step = Step::Arriving;
        upload.received = upload.credited = std::min(here.value(), upload.offer.size());
        if (upload.received < upload.offer.size()) {
            upload.credited += window_;
            return Progress{upload.received, window_, Progress::Next::Nothing, {}};
        }
    }
    if (upload.step == Step::Arriving) {
        const auto waiting = store_.waiting(id);
        if (!waiting) {
            suspend(id);
            return waiting.refusal();
        }
        if (waiting.value() > 0 || upload.received < upload.offer.size()) {
            const auto written = upload.received - std::min(waiting.value(), upload.received);
            // New credit when half of the old is used: few reverse messages, and the client need not pause.
            if (upload.credited - written > window_ / 2 || upload.received == upload.offer.size())
                return Progress{written, 0, Progress::Next::Nothing, {}};
            upload.credited = written + window_;
            return Progress{written, window_, Progress::Next::Nothing, {}};
        }
        upload.step = Step::Checking;
        upload.path = store_.check(id);
    }
    if (upload.step == Step::Asked || !upload.path->ready()) return Progress{};
    const auto path = upload.path->value();
    if (!path) {
        if (upload.step == Step::Placing)
            suspend(id);
        else
            end(id);
        return path.refusal();
    }
    if (upload.step == Step::Placing) {
        end(id);
        return Progress{0, 0, Progress::Next::Placed, path.value()};
    }
    upload.step = Step::Asked;
    return Progress{0, 0, Progress::Next::Ask, path.value()};
}

std::vector<std::pair<UploadDesk::Upload, Result<UploadDesk::Progress>>> UploadDesk::answered() {
    std::vector<std::pair<Upload, Result<Progress>>> news;
    for (auto at = uploads_.begin(); at != uploads_.end();) {
        auto& [id, upload] = *at++;  // it may end
        const auto before = upload;
        auto progress = advance(id, upload);
        if (!progress || progress->window > 0 || progress->next != Progress::Next::Nothing)
            news.emplace_back(before, std::move(progress));
    }
    return news;
}

Result<UploadDesk::Progress> UploadDesk::accept(const std::string& transfer_id) {
    const auto at = uploads_.find(transfer_id);
    if (at == uploads_.end() || at->second.step != Upload::Step::Asked)
        return Refusal{RefusalCode::UnknownResource,
                       "There is no such upload, or it has ended. Offer the resource again.",
                       {}};
    at->second.step = Upload::Step::Placing;
    at->second.path = store_.place(transfer_id);
    return advance(at->first, at->second);
}

void UploadDesk::deny(const std::string& transfer_id) {
    store_.drop(transfer_id);
    end(transfer_id);
}

bool UploadDesk::placing(std::string_view service, std::string_view resource) const {
    return std::any_of(uploads_.begin(), uploads_.end(), [&](const auto& entry) {
        const auto& upload = entry.second;
        return upload.step == Upload::Step::Placing && upload.offer.service() == service &&
               upload.offer.resource() == resource;
    });
}

bool UploadDesk::endedLately(std::string_view transfer_id) const {
    return std::find(ended_.begin(), ended_.end(), transfer_id) != ended_.end();
}

const UploadDesk::Upload* UploadDesk::find(std::string_view transfer_id) const {
    const auto at = uploads_.find(transfer_id);
    return at == uploads_.end() ? nullptr : &at->second;
}

void UploadDesk::suspend(const std::string& transfer_id) {
    store_.suspend(transfer_id);
    end(transfer_id);
}

std::vector<UploadDesk::Upload> UploadDesk::suspendAll() {
    std::vector<Upload> suspended;
    for (auto at = uploads_.begin(); at != uploads_.end();) {
        const auto& [id, upload] = *at++;
        if (upload.step == Upload::Step::Placing) continue;
        suspended.push_back(upload);
        suspend(std::string(id));
    }
    return suspended;
}

bool UploadDesk::owesSign(const Upload& upload) const {
    if (upload.step != Upload::Step::Arriving) return true;
    const auto waiting = store_.waiting(upload.offer.transfer_id());
    return waiting && waiting.value() > 0;
}

std::vector<UploadDesk::Upload> UploadDesk::takeSigns(TimePoint now) {
    std::vector<Upload> owed;
    for (auto& [id, upload] : uploads_) {
        if (now < upload.told + kSignEvery) continue;
        upload.told = now;  // of one that owes none, too: it is looked at again after as long
        if (owesSign(upload)) owed.push_back(upload);
    }
    return owed;
}

std::optional<TimePoint> UploadDesk::nextSign() const {
    std::optional<TimePoint> first;
    for (const auto& [id, upload] : uploads_)
        if (!first || upload.told + kSignEvery < *first) first = upload.told + kSignEvery;
    return first;
}

void UploadDesk::end(const std::string& transfer_id) {
    const std::string id = transfer_id;
    ended_.push_back(id);
    if (ended_.size() > 2 * kMaxUploads) ended_.pop_front();
    uploads_.erase(id);
}

}  // namespace axon::entity_manager
