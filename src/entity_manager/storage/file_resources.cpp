// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/file_resources.hpp"

#include <axon/transfer.pb.h>
#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <fstream>
#include <optional>
#include <system_error>
#include <thread>
#include <utility>

#include "common/descriptor.hpp"
#include "entity_manager/storage/state_files.hpp"

namespace axon::entity_manager {

namespace fs = std::filesystem;

namespace {

Refusal storeRefusal(const char* what, const fs::path& path) {
    const auto error = errno;
    const bool full = error == ENOSPC || error == EDQUOT;
    return {full ? RefusalCode::Overloaded : RefusalCode::Internal,
            std::string("The Entity Manager cannot ") + what + ' ' + path.string() + ": " +
                std::generic_category().message(error) + '.',
            {}};
}

constexpr std::uint64_t kNotePeriod = 16U << 20U;  // bytes that a killed process may have to be sent again

/// How far a file has been hashed, so that a resumed upload need not be read again, and for whom it is kept.
struct HashNote {
    char format[8] = {'a', 'x', 'o', 'n', 's', 'h', 'a', '2'};
    std::uint64_t written = 0;
    std::array<unsigned char, crypto_generichash_BYTES> owner{};
    crypto_hash_sha256_state hash{};
};

fs::path noteOf(fs::path incoming) {
    incoming += ".state";
    return incoming;
}

/// What "stored" says: a file of another size, time or place on the disk is not the one that was
/// synchronised.
std::string factsOf(const struct stat& file) {
    return std::to_string(file.st_ino) + ' ' + std::to_string(file.st_size) + ' ' +
           std::to_string(file.st_mtim.tv_sec) + '.' + std::to_string(file.st_mtim.tv_nsec) + '\n';
}

}  // namespace

/// The thread that waits for the disk.
class FileResourceStore::Synchroniser {
  public:
    Synchroniser() : thread_([this] { run(); }) {}
    ~Synchroniser() {
        {
            const std::lock_guard lock(mutex_);
            ending_ = true;
        }
        wake_.notify_one();
        thread_.join();
    }
    void add(Descriptor file, fs::path place) {
        Job dropped;  // closed after the lock
        {
            const std::lock_guard lock(mutex_);
            if (jobs_.size() == kUnsynchronised) {
                dropped = std::move(jobs_.front());
                jobs_.pop_front();
            }
            jobs_.push_back({std::move(file), std::move(place)});
        }
        wake_.notify_one();
    }

  private:
    struct Job {
        Descriptor file;
        fs::path place;
    };

    /// What waits is still done at the end.
    void run() {
        while (true) {
            Job job;
            {
                std::unique_lock lock(mutex_);
                wake_.wait(lock, [this] { return ending_ || !jobs_.empty(); });
                if (jobs_.empty()) return;
                job = std::move(jobs_.front());
                jobs_.pop_front();
            }
            synchronise(job);
        }
    }
    static void synchronise(const Job& job) {
        struct stat ours {
        }, there{};
        if (::fsync(job.file.get()) != 0 || ::fstat(job.file.get(), &ours) != 0) return;
        if (::stat((job.place / "content").c_str(), &there) != 0 || factsOf(ours) != factsOf(there))
            return;  // replaced
        synchroniseFolder(job.place);
        const auto fresh = job.place / "stored.new";
        {
            const File mark(fresh, O_WRONLY | O_CREAT | O_TRUNC);
            if (!mark.isOpen() || !mark.writeAll(factsOf(ours)) || ::fsync(mark.fd()) != 0) return;
        }
        if (::rename(fresh.c_str(), (job.place / "stored").c_str()) == 0) synchroniseFolder(job.place);
    }

    std::mutex mutex_;
    std::condition_variable wake_;
    std::deque<Job> jobs_;  // guarded by mutex_
    bool ending_ = false;   // guarded by mutex_
    std::thread thread_;    // last: it uses the others
};

/// One upload. The facts do not change; what is below `accepted` belongs to the worker's thread.
class FileResourceStore::Transfer {
  public:
    Transfer(const proto::ResourceOffer& offer, const std::string& owner, fs::path incoming)
        : service(offer.service()),
          resource(offer.resource()),
          sha256(offer.sha256()),
          size(offer.size()),
          path(std::move(incoming)) {
        crypto_generichash(owner_.data(), owner_.size(), reinterpret_cast<const unsigned char*>(owner.data()),
                           owner.size(), nullptr, 0);
    }

    const std::string service, resource, sha256;
    const std::uint64_t size;
    const fs::path path;
    std::optional<Later<Result<std::uint64_t>>> opened;  ///< the caller's
    std::uint64_t accepted = 0;                          ///< the caller's

    /// Goes on where the note of an earlier transfer of the same owner ends, or from the beginning.
    Result<std::uint64_t> open() {
        file_.emplace(path, O_RDWR | O_CREAT | O_NOFOLLOW);
        if (!file_->isOpen()) return storeRefusal("open", path);
        crypto_hash_sha256_init(&hash_);
        HashNote kept;
        std::ifstream in(noteOf(path), std::ios::binary);
        in.read(reinterpret_cast<char*>(&kept), sizeof kept);
        struct stat facts {};
        if (::fstat(file_->fd(), &facts) != 0) return storeRefusal("use", path);
        const bool usable = in.gcount() == sizeof kept &&
                            std::memcmp(kept.format, HashNote{}.format, sizeof kept.format) == 0 &&
                            kept.owner == owner_ && kept.written <= size &&
                            kept.written <= static_cast<std::uint64_t>(facts.st_size);
        if (usable) {
            hash_ = kept.hash;
            written_ = kept.written;
        }
        noted_ = written_;
        if (::ftruncate(file_->fd(), static_cast<off_t>(written_)) != 0 ||
            ::lseek(file_->fd(), static_cast<off_t>(written_), SEEK_SET) < 0)
            return storeRefusal("use", path);
        return written_;
    }
    /// What was complete before a chunk that cannot be written still is.
    Refusal append(std::string_view content) {
        if (!file_->writeAll(content)) {
            auto refusal = storeRefusal("write", path);
            [[maybe_unused]] const auto cut = ::ftruncate(file_->fd(), static_cast<off_t>(written_));
            return refusal;
        }
        crypto_hash_sha256_update(&hash_, reinterpret_cast<const unsigned char*>(content.data()),
                                  content.size());
        written_ += content.size();
        if (written_ - noted_ >= kNotePeriod) note();
        return {};
    }
    /// A note that could not be written costs a repeated upload and nothing else.
    void note() {
        if (!file_ || !file_->isOpen()) return;
        HashNote kept;
        kept.written = written_;
        kept.owner = owner_;
        kept.hash = hash_;
        auto fresh = noteOf(path);
        fresh += ".new";
        {
            const File out(fresh, O_WRONLY | O_CREAT | O_TRUNC | O_NOFOLLOW);
            if (!out.isOpen() || !out.writeAll({reinterpret_cast<const char*>(&kept), sizeof kept})) return;
        }
        if (::rename(fresh.c_str(), noteOf(path).c_str()) == 0) noted_ = written_;
    }
    void forgetNote() const {
        std::error_code ignored;
        fs::remove(noteOf(path), ignored);
    }
    bool whole() const {
        auto hash = hash_;
        std::array<unsigned char, crypto_hash_sha256_BYTES> digest{};
        crypto_hash_sha256_final(&hash, digest.data());
        return written_ == size &&
               std::string_view(reinterpret_cast<const char*>(digest.data()), digest.size()) == sha256;
    }
    Descriptor release() { return file_->release(); }
    /// Nothing of it will come any more. The last reference may be the caller's, who must not wait for a
    /// close.
    void end() {
        file_.reset();
        over_ = true;
    }
    bool over() const { return over_; }

  private:
    std::atomic<bool> over_{false};
    std::optional<File> file_;
    crypto_hash_sha256_state hash_{};
    std::array<unsigned char, crypto_generichash_BYTES> owner_{};
    std::uint64_t written_ = 0;
    std::uint64_t noted_ = 0;
};

/// The thread that the disk may hold up. What waits is done in the order of its coming, and at the end, too.
class FileResourceStore::Worker {
  public:
    Worker() : thread_([this] { run(); }) {}
    ~Worker() {
        onAnswer({});
        {
            const std::lock_guard lock(mutex_);
            ending_ = true;
        }
        wake_.notify_one();
        thread_.join();
    }
    void onAnswer(std::function<void()> come) {
        const std::lock_guard lock(telling_);
        come_ = std::move(come);
    }
    void add(std::function<void()> job) {
        {
            const std::lock_guard lock(mutex_);
            jobs_.push_back(std::move(job));
        }
        wake_.notify_one();
    }
    template <class T, class Ask>
    Later<T> ask(Ask ask) {
        const auto answer = Later<T>::pending();
        add([answer, ask = std::move(ask)]() mutable { answer.set(ask()); });
        return answer;
    }
    void write(const std::shared_ptr<Transfer>& transfer, std::string content) {
        const auto size = content.size();
        {
            const std::lock_guard lock(mutex_);
            waiting_[transfer.get()].bytes += size;
            bytes_ += size;
        }
        add([this, transfer, content = std::move(content)] {
            const bool failed = !failureOf(*transfer).ok();
            auto failure = failed ? Refusal{} : transfer->append(content);
            const std::lock_guard lock(mutex_);
            bytes_ -= content.size();
            const auto at = waiting_.find(transfer.get());
            at->second.bytes -= content.size();
            if (!failed) at->second.failure = std::move(failure);
            if (at->second.bytes == 0 && at->second.failure.ok()) waiting_.erase(at);
        });
    }
    Result<std::uint64_t> waiting(const Transfer& transfer) const {
        const std::lock_guard lock(mutex_);
        const auto at = waiting_.find(&transfer);
        if (at == waiting_.end()) return std::uint64_t{0};
        if (!at->second.failure.ok()) return at->second.failure;
        return at->second.bytes;
    }
    std::uint64_t bytes() const {
        const std::lock_guard lock(mutex_);
        return bytes_;
    }
    std::size_t jobs() const {
        const std::lock_guard lock(mutex_);
        return jobs_.size();
    }
    /// On the thread: nothing of it will come any more.
    void forget(const Transfer& transfer) {
        const std::lock_guard lock(mutex_);
        waiting_.erase(&transfer);
    }

  private:
    struct Backlog {
        std::uint64_t bytes = 0;
        Refusal failure;
    };
    Refusal failureOf(const Transfer& transfer) const {
        const std::lock_guard lock(mutex_);
        return waiting_.at(&transfer).failure;
    }
    void run() {
        std::unique_lock lock(mutex_);
        while (true) {
            wake_.wait(lock, [this] { return ending_ || !jobs_.empty(); });
            if (jobs_.empty()) return;
            {
                const auto job = std::move(jobs_.front());
                jobs_.pop_front();
                lock.unlock();
                job();
            }
            {
                const std::lock_guard telling(telling_);
                if (come_) come_();
            }
            lock.lock();
        }
    }

    mutable std::mutex mutex_;
    std::condition_variable wake_;
    std::deque<std::function<void()>> jobs_;      // guarded by mutex_
    std::map<const Transfer*, Backlog> waiting_;  // guarded by mutex_
    std::uint64_t bytes_ = 0;                     // guarded by mutex_; of all that wait
    bool ending_ = false;                         // guarded by mutex_
    std::mutex telling_;
    std::function<void()> come_;  // guarded by telling_
    std::thread thread_;          // last: it uses the others
};

FileResourceStore::FileResourceStore(fs::path folder, std::uint64_t kept_bytes)
    : folder_(fs::absolute(folder)), kept_bytes_(kept_bytes) {
    if (sodium_init() < 0) throw std::runtime_error("libsodium could not be initialised.");
    makeFolder(folder_ / "resources");
    makeFolder(folder_ / "incoming");
    findStored();
    synchroniser_ = std::make_unique<Synchroniser>();
    worker_ = std::make_unique<Worker>();
    worker_->add([this] { tidyIncoming(); });
}

FileResourceStore::~FileResourceStore() = default;

/// Where the accepted file of a resource lies.
fs::path FileResourceStore::placeOf(std::string_view service, std::string_view resource) const {
    return folder_ / "resources" / safeName(service) / safeName(resource);
}

/// What an earlier life has left, and the disk has: once, so that find() need not look.
void FileResourceStore::findStored() {
    std::error_code ignored;
    for (const auto& service : fs::directory_iterator(folder_ / "resources", ignored))
        for (const auto& resource : fs::directory_iterator(service.path(), ignored)) {
            const auto place = resource.path();
            struct stat facts {};
            if (::stat((place / "content").c_str(), &facts) != 0 || !S_ISREG(facts.st_mode)) continue;
            std::ifstream mark(place / "stored", std::ios::binary);
            std::string stored;
            std::getline(mark, stored);
            if (stored + '\n' == factsOf(facts)) stored_[place] = static_cast<std::uint64_t>(facts.st_size);
        }
}

Later<Result<std::uint64_t>> FileResourceStore::begin(const proto::ResourceOffer& offer,
                                                      const std::string& owner) {
    using Answer = Result<std::uint64_t>;
    const auto incoming = folder_ / "incoming" / (hex(offer.sha256()) + '-' + std::to_string(offer.size()));
    std::erase_if(transfers_, [](const auto& transfer) { return transfer.second->over(); });
    for (const auto& [id, other] : transfers_)
        if (other->path == incoming)
            return Answer(Refusal{
                RefusalCode::Duplicate, "The same content is being uploaded already. Wait for its end.", {}});
    if (worker_->bytes() > kBacklog || worker_->jobs() >= kJobs)
        return Answer(Refusal{RefusalCode::Overloaded,
                              "The disk has not taken yet what was uploaded before. Try again in a moment.",
                              {}});
    const auto transfer = std::make_shared<Transfer>(offer, owner, incoming);
    transfer->opened = worker_->ask<Answer>([this, transfer]() -> Answer {
        // Before the client sends it all.
        if (const auto* url = urlOf(transfer->service, transfer->resource))
            if (auto refusal = mayReplaceResource(findResourcePlace(roots_, *url)); !refusal.ok()) {
                transfer->end();
                return refusal;
            }
        open_.insert(transfer->path);
        auto here = transfer->open();
        if (!here) close(*transfer);
        return here;
    });
    transfers_[offer.transfer_id()] = transfer;
    return *transfer->opened;
}

Result<void> FileResourceStore::write(std::string_view transfer_id, std::uint64_t offset,
                                      std::string_view content) {
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end() || at->second->over())
        return Refusal{RefusalCode::UnknownResource, "There is no such upload.", {}};
    auto& transfer = *at->second;
    if (transfer.opened && !transfer.opened->ready())
        return Refusal{RefusalCode::WrongState, "The upload has not begun yet.", {}};
    if (transfer.opened) {
        if (!transfer.opened->value()) return transfer.opened->value().refusal();
        transfer.accepted = transfer.opened->value().value();
        transfer.opened.reset();
    }
    if (offset != transfer.accepted || content.size() > transfer.size - transfer.accepted)
        return Refusal{RefusalCode::Malformed, "The chunk does not continue the upload.", {}};
    if (worker_->jobs() >= kJobs)
        return Refusal{RefusalCode::Overloaded,
                       "Too many small pieces wait for the disk. Send larger ones, or try again in a moment.",
                       {}};
    transfer.accepted += content.size();
    worker_->write(at->second, std::string(content));
    return {};
}

Result<std::uint64_t> FileResourceStore::waiting(std::string_view transfer_id) const {
    const auto at = transfers_.find(transfer_id);
    return at == transfers_.end() ? Result<std::uint64_t>(std::uint64_t{0}) : worker_->waiting(*at->second);
}

void FileResourceStore::onAnswer(std::function<void()> come) {
    worker_->onAnswer(std::move(come));
}

std::shared_ptr<FileResourceStore::Transfer> FileResourceStore::take(std::string_view transfer_id) {
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end()) return nullptr;
    auto transfer = std::move(at->second);
    transfers_.erase(at);
    return transfer;
}

Later<Result<std::string>> FileResourceStore::check(std::string_view transfer_id) {
    using Answer = Result<std::string>;
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end() || at->second->over())
        return Answer(Refusal{RefusalCode::UnknownResource, "There is no such upload.", {}});
    if (const auto waiting = worker_->waiting(*at->second); !waiting || waiting.value() > 0)
        return Answer(Refusal{RefusalCode::WrongState, "It has not been written yet.", {}});
    return worker_->ask<Answer>([this, transfer = at->second]() -> Answer {
        if (transfer->whole()) return transfer->path.string();
        discard(*transfer);
        return Refusal{
            RefusalCode::HashMismatch,
            "What arrived has not the SHA-256 that was offered; it was deleted. Upload the file again.",
            {}};
    });
}

Later<Result<std::string>> FileResourceStore::place(std::string_view transfer_id) {
    using Answer = Result<std::string>;
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end() || at->second->over())
        return Answer(Refusal{RefusalCode::UnknownResource, "There is no such upload.", {}});
    return worker_->ask<Answer>([this, transfer = at->second] { return putInPlace(*transfer); });
}

const std::string* FileResourceStore::urlOf(const std::string& service, const std::string& resource) const {
    const auto at = urls_.find({service, resource});
    return at == urls_.end() ? nullptr : &at->second;
}

Result<std::string> FileResourceStore::putInPlace(Transfer& transfer) {
    if (const auto* url = urlOf(transfer.service, transfer.resource)) {
        const auto place = findResourcePlace(roots_, *url);
        if (const auto replaced = replaceResource(transfer.path.string(), place); !replaced)
            return replaced.refusal();
        transfer.forgetNote();
        close(transfer);
        return place.path;
    }
    const auto place = placeOf(transfer.service, transfer.resource);
    std::error_code error;
    fs::create_directories(place, error);
    const auto path = place / "content";
    if (error) errno = error.value();
    if (error || ::rename(transfer.path.c_str(), path.c_str()) != 0)
        return storeRefusal("put in its place", path);
    transfer.forgetNote();
    synchroniser_->add(transfer.release(), place);
    close(transfer);
    const std::lock_guard lock(mutex_);
    stored_[place] = transfer.size;
    return path.string();
}

/// On the worker's thread: nothing of it will come any more.
void FileResourceStore::close(Transfer& transfer) {
    transfer.end();
    open_.erase(transfer.path);
}

/// Likewise, and nothing of it is kept.
void FileResourceStore::discard(Transfer& transfer) {
    std::error_code ignored;
    transfer.forgetNote();
    fs::remove(transfer.path, ignored);
    close(transfer);
}

void FileResourceStore::suspend(std::string_view transfer_id) {
    const auto transfer = take(transfer_id);
    if (!transfer) return;
    worker_->add([this, transfer, worker = worker_.get()] {
        transfer->note();
        close(*transfer);
        worker->forget(*transfer);
        tidyIncoming();
    });
}

void FileResourceStore::drop(std::string_view transfer_id) {
    const auto transfer = take(transfer_id);
    if (!transfer) return;
    worker_->add([this, transfer, worker = worker_.get()] {
        discard(*transfer);
        worker->forget(*transfer);
    });
}

/// Of what nobody goes on with, the oldest, until the rest is within its bounds.
void FileResourceStore::tidyIncoming() {
    struct Kept {
        fs::file_time_type written = fs::file_time_type::min();
        std::uint64_t bytes = 0;
        std::vector<fs::path> files;  // itself and its notes
    };
    std::map<fs::path, Kept> kept;
    std::error_code ignored;
    for (const auto& entry : fs::directory_iterator(folder_ / "incoming", ignored)) {
        auto path = entry.path();
        while (path.has_extension()) path.replace_extension();  // ".state", ".state.new"
        if (open_.contains(path)) continue;
        auto& content = kept[path];
        content.written = std::max(content.written, entry.last_write_time(ignored));
        if (path == entry.path()) content.bytes = entry.file_size(ignored);
        content.files.push_back(entry.path());
    }
    std::vector<std::pair<fs::file_time_type, fs::path>> by_age;
    std::uint64_t bytes = 0;
    for (const auto& [path, content] : kept) {
        by_age.emplace_back(content.written, path);
        bytes += content.bytes;
    }
    std::sort(by_age.begin(), by_age.end());
    const auto oldest = fs::file_time_type::clock::now() - kIncomingKept;
    for (const auto& [written, path] : by_age) {
        if (written >= oldest && bytes <= kept_bytes_) break;
        bytes -= kept[path].bytes;
        for (const auto& file : kept[path].files) fs::remove(file, ignored);
    }
}

void FileResourceStore::remove(std::string_view service, std::string_view resource) {
    worker_->add([this, place = placeOf(service, resource), service = std::string(service),
                  resource = std::string(resource)] {
        if (const auto* url = urlOf(service, resource)) {
            const auto there = findResourcePlace(roots_, *url);
            if (there.there) ::unlink(there.path.c_str());
            return;
        }
        {
            const std::lock_guard lock(mutex_);
            stored_.erase(place);
        }
        std::error_code ignored;
        fs::remove_all(place, ignored);
    });
}

std::optional<std::string> FileResourceStore::find(std::string_view service, std::string_view resource) {
    const auto place = placeOf(service, resource);
    const std::lock_guard lock(mutex_);
    return stored_.contains(place) ? std::optional((place / "content").string()) : std::nullopt;
}

Later<std::vector<ResourcePlace>> FileResourceStore::locate(const ResourceRoots& roots,
                                                            std::vector<ResourceQuery> queries) {
    using Places = std::vector<ResourcePlace>;
    Places places(queries.size());
    bool outside = false;
    for (std::size_t i = 0; i < queries.size(); ++i) {
        outside = outside || !queries[i].url.empty();
        if (!queries[i].url.empty() || !queries[i].savable) continue;
        const auto folder = placeOf(queries[i].service, queries[i].resource);
        const std::lock_guard lock(mutex_);
        const auto at = stored_.find(folder);
        if (at == stored_.end()) continue;
        places[i].path = (folder / "content").string();
        places[i].there = true;
        places[i].size = at->second;
    }
    auto look = [this, roots, queries = std::move(queries), places]() mutable {
        roots_ = roots;
        urls_.clear();
        for (std::size_t i = 0; i < queries.size(); ++i) {
            if (queries[i].url.empty()) continue;
            urls_[{queries[i].service, queries[i].resource}] = queries[i].url;
            places[i] = findResourcePlace(roots, queries[i].url);
        }
        return places;
    };
    if (outside) return worker_->ask<Places>(std::move(look));
    worker_->add([look = std::move(look)]() mutable { look(); });
    return places;
}

Later<std::vector<std::string>> FileResourceStore::absent(std::vector<std::string> files) {
    return worker_->ask<std::vector<std::string>>([files = std::move(files)]() mutable {
        std::erase_if(files, [](const std::string& file) {
            struct stat facts {};
            return ::stat(file.c_str(), &facts) == 0 || (errno != ENOENT && errno != ENOTDIR);
        });
        return files;
    });
}

}  // namespace axon::entity_manager
