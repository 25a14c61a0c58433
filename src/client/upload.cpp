// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/upload.hpp"

#include <sodium.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "client/session.hpp"

namespace axon::client {
namespace {

constexpr std::size_t kReadBytes = 256 * 1024;
constexpr std::size_t kChunkBytes = 64 * 1024;

Refusal unreadable(const std::string& name, const std::string& why) {
    return {RefusalCode::UnknownResource, "The file " + name + " cannot be read: " + why + ".", {}};
}

}  // namespace

Result<ResourceFile> ResourceFile::open(const std::filesystem::path& path, std::uint64_t most) {
    ResourceFile out;
    out.name_ = path.string();
    std::error_code error;
    if (std::filesystem::is_directory(path, error))
        return unreadable(out.name_, "it is a folder; name a file");
    out.file_.open(path, std::ios::binary);
    if (!out.file_) return unreadable(out.name_, std::strerror(errno));
    // Hashing a gigabyte takes seconds.
    if (const auto size = std::filesystem::file_size(path, error); !error && most > 0 && size > most)
        return Refusal{
            RefusalCode::TooLarge,
            "The file " + out.name_ + " has " + std::to_string(size) +
                " bytes, and the entity takes at most " + std::to_string(most) +
                ". Upload a smaller one, or raise Axon.ResourceBytesMax in the configuration of its Entity "
                "Manager.",
            {}};
    if (sodium_init() < 0) return Refusal{RefusalCode::Internal, "libsodium could not be initialised.", {}};
    crypto_hash_sha256_state hash;
    crypto_hash_sha256_init(&hash);
    std::vector<char> buffer(kReadBytes);
    while (true) {
        out.file_.read(buffer.data(), static_cast<std::streamsize>(buffer.size()));
        const auto count = static_cast<std::uint64_t>(out.file_.gcount());
        crypto_hash_sha256_update(&hash, reinterpret_cast<const unsigned char*>(buffer.data()), count);
        out.size_ += count;
        if (!out.file_) break;
    }
    if (out.file_.bad()) return unreadable(out.name_, std::strerror(errno));
    out.sha256_.resize(crypto_hash_sha256_BYTES);
    crypto_hash_sha256_final(&hash, reinterpret_cast<unsigned char*>(out.sha256_.data()));
    return out;
}

Result<std::string> ResourceFile::read(std::uint64_t offset, std::size_t count) {
    std::string content(count, '\0');
    file_.clear();
    file_.seekg(static_cast<std::streamoff>(offset));
    file_.read(content.data(), static_cast<std::streamsize>(count));
    content.resize(static_cast<std::size_t>(file_.gcount()));
    if (content.empty()) return unreadable(name_, "it has become shorter while it was sent");
    return content;
}

void UploadWindow::credit(std::uint64_t offset, std::uint64_t limit) {
    {
        const std::lock_guard lock(mutex_);
        if (!begun_) begin_ = offset;
        begun_ = true;
        limit_ = std::max(limit_, limit);
    }
    changed_.notify_all();
}

void UploadWindow::finish(Refusal refusal) {
    {
        const std::lock_guard lock(mutex_);
        if (!ended_) ended_ = std::move(refusal);
    }
    changed_.notify_all();
}

UploadWindow::Turn UploadWindow::next(std::optional<std::uint64_t> sent, std::uint64_t size) {
    std::unique_lock lock(mutex_);
    const auto open = [&] {
        return begun_ && std::max(sent.value_or(begin_), begin_) < std::min(limit_, size);
    };
    changed_.wait(lock, [&] { return ended_ || open(); });
    if (ended_) return {0, 0, ended_};
    return {std::max(sent.value_or(begin_), begin_), std::min(limit_, size), std::nullopt};
}

Result<void> upload(Client::Session& session, const Held& held, std::string_view service,
                    std::string_view resource, const std::filesystem::path& path,
                    const std::function<void(std::uint64_t, std::uint64_t)>& progress,
                    const std::stop_token& give_up) {
    session.mayWait();
    auto opened = ResourceFile::open(
        path, session.withCore([&](SessionCore& core) { return core.leases().resourceBytesMax(held); }));
    if (!opened) return opened.refusal();
    ResourceFile file = std::move(opened).value();
    const auto window = std::make_shared<UploadWindow>();
    const auto id = session.withCore([&](SessionCore& core) {
        const auto transfer = core.commands().offer(
            held, service, resource, path.filename().string(), file.size(), file.sha256(),
            [window](const Result<void>& answer) { window->finish(answer.refusal()); });
        session.news().add(transfer, window);
        return transfer;
    });
    const std::stop_callback cancel(give_up, [&window] {
        window->finish(
            {RefusalCode::Cancelled, "The upload was cancelled; it goes on when it is begun again.", {}});
    });
    std::optional<std::uint64_t> sent;
    Refusal failure;
    while (true) {
        const auto turn = window->next(sent, file.size());
        if (turn.ended) {
            failure = *turn.ended;
            break;
        }
        std::uint64_t at = turn.from;
        if (progress && !sent) progress(at, file.size());
        while (at < turn.to && failure.ok() && !give_up.stop_requested()) {
            auto content = file.read(at, std::min<std::uint64_t>(kChunkBytes, turn.to - at));
            if (!content) {
                failure = content.refusal();
                break;
            }
            const auto refused = session.withCore(
                [&](SessionCore& core) { return core.commands().sendChunk(id, at, content.value()); });
            if (!refused) break;  // it has ended; the next turn says why
            at += content->size();
            if (progress) progress(at, file.size());
        }
        sent = at;
        if (!failure.ok()) break;
    }
    if (!failure.ok()) {
        // An empty chunk makes the Entity Manager put away what it has, to be gone on with; refused here when
        // the transfer has ended there already.
        session.withCore([&](SessionCore& core) {
            static_cast<void>(core.commands().sendChunk(id, sent.value_or(0), {}).ok());
        });
    }
    session.look([&](const SessionCore&) { session.news().removeUpload(id); });
    return failure;
}

}  // namespace axon::client
