// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users_watch.hpp"

#include <stdexcept>
#include <utility>

namespace axon::users {
namespace {

constexpr std::size_t kNamesSaid = 5;

}  // namespace

std::string summaryOf(const Users& users, const std::string& file) {
    std::string old;
    std::size_t count = 0;
    for (const auto& user : users.all()) {
        if (kindOf(user.hash) == std::string_view("argon2id")) continue;
        if (++count <= kNamesSaid) old += (count == 1 ? "" : ", ") + user.name;
    }
    if (count > kNamesSaid) old += ", …";
    return std::to_string(users.size()) + (users.size() == 1 ? " user of " : " users of ") + file +
           ", fingerprint " + users.fingerprint() +
           (count == 0 ? ""
                       : "; " + std::to_string(count) + (count == 1 ? " has a hash" : " have hashes") +
                             " of crypt(5) (" + old +
                             "), which go on working; fix: axon users password NAME gives them one of "
                             "Argon2id");
}

UsersWatch::UsersWatch(std::string file, std::shared_ptr<const Users> first, const Clock& clock, Note note,
                       Taken taken, Read read)
    : file_(std::move(file)),
      clock_(clock),
      note_(std::move(note)),
      taken_(std::move(taken)),
      read_file_(std::move(read)),
      users_(std::move(first)),
      next_(clock.now() + kPeriod) {}

TimePoint UsersWatch::onTimer() {
    const auto now = clock_.now();
    if (now < next_) return next_;
    next_ = now + kPeriod;
    look();
    return next_;
}

void UsersWatch::say(const std::string& trouble) {
    if (std::exchange(trouble_, trouble) == trouble || trouble.empty()) return;
    note_("users: " + trouble + "; those who could log in before still can");
}

void UsersWatch::look() {
    const auto mark = FileMark::of(file_.c_str());
    if (mark != mark_) {
        mark_ = mark;
        read_ = false;
        return;
    }
    if (std::exchange(read_, true)) return;
    try {
        auto users = std::make_shared<const Users>(read_file_(file_));
        // What was written while it was read may be in it, or half of it.
        if (FileMark::of(file_.c_str()) != mark_) {
            mark_.reset();
            read_ = false;
            return;
        }
        say({});
        const bool same = users->all() == users_->all() && users->access() == users_->access();
        users_ = users;
        if (same) return;
        note_("users: taken: " + summaryOf(*users, file_));
        taken_(std::move(users));
    } catch (const std::exception& error) {
        say(error.what());
    }
}

}  // namespace axon::users
