// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users_file.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <stdexcept>
#include <utility>

#include "common/descriptor.hpp"
#include "users/file_text.hpp"

namespace axon::users {
namespace {

constexpr const char* kFirstLine =
    "# Who may log in at axon-server: name role hash. Roles: observer, operator, admin, entity.\n";
constexpr unsigned char kInterrupt = 3;  // Ctrl-C

bool isLineOf(std::string_view line, std::string_view name) {
    const auto fields = fieldsOf(contentOf(line));
    return !fields.empty() && fields.front() == name;
}

/// From the '#', with the blanks before it.
std::string_view commentOf(std::string_view line) {
    if (!line.empty() && line.back() == '\n') line.remove_suffix(1);
    while (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    const auto hash = line.find('#');
    if (hash == std::string_view::npos) return {};
    return line.substr(line.find_last_not_of(" \t", hash == 0 ? 0 : hash - 1) + 1);
}

void writeAll(int fd, std::string_view rest, const std::string& file) {
    while (!rest.empty()) {
        const auto done = ::write(fd, rest.data(), rest.size());
        if (done < 0 && errno == EINTR) continue;
        if (done < 0) fail(file, "cannot be written");
        rest.remove_prefix(static_cast<std::size_t>(done));
    }
    if (::fsync(fd) != 0) fail(file, "cannot be written");
}

/// A file of its own until it is at its place.
class NextFile {
  public:
    NextFile(std::string path, const struct stat* before) : path_(std::move(path)) {
        const mode_t mode = before != nullptr ? before->st_mode & 0640U : 0600U;
        ::unlink(path_.c_str());  // of a change that was killed: the lock is held
        fd_ = Descriptor(::open(path_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600));
        if (!fd_.open()) fail(path_, "cannot be written");
        // The server may read it as another user or through its group.
        if (before != nullptr && (before->st_uid != ::geteuid() || before->st_gid != ::getegid()) &&
            ::fchown(fd_.get(), before->st_uid, before->st_gid) != 0)
            undo("cannot be given to the owner and group of the present file");
        if (::fchmod(fd_.get(), mode) != 0) undo("cannot be given the permissions of the present file");
    }
    ~NextFile() {
        if (!path_.empty()) ::unlink(path_.c_str());
    }
    NextFile(const NextFile&) = delete;
    NextFile& operator=(const NextFile&) = delete;

    void write(std::string_view text) { writeAll(fd_.get(), text, path_); }
    void moveTo(const std::string& file) {
        if (::rename(path_.c_str(), file.c_str()) != 0) fail(file, "cannot be replaced");
        path_.clear();
    }

  private:
    [[noreturn]] void undo(const char* what) const {
        const auto failure = errno;
        ::unlink(path_.c_str());
        errno = failure;
        fail(path_, what);
    }

    std::string path_;  // empty once it is at its place
    Descriptor fd_;
};

/// The file itself where it is named through a link.
std::string followed(const std::string& file) {
    std::error_code failure;
    if (!std::filesystem::is_symlink(file, failure)) return file;
    const auto its = std::filesystem::canonical(file, failure);
    return failure ? file : its.string();
}

/// Not the file, which is replaced, nor its folder: whoever can open what is locked can keep it locked.
Descriptor locked(const std::string& file, int folder) {
    const auto path = file + ".lock";
    Descriptor lock(::open(path.c_str(), O_RDWR | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0600));
    if (!lock.open()) fail(path, "expected a file that can be opened for locking");
    struct stat facts {};
    if (::fstat(lock.get(), &facts) != 0) fail(path, "cannot be read");
    if (!S_ISREG(facts.st_mode)) throw std::runtime_error(path + ": expected a regular file");
    if ((facts.st_mode & 07777U) != 0600U && ::fchmod(lock.get(), 0600) != 0)
        fail(path, "cannot be closed to others");
    // Whoever may change the folder may change the users, also after root has.
    struct stat its_folder {};
    if (facts.st_uid == ::geteuid() && ::fstat(folder, &its_folder) == 0 && its_folder.st_uid != facts.st_uid)
        [[maybe_unused]]
        const auto given = ::fchown(lock.get(), its_folder.st_uid, its_folder.st_gid);
    if (::flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
        if (errno != EWOULDBLOCK) fail(path, "cannot be locked");
        throw std::runtime_error(file + " is being changed by somebody else; fix: try again");
    }
    return lock;
}

using Change = std::function<std::string(const std::string& text, const Users& users)>;

void change(const std::string& named, bool may_be_new, const Change& make) {
    const auto file = followed(named);
    auto folder = std::filesystem::path(file).parent_path().string();
    if (folder.empty()) folder = ".";
    const Descriptor its_folder(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (!its_folder.open()) fail(folder, "expected the folder of the file of users");
    const auto lock = locked(file, its_folder.get());
    std::string text = kFirstLine;
    struct stat facts {};
    bool exists = false;
    if (const Descriptor old(::open(file.c_str(), O_RDONLY | O_CLOEXEC)); old.open()) {
        exists = true;
        if (::fstat(old.get(), &facts) != 0) fail(file, "cannot be read");
        if (!S_ISREG(facts.st_mode)) throw std::runtime_error(file + ": expected a regular file");
        text = readAll(old.get(), file);
    } else if (errno != ENOENT || !may_be_new) {
        fail(file, "expected a readable file of users");
    }
    // Nothing is changed in what the server would refuse, nor into that.
    text = make(text, Users::parse(text, file));
    Users::parse(text, file);
    NextFile next(file + ".new", exists ? &facts : nullptr);
    next.write(text);
    next.moveTo(file);
    ::fsync(its_folder.get());
}

void requireName(const std::string& name) {
    if (!isUserName(name))
        throw std::runtime_error(shown(name) +
                                 ": expected a name of at most 64 letters, digits, '.', '-' and '_'");
}

void requireNew(const Users& users, const std::string& name, const std::string& file) {
    if (users.find(name) != nullptr)
        throw std::runtime_error(file + " has a user '" + name +
                                 "' already; fix: change the role with axon users role, or the password "
                                 "with axon users password");
}

const Users::User& require(const Users& users, const std::string& name, const std::string& file) {
    requireName(name);
    if (const auto* user = users.find(name)) return *user;
    throw std::runtime_error(file + " has no user '" + name +
                             "'; fix: see who is there with axon users list" +
                             ", or add one with axon users add");
}

std::string readLine() {
    std::string text;
    for (int c = std::getchar(); c != EOF && c != '\n'; c = std::getchar()) {
        if (c == kInterrupt) throw std::runtime_error("interrupted, so nothing was written");
        text += static_cast<char>(c);
        if (text.size() > 4 * kPasswordMax) break;
    }
    if (!text.empty() && text.back() == '\r') text.pop_back();
    return text;
}

/// While it lives, what is typed is not shown, and Ctrl-C is a character that ends the line: a program that
/// ended there would leave the terminal silent.
class SilentTerminal {
  public:
    SilentTerminal() {
        if (::tcgetattr(STDIN_FILENO, &before_) != 0) return;
        silent_ = true;
        auto its = before_;
        its.c_lflag &= ~static_cast<tcflag_t>(ECHO | ISIG);
        its.c_cc[VEOL] = kInterrupt;
        ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &its);
    }
    ~SilentTerminal() {
        if (silent_) ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &before_);
    }
    SilentTerminal(const SilentTerminal&) = delete;
    SilentTerminal& operator=(const SilentTerminal&) = delete;

  private:
    termios before_{};
    bool silent_ = false;
};

}  // namespace

std::string withUser(std::string_view text, const std::string& name, UserRole role, const std::string& hash) {
    const std::string its = name + " " + toString(role) + " " + hash;
    std::string out;
    bool written = false;
    while (!text.empty()) {
        const auto line = takeLine(text);
        if (!isLineOf(line, name)) {
            out += line;
            if (out.back() != '\n') out += '\n';
        } else if (!std::exchange(written, true)) {
            out += its + std::string(commentOf(line)) + "\n";
        }
    }
    if (!written) out += its + "\n";
    return out;
}

std::string withoutUser(std::string_view text, std::string_view name) {
    std::string out;
    while (!text.empty()) {
        const auto line = takeLine(text);
        if (!isLineOf(line, name)) out += line;
    }
    return out;
}

void mayAdd(const std::string& file, const std::string& name) {
    requireName(name);
    // Where nobody can tell whether there is a file, reading it says why.
    std::error_code failure;
    if (!std::filesystem::exists(file, failure) && !failure) return;
    requireNew(Users::read(file, MayBeEmpty::Yes), name, file);
}

void mayChange(const std::string& file, const std::string& name) {
    requireName(name);
    require(Users::read(file, MayBeEmpty::Yes), name, file);
}

void addUser(const std::string& file, const std::string& name, UserRole role, const std::string& password) {
    requireName(name);
    change(file, true, [&](const std::string& text, const Users& users) {
        requireNew(users, name, file);
        return withUser(text, name, role, hashPassword(password));
    });
}

void writeUser(const std::string& file, const std::string& name, UserRole role, const std::string& password) {
    requireName(name);
    change(file, true, [&](const std::string& text, const Users&) {
        return withUser(text, name, role, hashPassword(password));
    });
}

void setRole(const std::string& file, const std::string& name, UserRole role) {
    change(file, false, [&](const std::string& text, const Users& users) {
        return withUser(text, name, role, require(users, name, file).hash);
    });
}

void setPassword(const std::string& file, const std::string& name, const std::string& password) {
    change(file, false, [&](const std::string& text, const Users& users) {
        return withUser(text, name, require(users, name, file).role, hashPassword(password));
    });
}

void removeUser(const std::string& file, const std::string& name) {
    change(file, false, [&](const std::string& text, const Users& users) {
        require(users, name, file);
        if (users.size() == 1)
            throw std::runtime_error(
                "'" + name + "' is the only user of " + file +
                ", and no server reads a file without users; fix: add another one first");
        return withoutUser(text, name);
    });
}

std::string readNewPassword() {
    if (::isatty(STDIN_FILENO) == 0) return readLine();
    const SilentTerminal silent;
    const auto ask = [](const char* prompt) {
        std::fputs(prompt, stderr);
        auto line = readLine();
        std::fputs("\n", stderr);
        return line;
    };
    const auto first = ask("Password: ");
    if (first != ask("Once more: "))
        throw std::runtime_error("the two passwords differ, so nothing was written; fix: try again");
    return first;
}

}  // namespace axon::users
