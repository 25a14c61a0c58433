// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/file_journal.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <chrono>
#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

namespace axon::entity_manager {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

namespace {

constexpr std::size_t kTextMax = 500;     // of a field: a line stays readable, and its writing short
constexpr std::size_t kLineMax = 16'384;  // what is longer was not written by us

std::string shortened(const std::string& text) {
    return text.size() <= kTextMax ? text : text.substr(0, kTextMax) + "…";
}

/// By the wall clock, for people; all reckoning is by the core's own clock, in "us".
std::string wallTime() {
    const auto now = std::chrono::system_clock::now();
    const auto seconds = std::chrono::system_clock::to_time_t(now);
    const auto ms =
        std::chrono::duration_cast<std::chrono::milliseconds>(now.time_since_epoch()).count() % 1000;
    std::tm utc{};
    ::gmtime_r(&seconds, &utc);
    char text[40];
    const auto length = std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%S", &utc);
    const auto fraction = std::to_string(1000 + ms);
    return std::string(text, length) + '.' + fraction.substr(1) + 'Z';
}

std::string lineOf(const JournalRecord& record) {
    Json line;
    line["at"] = wallTime();
    line["us"] = record.at_us;
    line["kind"] = toString(record.kind);
    if (record.lease != LeaseNumber{})
        line["lease"] = std::to_string(record.lease.epoch) + '/' + std::to_string(record.lease.number);
    line["generation"] = record.generation;
    if (!record.who.empty()) line["who"] = shortened(record.who);
    if (!record.client.empty()) line["client"] = shortened(record.client);
    if (!record.task.isZero()) line["task"] = record.task.toString();
    if (!record.service.empty()) line["service"] = shortened(record.service);
    if (!record.code.empty()) line["code"] = shortened(record.code);
    if (!record.text.empty()) line["text"] = shortened(record.text);
    return line.dump(-1, ' ', false, Json::error_handler_t::replace) + '\n';
}

/// Empty, or what was expected.
std::string readLine(const std::string& text, JournalRecord& record) {
    const auto line = Json::parse(text, nullptr, false);
    if (!line.is_object()) return "a JSON object";
    const auto word = [&](const char* key) {
        const auto at = line.find(key);
        return at != line.end() && at->is_string() ? at->get<std::string>() : std::string();
    };
    const auto number = [&](const char* key) -> std::int64_t {
        const auto at = line.find(key);
        return at != line.end() && at->is_number_integer() ? at->get<std::int64_t>() : 0;
    };
    const auto kind = journalKindOf(word("kind"));
    if (!kind) return "\"kind\": one of the kinds of entries";
    record = {};
    record.kind = *kind;
    record.at_us = number("us");
    record.generation = static_cast<std::uint32_t>(number("generation"));
    record.who = word("who");
    record.client = word("client");
    record.service = word("service");
    record.code = word("code");
    record.text = word("text");
    if (const auto lease = word("lease"); !lease.empty()) {
        const auto* const end = lease.data() + lease.size();
        const auto epoch = std::from_chars(lease.data(), end, record.lease.epoch);
        if (epoch.ec != std::errc{} || epoch.ptr == end || *epoch.ptr != '/' ||
            std::from_chars(epoch.ptr + 1, end, record.lease.number).ptr != end)
            return "\"lease\": EPOCH/NUMBER";
    }
    const bool of_task = *kind == JournalRecord::Kind::Dispatched || *kind == JournalRecord::Kind::TaskEnded;
    const auto task = Id128::parse(word("task"));
    if (task) record.task = *task;
    if (of_task && !task) return "\"task\": the 36 characters of an id";
    return {};
}

}  // namespace

FileJournal::FileJournal(fs::path folder, Bounds bounds, const std::function<void()>& on_thread)
    : story_(folder, "journal", bounds, findings_, on_thread),
      tasks_(folder, "tasks", bounds, findings_, on_thread) {}

bool FileJournal::append(const JournalRecord& record) {
    const bool of_task =
        record.kind == JournalRecord::Kind::Dispatched || record.kind == JournalRecord::Kind::TaskEnded;
    return (of_task ? tasks_ : story_).append(lineOf(record));
}

Later<bool> FileJournal::appendDispatch(const JournalRecord& record) {
    return tasks_.appendAnswered(lineOf(record));
}

void FileJournal::onAnswer(std::function<void()> come) {
    tasks_.onAnswer(std::move(come));
}

void FileJournal::replay(const std::function<void(const JournalRecord&)>& each) {
    story_.replay(each);
    tasks_.replay(each);
}

FileJournal::Files::Files(fs::path folder, std::string name, Bounds bounds,
                          std::vector<std::string>& findings, std::function<void()> on_thread)
    : folder_(std::move(folder)), name_(std::move(name)), bounds_(bounds), findings_(findings) {
    fs::create_directories(folder_);
    if (!open()) throw std::system_error(errno, std::generic_category(), "cannot open " + fileOf(0).string());
    cutTornLine();
    thread_ = std::thread([this, on_thread = std::move(on_thread)] {
        if (on_thread) on_thread();
        run();
    });
}

FileJournal::Files::~Files() {
    onAnswer({});
    {
        const std::lock_guard lock(mutex_);
        ending_ = true;
    }
    wake_.notify_one();
    thread_.join();
}

bool FileJournal::Files::append(std::string line) {
    return add({std::move(line), std::nullopt}) && !failing_;
}

Later<bool> FileJournal::Files::appendAnswered(std::string line) {
    auto answer = Later<bool>::pending();
    if (!add({std::move(line), answer})) answer.set(false);
    return answer;
}

void FileJournal::Files::onAnswer(std::function<void()> come) {
    const std::lock_guard lock(telling_);
    come_ = std::move(come);
}

bool FileJournal::Files::add(Line line) {
    {
        const std::lock_guard lock(mutex_);
        if (waiting_.size() == kWaiting) return false;
        waiting_.push_back(std::move(line));
    }
    wake_.notify_one();
    return true;
}

/// What waits is still written at the end.
void FileJournal::Files::run() {
    std::unique_lock lock(mutex_);
    while (true) {
        wake_.wait(lock, [this] { return ending_ || !waiting_.empty(); });
        if (waiting_.empty()) return;
        const auto line = std::move(waiting_.front());
        waiting_.pop_front();
        lock.unlock();
        const bool written = write(line.text);
        failing_ = !written;
        if (line.answer) {
            line.answer->set(written);
            const std::lock_guard telling(telling_);
            if (come_) come_();
        }
        lock.lock();
    }
}

fs::path FileJournal::Files::fileOf(int age) const {
    return folder_ / (name_ + (age == 0 ? "" : '.' + std::to_string(age)) + ".jsonl");
}

bool FileJournal::Files::open() {
    fd_ = Descriptor(::open(fileOf(0).c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC | O_NOFOLLOW, 0600));
    struct stat facts {};
    size_ = fd_.open() && ::fstat(fd_.get(), &facts) == 0 ? static_cast<std::uint64_t>(facts.st_size) : 0;
    return fd_.open();
}

/// What follows the last end of a line is a part of an entry that was never acknowledged.
void FileJournal::Files::cutTornLine() {
    auto end = size_;
    char last = '\n';
    while (end > 0 && ::pread(fd_.get(), &last, 1, static_cast<off_t>(end - 1)) == 1 && last != '\n') --end;
    if (end == size_) return;
    if (::ftruncate(fd_.get(), static_cast<off_t>(end)) != 0) return;
    findings_.push_back(fileOf(0).string() + ": the last line was torn by a loss of power or a full disk; " +
                        std::to_string(size_ - end) + " bytes have been cut off.");
    size_ = end;
}

bool FileJournal::Files::rotate() {
    fd_.reset();
    std::error_code ignored;
    for (int age = bounds_.files - 1; age > 0; --age) fs::rename(fileOf(age - 1), fileOf(age), ignored);
    if (bounds_.files < 2) fs::remove(fileOf(0), ignored);
    return open();
}

bool FileJournal::Files::write(const std::string& line) {
    if (!fd_.open() && !open()) return false;
    if (size_ > 0 && size_ + line.size() > bounds_.file_bytes && !rotate()) return false;
    ssize_t written = 0;
    do written = ::write(fd_.get(), line.data(), line.size());
    while (written < 0 && errno == EINTR);
    if (written == static_cast<ssize_t>(line.size())) {
        size_ += line.size();
        return true;
    }
    [[maybe_unused]] const auto cut = ::ftruncate(fd_.get(), static_cast<off_t>(size_));
    return false;
}

void FileJournal::Files::replay(const std::function<void(const JournalRecord&)>& each) {
    for (int age = bounds_.files - 1; age >= 0; --age) {
        std::ifstream file(fileOf(age), std::ios::binary);
        std::string first_problem;
        std::uint64_t number = 0, bad = 0;
        JournalRecord record;
        for (std::string line; std::getline(file, line);) {
            ++number;
            const auto problem = line.size() > kLineMax ? std::string("a line of at most 16384 bytes")
                                                        : readLine(line, record);
            if (problem.empty()) {
                each(record);
                continue;
            }
            if (++bad == 1)
                first_problem = fileOf(age).string() + ':' + std::to_string(number) + ": expected " + problem;
        }
        if (bad == 0) continue;
        findings_.push_back(
            first_problem +
            (bad == 1 ? "; the line is"
                      : "; it and " + std::to_string(bad - 1) + " more lines of the file are") +
            " passed over. A task that only they name could be run again: make no use of its id.");
    }
}

}  // namespace axon::entity_manager
