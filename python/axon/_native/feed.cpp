// SPDX-License-Identifier: GPL-2.0-or-later
#include "feed.hpp"

#include <sys/eventfd.h>
#include <unistd.h>

#include <system_error>
#include <thread>

#include "bindings.hpp"
#include "gil.hpp"

namespace axon::python {

namespace py = pybind11;
using client::Seconds;
using Clock = std::chrono::steady_clock;

Doorbell::Doorbell() : descriptor_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    if (descriptor_ < 0) throw std::system_error(errno, std::generic_category(), "eventfd");
}

Doorbell::~Doorbell() {
    ::close(descriptor_);
}

void Doorbell::ring(std::uint64_t feed) {
    const std::lock_guard lock(mutex_);
    if (rung_.empty()) {
        const std::uint64_t one = 1;
        [[maybe_unused]] const auto written =
            ::write(descriptor_, &one, sizeof one);  // full is readable, too
    }
    rung_.insert(feed);
}

std::vector<std::uint64_t> Doorbell::take() {
    const std::lock_guard lock(mutex_);
    std::uint64_t count = 0;
    [[maybe_unused]] const auto got =
        ::read(descriptor_, &count, sizeof count);  // nothing to read: nobody rang
    std::vector<std::uint64_t> out(rung_.begin(), rung_.end());
    rung_.clear();
    return out;
}

Feed::Entry Feed::takeOldest() {
    auto entry = std::move(entries_.front());
    if (entry.data) {
        bytes_ -= entry.data;
        data_.pop_front();
    }
    entries_.pop_front();
    return entry;
}

void Feed::push(Make make, int tag, std::size_t data) {
    std::list<Entry> dropped;  // destroyed after the lock
    std::vector<Target> targets;
    std::shared_ptr<Doorbell> bell;
    std::uint64_t number = 0;
    {
        const std::lock_guard lock(mutex_);
        if (closed_) return;
        if (!targets_.empty()) {
            std::erase_if(targets_, [](const Target& target) {
                const auto there = target.feed.lock();
                return !there || there->closed();
            });
            targets = targets_;
        } else {
            if (limit_ && entries_.size() >= limit_) dropped.push_back(takeOldest());
            while (data && !data_.empty() && bytes_ + data > most_bytes_) {
                const auto oldest = data_.front();
                data_.pop_front();
                bytes_ -= oldest->data;
                dropped.splice(dropped.end(), entries_, oldest);
            }
            dropped_ += dropped.size();
            entries_.push_back({std::move(make), tag, data});
            if (data) data_.push_back(std::prev(entries_.end()));
            bytes_ += data;
            bell = bell_;
            number = number_;
        }
    }
    for (const auto& target : targets) {
        if (const auto there = target.feed.lock()) there->push(make, target.tag, data);
    }
    changed_.notify_one();
    if (bell) bell->ring(number);
}

void Feed::forward(const std::shared_ptr<Feed>& other, int tag) {
    const std::lock_guard lock(mutex_);
    targets_.push_back({other, tag});
}

bool Feed::closed() const {
    const std::lock_guard lock(mutex_);
    return closed_;
}

void Feed::close() {
    std::shared_ptr<Doorbell> bell;
    std::uint64_t number = 0;
    {
        const std::lock_guard lock(mutex_);
        closed_ = true;
        bell = bell_;
        number = number_;
    }
    changed_.notify_all();
    if (bell) bell->ring(number);
}

void Feed::abandon() {
    std::list<Entry> forgotten;  // destroyed after the lock
    {
        const std::lock_guard lock(mutex_);
        closed_ = true;
        data_.clear();
        bytes_ = 0;
        forgotten.swap(entries_);
    }
    close();
}

py::object Feed::take(std::optional<Seconds> time) {
    constexpr Seconds kLongest{1e9};
    const auto until = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                          std::min(time.value_or(kLongest), kLongest));
    Entry entry;
    while (true) {
        const auto pop = [&] {  // with mutex_
            if (entries_.empty()) return closed_;
            entry = takeOldest();
            return true;
        };
        bool done = false;
        {
            const std::unique_lock lock(mutex_);
            done = pop();
        }
        if (!done && Clock::now() < until) {
            const WithoutGil released;
            std::unique_lock lock(mutex_);
            const auto slice =
                isMainThread()
                    ? std::min(until, Clock::now() + std::chrono::duration_cast<Clock::duration>(kSlice))
                    : until;
            done = changed_.wait_until(lock, slice, pop);
        }
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (done || Clock::now() >= until) return entry.make ? entry.make(entry.tag) : py::object(py::none());
    }
}

std::size_t Feed::size() const {
    const std::lock_guard lock(mutex_);
    return entries_.size();
}

bool Feed::ended() const {
    const std::lock_guard lock(mutex_);
    return closed_ && entries_.empty();
}

std::uint64_t Feed::dropped() const {
    const std::lock_guard lock(mutex_);
    return dropped_;
}

void Feed::ring(std::shared_ptr<Doorbell> bell, std::uint64_t number) {
    bool now = false;
    {
        const std::lock_guard lock(mutex_);
        bell_ = bell;
        number_ = number;
        now = closed_ || !entries_.empty();
    }
    if (now) bell->ring(number);
}

bool isMainThread() {
    return ::getpid() == ::gettid();
}

void bindFeed(py::module_& module) {
    py::class_<Doorbell, std::shared_ptr<Doorbell>>(module, "Doorbell",
                                                    "Wakes an event loop when feeds have something new.")
        .def(py::init<>())
        .def("fileno", &Doorbell::descriptor, "Readable while feeds have something new.")
        .def("take", &Doorbell::take, "The numbers of the feeds that have rung since the last call.");
    py::class_<Feed, std::shared_ptr<Feed>>(module, "Feed", "A queue from the client library to Python.")
        .def(py::init<std::size_t, std::size_t>(), py::arg("limit") = 0,
             py::arg("most_bytes") = Feed::kMostBytes)
        .def("take", &Feed::take, py::arg("time") = py::none(),
             "The oldest entry, waiting up to `time` seconds for it; None if there is none.")
        .def("close", &Feed::close, "Nothing arrives after it. What is there can still be taken.")
        .def("abandon", &Feed::abandon, "Nothing arrives after it, and what is there is forgotten.")
        .def(
            "note",
            [](Feed& feed, int tag) {
                feed.push([](int noted) { return py::make_tuple(noted, py::none()); }, tag);
            },
            py::arg("tag"), "Puts (tag, None) behind what is there.")
        .def("forward", &Feed::forward, py::arg("other"), py::arg("tag") = 0,
             "From now on, what arrives goes to `other` as well, and no longer into this feed.")
        .def("ring", &Feed::ring, py::arg("bell"), py::arg("number"))
        .def("__len__", &Feed::size)
        .def_property_readonly("ended", &Feed::ended, "Closed, and everything was taken.")
        .def_property_readonly("dropped", &Feed::dropped,
                               "How many entries were dropped because it was full.");
}

}  // namespace axon::python
