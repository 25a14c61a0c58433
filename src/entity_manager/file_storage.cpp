// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/file_storage.hpp"

#include <axon/transfer.pb.h>
#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <deque>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace axon::entity_manager {

namespace fs = std::filesystem;

namespace {

class File {
  public:
    File(const fs::path& path, int flags) : fd_(::open(path.c_str(), flags | O_CLOEXEC, 0600)) {}
    ~File() {
        if (fd_ >= 0) ::close(fd_);
    }
    File(const File&) = delete;
    File& operator=(const File&) = delete;
    bool isOpen() const { return fd_ >= 0; }
    int fd() const { return fd_; }
    int release() { return std::exchange(fd_, -1); }

    bool writeAll(std::string_view bytes) const {
        while (!bytes.empty()) {
            const auto n = ::write(fd_, bytes.data(), bytes.size());
            if (n < 0 && errno == EINTR) continue;
            if (n <= 0) return false;
            bytes.remove_prefix(static_cast<std::size_t>(n));
        }
        return true;
    }

  private:
    int fd_;
};

std::string hex(std::string_view bytes) {
    static constexpr char kDigits[] = "0123456789abcdef";
    std::string text;
    for (const char c : bytes) {
        text += kDigits[static_cast<unsigned char>(c) >> 4U];
        text += kDigits[static_cast<unsigned char>(c) & 0x0fU];
    }
    return text;
}

std::string safeName(std::string_view name) {
    std::string safe;
    for (const char c : name) {
        const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                           c == '-' || c == '_' || c == ' ';
        safe += plain ? std::string(1, c) : "%" + hex({&c, 1});
    }
    if (safe.empty()) return "%";
    // Longer than a file system's names may be: the beginning, for people, and a hash, for uniqueness.
    if (safe.size() <= 200) return safe;
    std::array<unsigned char, crypto_generichash_BYTES> hash{};
    crypto_generichash(hash.data(), hash.size(), reinterpret_cast<const unsigned char*>(name.data()),
                       name.size(), nullptr, 0);
    return safe.substr(0, 100) + '%' + hex({reinterpret_cast<const char*>(hash.data()), 16});
}

void makeFolder(const fs::path& folder) {
    try {
        fs::create_directories(folder);
        fs::permissions(folder, fs::perms::owner_all);
    } catch (const fs::filesystem_error& error) {
        throw std::runtime_error("the state folder " + folder.string() +
                                 " cannot be made or used: " + error.code().message() +
                                 "; fix: make it a folder of this user, or name another with "
                                 "--state DIR (Axon.State)");
    }
}

constexpr std::chrono::seconds kTryAgain{1};

[[noreturn]] void fail(const char* what, const fs::path& path) {
    throw std::system_error(errno, std::generic_category(), std::string(what) + ' ' + path.string());
}

void synchroniseFolder(const fs::path& folder) {
    const File handle(folder, O_RDONLY | O_DIRECTORY);
    if (handle.isOpen()) ::fsync(handle.fd());
}

Refusal storeRefusal(const char* what, const fs::path& path) {
    const auto error = errno;
    const bool full = error == ENOSPC || error == EDQUOT;
    return {full ? RefusalCode::Overloaded : RefusalCode::Internal,
            std::string("The Entity Manager cannot ") + what + ' ' + path.string() + ": " +
                std::generic_category().message(error) + '.',
            {}};
}

}  // namespace

FileStorage::FileStorage(fs::path folder) : folder_(std::move(folder)) {
    makeFolder(folder_);
    thread_ = std::thread([this] { run(); });
}

FileStorage::~FileStorage() {
    {
        const std::lock_guard lock(mutex_);
        ending_ = true;
    }
    wake_.notify_one();
    thread_.join();
}

fs::path FileStorage::pathOf(std::string_view key) const {
    return folder_ / (hex(key) + ".value");
}

std::optional<std::string> FileStorage::load(std::string_view key) {
    const auto path = pathOf(key);
    const File file(path, O_RDONLY);
    if (!file.isOpen()) {
        if (errno == ENOENT) return std::nullopt;
        fail("cannot open", path);
    }
    std::string value;
    std::array<char, 4096> part{};
    while (true) {
        const auto n = ::read(file.fd(), part.data(), part.size());
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) fail("cannot read", path);
        if (n == 0) return value;
        value.append(part.data(), static_cast<std::size_t>(n));
    }
}

/// To the disk, beside its place; the file's name.
fs::path FileStorage::write(std::string_view key, std::string_view value) const {
    auto fresh = pathOf(key);
    fresh += ".new";
    const File file(fresh, O_WRONLY | O_CREAT | O_TRUNC);
    if (!file.isOpen() || !file.writeAll(value) || ::fsync(file.fd()) != 0) fail("cannot write", fresh);
    return fresh;
}

void FileStorage::save(std::string_view key, std::string_view value) {
    const auto path = pathOf(key);
    const auto fresh = write(key, value);
    if (::rename(fresh.c_str(), path.c_str()) != 0) fail("cannot replace", path);
    synchroniseFolder(folder_);
}

void FileStorage::keep(std::string_view key, std::string_view value) {
    {
        const std::lock_guard lock(mutex_);
        waiting_[std::string(key)] = value;
    }
    wake_.notify_one();
}

void FileStorage::forget(std::string_view key) {
    const std::lock_guard lock(mutex_);
    if (const auto at = waiting_.find(key); at != waiting_.end()) waiting_.erase(at);
    ::unlink(pathOf(key).c_str());  // what cannot is a disk that a next life cannot write its epoch to either
}

void FileStorage::run() {
    std::unique_lock lock(mutex_);
    while (true) {
        wake_.wait(lock, [this] { return ending_ || !waiting_.empty(); });
        if (waiting_.empty()) return;
        const auto [key, value] = *waiting_.begin();
        const bool last = ending_;  // what had begun before the end is tried once more
        lock.unlock();
        fs::path fresh;
        try {
            fresh = write(key, value);
        } catch (const std::system_error&) {  // the disk is full, say: it is tried again
        }
        lock.lock();
        const auto at = waiting_.find(key);
        if (at == waiting_.end() || at->second != value) continue;  // forgotten, or newer
        if (!fresh.empty() && ::rename(fresh.c_str(), pathOf(key).c_str()) == 0) {
            waiting_.erase(at);
            lock.unlock();
            synchroniseFolder(folder_);
            lock.lock();
        } else if (last) {
            return;
        } else {
            wake_.wait_for(lock, kTryAgain, [this] { return ending_; });
        }
    }
}

namespace {

constexpr std::uint64_t kNotePeriod = 16U << 20U;  // bytes that a killed process may have to be sent again

constexpr const char* kDropped = ".dropped";

/// How far a file has been hashed, so that a resumed upload need not be read again.
struct HashNote {
    char format[8] = {'a', 'x', 'o', 'n', 's', 'h', 'a', '1'};
    std::uint64_t written = 0;
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
    /// Deletes what lies there under names that end in kDropped; of a large file that takes a while.
    void sweep(fs::path folder) {
        {
            const std::lock_guard lock(mutex_);
            swept_ = std::move(folder);
        }
        wake_.notify_one();
    }
    void add(int fd, fs::path place) {
        Job dropped;  // closed after the lock
        {
            const std::lock_guard lock(mutex_);
            if (jobs_.size() == kUnsynchronised) {
                dropped = std::move(jobs_.front());
                jobs_.pop_front();
            }
            jobs_.emplace_back(fd, std::move(place));
        }
        wake_.notify_one();
    }

  private:
    struct Job {
        Job() = default;
        Job(int file, fs::path at) : fd(file), place(std::move(at)) {}
        Job(Job&& other) noexcept : fd(std::exchange(other.fd, -1)), place(std::move(other.place)) {}
        Job& operator=(Job&& other) noexcept {
            std::swap(fd, other.fd);
            std::swap(place, other.place);
            return *this;
        }
        ~Job() {
            if (fd >= 0) ::close(fd);
        }
        int fd = -1;
        fs::path place;
    };

    /// What waits is still done at the end.
    void run() {
        while (true) {
            Job job;
            fs::path swept;
            {
                std::unique_lock lock(mutex_);
                wake_.wait(lock, [this] { return ending_ || !jobs_.empty() || !swept_.empty(); });
                swept = std::exchange(swept_, {});
                if (swept.empty() && jobs_.empty()) return;
                if (!jobs_.empty()) {
                    job = std::move(jobs_.front());
                    jobs_.pop_front();
                }
            }
            if (!swept.empty()) deleteDropped(swept);
            if (job.fd >= 0) synchronise(job);
        }
    }
    static void deleteDropped(const fs::path& folder) {
        std::error_code ignored;
        for (const auto& entry : fs::directory_iterator(folder, ignored))
            if (entry.path().extension() == kDropped) fs::remove(entry.path(), ignored);
    }
    static void synchronise(const Job& job) {
        struct stat ours {
        }, there{};
        if (::fsync(job.fd) != 0 || ::fstat(job.fd, &ours) != 0) return;
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
    fs::path swept_;        // guarded by mutex_; empty = nothing to delete
    bool ending_ = false;   // guarded by mutex_
    std::thread thread_;    // last: it uses the others
};

/// One upload. `accepted` is the strand's; what is below it belongs to the writer while something waits for it, and to
/// the strand before and after.
struct FileResourceStore::Transfer {
    std::string service;
    std::string resource;
    std::string sha256;
    std::uint64_t size = 0;
    std::uint64_t accepted = 0;
    std::uint64_t written = 0;
    fs::path path;
    File file;
    crypto_hash_sha256_state hash{};

    explicit Transfer(const fs::path& incoming)
        : path(incoming), file(incoming, O_RDWR | O_CREAT | O_NOFOLLOW) {
        crypto_hash_sha256_init(&hash);
    }
    void feed(std::string_view bytes) {
        crypto_hash_sha256_update(&hash, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
        written += bytes.size();
    }
    /// Goes on where the note of an earlier transfer ends, or from the beginning. False: the file cannot be
    /// used.
    bool resume() {
        HashNote kept;
        std::ifstream in(noteOf(path), std::ios::binary);
        in.read(reinterpret_cast<char*>(&kept), sizeof kept);
        struct stat facts {};
        if (::fstat(file.fd(), &facts) != 0) return false;
        const bool usable = in.gcount() == sizeof kept &&
                            std::memcmp(kept.format, HashNote{}.format, sizeof kept.format) == 0 &&
                            kept.written <= size && kept.written <= static_cast<std::uint64_t>(facts.st_size);
        if (usable) {
            hash = kept.hash;
            written = kept.written;
        }
        noted = written;
        return ::ftruncate(file.fd(), static_cast<off_t>(written)) == 0 &&
               ::lseek(file.fd(), static_cast<off_t>(written), SEEK_SET) >= 0;
    }
    /// A note that could not be written costs a repeated upload and nothing else.
    void note() {
        HashNote kept;
        kept.written = written;
        kept.hash = hash;
        auto fresh = noteOf(path);
        fresh += ".new";
        {
            const File out(fresh, O_WRONLY | O_CREAT | O_TRUNC | O_NOFOLLOW);
            if (!out.isOpen() || !out.writeAll({reinterpret_cast<const char*>(&kept), sizeof kept})) return;
        }
        if (::rename(fresh.c_str(), noteOf(path).c_str()) == 0) noted = written;
    }
    void forgetNote() const {
        std::error_code ignored;
        fs::remove(noteOf(path), ignored);
    }
    /// What was complete before a chunk that cannot be written still is.
    Refusal append(std::string_view content) {
        if (!file.writeAll(content)) {
            auto refusal = storeRefusal("write", path);
            [[maybe_unused]] const auto cut = ::ftruncate(file.fd(), static_cast<off_t>(written));
            return refusal;
        }
        feed(content);
        if (written - noted >= kNotePeriod) note();
        return {};
    }
    std::uint64_t noted = 0;
};

/// The thread that writes what arrives. What waits is written in the order of its coming, and at the end, too.
class FileResourceStore::Writer {
  public:
    Writer() : thread_([this] { run(); }) {}
    ~Writer() {
        onWritten({});
        {
            const std::lock_guard lock(mutex_);
            ending_ = true;
        }
        wake_.notify_one();
        thread_.join();
    }
    void onWritten(std::function<void()> changed) {
        const std::lock_guard lock(telling_);
        changed_ = std::move(changed);
    }
    void write(std::shared_ptr<Transfer> transfer, std::string content) {
        {
            const std::lock_guard lock(mutex_);
            waiting_[transfer.get()].bytes += content.size();
            bytes_ += content.size();
            jobs_.push_back({std::move(transfer), std::move(content), false});
        }
        wake_.notify_one();
    }
    /// After what waits: notes how far it has come, and lets it go.
    void close(std::shared_ptr<Transfer> transfer) {
        {
            const std::lock_guard lock(mutex_);
            closing_[transfer->path] = {transfer, false, false};
            jobs_.push_back({std::move(transfer), {}, true});
        }
        wake_.notify_one();
    }
    /// One that is being closed goes on instead: nobody waits for the disk for that. Null: none, one whose writing has
    /// failed, or one that is to be deleted.
    std::shared_ptr<Transfer> takeBack(const fs::path& path) {
        const std::lock_guard lock(mutex_);
        const auto at = closing_.find(path);
        if (at == closing_.end() || at->second.drop) return nullptr;
        const auto transfer = at->second.transfer;
        const auto backlog = waiting_.find(transfer.get());
        if (backlog != waiting_.end() && !backlog->second.failure.ok()) return nullptr;
        closing_.erase(at);
        std::erase_if(jobs_, [&](const Job& job) { return job.last && job.transfer == transfer; });
        return transfer;
    }
    Result<std::uint64_t> waiting(const Transfer& transfer) const {
        const std::lock_guard lock(mutex_);
        const auto at = waiting_.find(&transfer);
        if (at == waiting_.end()) return std::uint64_t{0};
        if (!at->second.failure.ok()) return at->second.failure;
        return at->second.bytes + (at->second.noting ? 1 : 0);
    }
    /// Whether the file is nobody's any more, for which it waits a little, and there is room for more.
    bool mayOpen(const fs::path& path) {
        std::unique_lock lock(mutex_);
        return bytes_ <= kBacklog && closed_.wait_for(lock, kPatience, [&] { return !closing_.contains(path); });
    }
    /// Of a file that is being closed: it is to be deleted then. False: it is none.
    bool dropWhenClosed(const fs::path& path) {
        const std::lock_guard lock(mutex_);
        const auto at = closing_.find(path);
        if (at == closing_.end()) return false;
        at->second.drop = true;
        return true;
    }

  private:
    struct Job {
        std::shared_ptr<Transfer> transfer;
        std::string content;
        bool last = false;
    };
    struct Backlog {
        std::uint64_t bytes = 0;
        bool noting = false;  ///< the thread is at it, though nothing waits
        Refusal failure;
    };
    struct Closing {
        std::shared_ptr<Transfer> transfer;
        bool begun = false;
        bool drop = false;
    };

    void run() {
        std::unique_lock lock(mutex_);
        while (true) {
            wake_.wait(lock, [this] { return ending_ || !jobs_.empty(); });
            if (jobs_.empty()) return;
            const auto job = std::move(jobs_.front());
            jobs_.pop_front();
            if (job.last) {
                close(job.transfer, lock);
                continue;
            }
            auto* const backlog = &waiting_[job.transfer.get()];  // this thread alone erases it
            const bool failed = !backlog->failure.ok();
            lock.unlock();
            const auto failure = failed ? Refusal{} : job.transfer->append(job.content);
            lock.lock();
            if (!failed) backlog->failure = failure;
            backlog->bytes -= job.content.size();
            bytes_ -= job.content.size();
            if (backlog->bytes == 0 && backlog->failure.ok()) waiting_.erase(job.transfer.get());
            tellOfChange(lock);
        }
    }
    void close(const std::shared_ptr<Transfer>& transfer, std::unique_lock<std::mutex>& lock) {
        closing_.at(transfer->path).begun = true;
        waiting_[transfer.get()].noting = true;
        lock.unlock();
        transfer->note();
        lock.lock();
        auto at = closing_.find(transfer->path);
        if (at == closing_.end() || !at->second.begun) {  // taken back meanwhile, and perhaps given up again
            auto& backlog = waiting_[transfer.get()];
            backlog.noting = false;
            if (backlog.bytes == 0) waiting_.erase(transfer.get());
            tellOfChange(lock);
            return;
        }
        waiting_.erase(transfer.get());
        if (at->second.drop) {
            std::error_code ignored;
            lock.unlock();
            transfer->forgetNote();
            fs::remove(transfer->path, ignored);
            lock.lock();
        }
        closing_.erase(transfer->path);
        closed_.notify_all();
    }
    void tellOfChange(std::unique_lock<std::mutex>& lock) {
        lock.unlock();
        {
            const std::lock_guard telling(telling_);
            if (changed_) changed_();
        }
        lock.lock();
    }

    mutable std::mutex mutex_;
    std::condition_variable wake_, closed_;
    std::deque<Job> jobs_;                        // guarded by mutex_
    std::map<const Transfer*, Backlog> waiting_;  // guarded by mutex_
    std::map<fs::path, Closing> closing_;         // guarded by mutex_
    std::uint64_t bytes_ = 0;                     // guarded by mutex_; of all that wait
    bool ending_ = false;                         // guarded by mutex_
    std::mutex telling_;
    std::function<void()> changed_;  // guarded by telling_
    std::thread thread_;             // last: it uses the others
};

FileResourceStore::FileResourceStore(fs::path folder) : folder_(std::move(folder)) {
    if (sodium_init() < 0) throw std::runtime_error("libsodium could not be initialised.");
    makeFolder(folder_ / "resources");
    makeFolder(folder_ / "incoming");
    synchroniser_ = std::make_unique<Synchroniser>();
    writer_ = std::make_unique<Writer>();
    dropIncoming(fs::file_time_type::clock::now() - kIncomingKept);
}

FileResourceStore::~FileResourceStore() = default;

fs::path FileResourceStore::placeOf(std::string_view service, std::string_view resource) const {
    return folder_ / "resources" / safeName(service) / safeName(resource);
}

Result<std::uint64_t> FileResourceStore::begin(const proto::ResourceOffer& offer) {
    const auto incoming = folder_ / "incoming" / (hex(offer.sha256()) + '-' + std::to_string(offer.size()));
    for (const auto& [id, other] : transfers_)
        if (other->path == incoming)
            return Refusal{
                RefusalCode::Duplicate, "The same content is being uploaded already. Wait for its end.", {}};
    auto transfer = writer_->takeBack(incoming);
    if (!transfer) {
        if (!writer_->mayOpen(incoming))
            return Refusal{RefusalCode::Overloaded,
                           "The disk has not taken yet what was uploaded before. Try again in a moment.",
                           {}};
        transfer = std::make_shared<Transfer>(incoming);
        if (!transfer->file.isOpen()) return storeRefusal("open", incoming);
        transfer->sha256 = offer.sha256();
        transfer->size = offer.size();
        if (!transfer->resume()) return storeRefusal("use", incoming);
        transfer->accepted = transfer->written;
    }
    transfer->service = offer.service();
    transfer->resource = offer.resource();
    const auto here = transfer->accepted;
    transfers_[offer.transfer_id()] = std::move(transfer);
    return here;
}

Result<void> FileResourceStore::write(std::string_view transfer_id, std::uint64_t offset,
                                      std::string_view content) {
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end()) return Refusal{RefusalCode::UnknownResource, "There is no such upload.", {}};
    auto& transfer = *at->second;
    if (offset != transfer.accepted || content.size() > transfer.size - transfer.accepted)
        return Refusal{RefusalCode::Malformed, "The chunk does not continue the upload.", {}};
    transfer.accepted += content.size();
    writer_->write(at->second, std::string(content));
    return {};
}

Result<std::uint64_t> FileResourceStore::waiting(std::string_view transfer_id) const {
    const auto at = transfers_.find(transfer_id);
    return at == transfers_.end() ? Result<std::uint64_t>(std::uint64_t{0}) : writer_->waiting(*at->second);
}

void FileResourceStore::onWritten(std::function<void()> changed) {
    writer_->onWritten(std::move(changed));
}

Result<std::string> FileResourceStore::finish(std::string_view transfer_id) {
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end()) return Refusal{RefusalCode::UnknownResource, "There is no such upload.", {}};
    if (const auto waiting = writer_->waiting(*at->second); !waiting || waiting.value() > 0)
        return Refusal{RefusalCode::WrongState, "It has not been written yet.", {}};
    const auto transfer = std::move(at->second);
    transfers_.erase(at);
    transfer->forgetNote();
    std::array<unsigned char, crypto_hash_sha256_BYTES> digest{};
    crypto_hash_sha256_final(&transfer->hash, digest.data());
    if (transfer->written != transfer->size ||
        std::string_view(reinterpret_cast<const char*>(digest.data()), digest.size()) != transfer->sha256) {
        std::error_code ignored;
        fs::remove(transfer->path, ignored);
        return Refusal{
            RefusalCode::HashMismatch,
            "What arrived has not the SHA-256 that was offered; it was deleted. Upload the file again.",
            {}};
    }
    const auto place = placeOf(transfer->service, transfer->resource);
    std::error_code error;
    fs::create_directories(place, error);
    const auto path = place / "content";
    std::error_code none;
    fs::remove(place / "stored", none);
    if (error || ::rename(transfer->path.c_str(), path.c_str()) != 0)
        return storeRefusal("put in its place", path);
    placed_.insert(place);
    synchroniser_->add(transfer->file.release(), place);
    return fs::absolute(path).string();
}

void FileResourceStore::suspend(std::string_view transfer_id) {
    const auto at = transfers_.find(transfer_id);
    if (at == transfers_.end()) return;
    writer_->close(std::move(at->second));
    transfers_.erase(at);
}

void FileResourceStore::dropSuspended() {
    dropIncoming(fs::file_time_type::max());
}

/// Renamed here and deleted by the thread: the same content may be offered again at once.
void FileResourceStore::dropIncoming(fs::file_time_type older_than) {
    std::error_code ignored;
    bool dropped = false;
    for (const auto& entry : fs::directory_iterator(folder_ / "incoming", ignored)) {
        const auto& path = entry.path();
        const bool under_way = std::any_of(transfers_.begin(), transfers_.end(), [&](const auto& transfer) {
            return transfer.second->path == path || noteOf(transfer.second->path) == path;
        });
        if (writer_->dropWhenClosed(path)) continue;
        const auto written = entry.last_write_time(ignored);
        if (under_way || (!ignored && written >= older_than)) continue;
        auto gone = path;
        if (path.extension() != kDropped) fs::rename(path, gone += kDropped, ignored);
        dropped = true;
    }
    if (dropped) synchroniser_->sweep(folder_ / "incoming");
}

void FileResourceStore::remove(std::string_view service, std::string_view resource) {
    std::error_code ignored;
    placed_.erase(placeOf(service, resource));
    fs::remove_all(placeOf(service, resource), ignored);
}

std::optional<std::string> FileResourceStore::find(std::string_view service, std::string_view resource) {
    const auto place = placeOf(service, resource);
    const auto path = place / "content";
    struct stat facts {};
    if (::stat(path.c_str(), &facts) != 0 || !S_ISREG(facts.st_mode)) return std::nullopt;
    if (!placed_.contains(place)) {
        std::string stored;
        std::getline(std::ifstream(place / "stored", std::ios::binary), stored);
        if (stored + '\n' != factsOf(facts)) return std::nullopt;
    }
    return fs::absolute(path).string();
}

}  // namespace axon::entity_manager
