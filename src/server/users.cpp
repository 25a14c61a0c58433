// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/users.hpp"

#include <crypt.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "common/descriptor.hpp"

namespace axon::server {
namespace {

constexpr std::size_t kFileMax = 1024 * 1024;
constexpr std::size_t kHashMax = 383;   // CRYPT_OUTPUT_SIZE, with its zero
constexpr std::size_t kDigestMin = 43;  // of SHA-256 and yescrypt; of MD5 22, of DES 11
// Of no password: an unknown user's is compared with it where the file has nobody.
constexpr const char* kNobody =
    "$6$axonnobodyhere$x7C57Za9X2zTX9U.UjLOsDvIz1JNvtCR8yr06Y.07VukDnIAQSiNXEnkuwyb9d.df2OpRUXC.wglXYtbc/"
    "uFK0";
constexpr const char* kHowTo =
    "write the line with axon-server --users FILE --add-user NAME --user-role ROLE";

std::vector<std::string_view> fieldsOf(std::string_view line) {
    std::vector<std::string_view> fields;
    constexpr std::string_view kBlank = " \t";
    for (auto at = line.find_first_not_of(kBlank); at != std::string_view::npos;
         at = line.find_first_not_of(kBlank, at)) {
        const auto end = std::min(line.find_first_of(kBlank, at), line.size());
        fields.push_back(line.substr(at, end - at));
        at = end;
    }
    return fields;
}

/// The line without its comment and line end.
std::string_view contentOf(std::string_view line) {
    line = line.substr(0, line.find('#'));
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ' || line.back() == '\t'))
        line.remove_suffix(1);
    return line;
}

bool isHash(const std::string& hash) {
    const auto plain = [](unsigned char c) {
        return std::isalnum(c) != 0 || c == '.' || c == '/' || c == '$' || c == '=' || c == ',' || c == '-';
    };
    if (hash.size() > kHashMax || hash.front() != '$' || !std::all_of(hash.begin(), hash.end(), plain))
        return false;
    return hash.size() - hash.rfind('$') > kDigestMin && crypt_checksalt(hash.c_str()) == CRYPT_SALT_OK;
}

std::string shown(std::string_view text) {
    std::string out;
    for (const unsigned char c : text.substr(0, 64))
        out += c >= 0x20 && c < 0x7f ? static_cast<char>(c) : '?';
    return "'" + out + "'";
}

/// In a time that does not depend on where they differ.
bool same(std::string_view one, std::string_view other) {
    if (one.size() != other.size()) return false;
    volatile unsigned char different = 0;
    for (std::size_t i = 0; i < one.size(); ++i)
        different = different | (static_cast<unsigned char>(one[i]) ^ static_cast<unsigned char>(other[i]));
    return different == 0;
}

bool matches(const std::string& hash, const std::string& password) {
    const auto work = std::make_unique<crypt_data>();
    // What crypt cannot take is compared all the same: a refusal in less time would tell something.
    const bool usable = password.size() <= kPasswordMax && password.find('\0') == std::string::npos;
    const char* made = crypt_r(usable ? password.c_str() : "", hash.c_str(), work.get());
    const bool equal = made != nullptr && same(made, hash);
    explicit_bzero(work.get(), sizeof(crypt_data));
    return usable && equal;
}

[[noreturn]] void fail(const std::string& file, const std::string& what) {
    throw std::runtime_error(file + ": " + what + " (" + std::generic_category().message(errno) + ")");
}

std::string contentOf(int fd, const std::string& file) {
    std::string text;
    std::array<char, 4096> buffer;
    while (true) {
        const auto got = ::read(fd, buffer.data(), buffer.size());
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) fail(file, "cannot be read");
        if (got == 0) return text;
        text.append(buffer.data(), static_cast<std::size_t>(got));
        if (text.size() > kFileMax) throw std::runtime_error(file + ": expected at most 1 MiB");
    }
}

}  // namespace

const char* toString(UserRole role) {
    switch (role) {
        case UserRole::Observer:
            return "observer";
        case UserRole::Operator:
            return "operator";
        case UserRole::Admin:
            return "admin";
        case UserRole::Entity:
            return "entity";
    }
    return "?";
}

std::optional<UserRole> userRole(std::string_view text) {
    for (const auto role : {UserRole::Observer, UserRole::Operator, UserRole::Admin, UserRole::Entity})
        if (text == toString(role)) return role;
    return std::nullopt;
}

bool isUserName(std::string_view name) {
    return !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), [](unsigned char c) {
        return std::isalnum(c) != 0 || c == '.' || c == '-' || c == '_';
    });
}

Users Users::parse(std::string_view text, const std::string& file) {
    Users users;
    int number = 0;
    while (!text.empty()) {
        ++number;
        const auto end = text.find('\n');
        const auto line = contentOf(text.substr(0, end));
        text = end == std::string_view::npos ? std::string_view() : text.substr(end + 1);
        const auto refuse = [&](const std::string& expected) {
            throw std::runtime_error(file + ":" + std::to_string(number) + ": " + expected +
                                     "; fix: " + kHowTo);
        };
        const auto fields = fieldsOf(line);
        if (fields.empty()) continue;
        if (fields.size() != 3)
            refuse("expected 'name role hash', not " + std::to_string(fields.size()) + " words");
        if (!isUserName(fields[0]))
            refuse("expected a name of at most 64 letters, digits, '.', '-' and '_', not " +
                   shown(fields[0]));
        const auto role = userRole(fields[1]);
        if (!role) refuse("expected the role observer, operator, admin or entity, not " + shown(fields[1]));
        std::string hash(fields[2]);
        // What it is, is not shown: perhaps somebody wrote the password itself.
        if (!isHash(hash)) refuse("expected a hash that begins with $y$ or $6$, not one of an older kind");
        if (users.find(fields[0]) != nullptr)
            refuse("expected one line per user, but " + shown(fields[0]) + " has one already");
        users.users_.push_back({std::string(fields[0]), *role, std::move(hash)});
    }
    return users;
}

Users Users::read(const std::string& file) {
    const Descriptor fd(::open(file.c_str(), O_RDONLY | O_CLOEXEC));
    if (fd.get() < 0) fail(file, "expected a readable file of users");
    struct stat facts {};
    if (::fstat(fd.get(), &facts) != 0) fail(file, "cannot be read");
    if (!S_ISREG(facts.st_mode)) throw std::runtime_error(file + ": expected a regular file");
    if ((facts.st_mode & 07777U & ~0640U) != 0) {
        std::array<char, 8> mode{};
        std::snprintf(mode.data(), mode.size(), "%04o", static_cast<unsigned>(facts.st_mode & 07777U));
        throw std::runtime_error(
            file + ": its permissions are " + mode.data() +
            "; expected 0640 or narrower, because it holds password hashes; fix: chmod 640 " + file);
    }
    auto users = parse(contentOf(fd.get(), file), file);
    if (users.size() == 0)
        throw std::runtime_error(file + ": expected at least one user; fix: " + std::string(kHowTo));
    return users;
}

const Users::User* Users::find(std::string_view name) const {
    const auto found =
        std::find_if(users_.begin(), users_.end(), [&](const User& user) { return user.name == name; });
    return found == users_.end() ? nullptr : &*found;
}

std::optional<UserRole> Users::verify(const std::string& name, const std::string& password) const {
    const auto* user = find(name);
    const auto& hash = user != nullptr ? user->hash : users_.empty() ? kNobody : users_.front().hash;
    const bool right = matches(hash, password);
    if (user == nullptr || !right) return std::nullopt;
    return user->role;
}

std::optional<UserRole> Users::roleOf(const std::string& name) const {
    const auto* user = find(name);
    return user == nullptr ? std::nullopt : std::optional(user->role);
}

std::string hashPassword(const std::string& password) {
    if (password.empty() || password.size() > kPasswordMax || password.find('\0') != std::string::npos)
        throw std::runtime_error("expected a password of 1 to 511 bytes without a zero byte");
    for (const char* kind : {"$y$", "$6$"}) {
        std::array<char, CRYPT_GENSALT_OUTPUT_SIZE> salt{};
        if (crypt_gensalt_rn(kind, 0, nullptr, 0, salt.data(), static_cast<int>(salt.size())) == nullptr)
            continue;
        const auto work = std::make_unique<crypt_data>();
        const char* made = crypt_r(password.c_str(), salt.data(), work.get());
        std::string hash(made != nullptr ? made : "");
        explicit_bzero(work.get(), sizeof(crypt_data));
        if (!hash.empty() && isHash(hash)) return hash;
    }
    throw std::runtime_error(
        "libcrypt makes neither yescrypt nor SHA-512 hashes on this machine; fix: make the hash with openssl "
        "passwd -6 and write the line yourself");
}

std::string withUser(std::string_view text, const std::string& name, UserRole role, const std::string& hash) {
    const std::string its = name + " " + toString(role) + " " + hash + "\n";
    std::string out;
    bool written = false;
    while (!text.empty()) {
        const auto end = std::min(text.find('\n'), text.size() - 1) + 1;
        const auto line = text.substr(0, end);
        text.remove_prefix(end);
        const auto content = contentOf(line.back() == '\n' ? line.substr(0, line.size() - 1) : line);
        const auto fields = fieldsOf(content);
        if (fields.empty() || fields[0] != name) {
            out += line;
            if (out.back() != '\n') out += '\n';
        } else if (!std::exchange(written, true)) {
            out += its;
        }
    }
    if (!written) out += its;
    return out;
}

void writeUser(const std::string& file, const std::string& name, UserRole role, const std::string& password) {
    if (!isUserName(name))
        throw std::runtime_error(shown(name) +
                                 ": expected a name of at most 64 letters, digits, '.', '-' and '_'");
    std::string text =
        "# Who may log in at axon-server: name role hash. Roles: observer, operator, admin, entity.\n";
    mode_t mode = 0600;
    uid_t owner = ::geteuid();
    gid_t group = ::getegid();
    if (const Descriptor old(::open(file.c_str(), O_RDONLY | O_CLOEXEC)); old.get() >= 0) {
        struct stat facts {};
        if (::fstat(old.get(), &facts) != 0) fail(file, "cannot be read");
        mode = facts.st_mode & 0640U;
        owner = facts.st_uid;
        group = facts.st_gid;
        text = contentOf(old.get(), file);
        Users::parse(text, file);  // nothing is added to what the server would refuse
    } else if (errno != ENOENT) {
        fail(file, "cannot be read");
    }
    text = withUser(text, name, role, hashPassword(password));

    const auto next = file + ".new";
    ::unlink(next.c_str());
    const Descriptor fd(::open(next.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, mode));
    if (fd.get() < 0) fail(next, "cannot be written");
    // The server may read it as another user or through its group.
    if ((owner != ::geteuid() || group != ::getegid()) && ::fchown(fd.get(), owner, group) != 0) {
        const auto failure = errno;
        ::unlink(next.c_str());
        errno = failure;
        fail(next, "cannot be given to the owner and group of the present file");
    }
    for (std::string_view rest = text; !rest.empty();) {
        const auto done = ::write(fd.get(), rest.data(), rest.size());
        if (done < 0 && errno == EINTR) continue;
        if (done < 0) fail(next, "cannot be written");
        rest.remove_prefix(static_cast<std::size_t>(done));
    }
    if (::fsync(fd.get()) != 0) fail(next, "cannot be written");
    if (::rename(next.c_str(), file.c_str()) != 0) fail(file, "cannot be replaced");
}

std::string readPassword() {
    const auto line = [] {
        std::string text;
        for (int c = std::getchar(); c != EOF && c != '\n'; c = std::getchar()) text += static_cast<char>(c);
        return text;
    };
    if (::isatty(STDIN_FILENO) == 0) return line();
    termios before{};
    if (::tcgetattr(STDIN_FILENO, &before) != 0) return line();
    auto silent = before;
    silent.c_lflag &= ~static_cast<tcflag_t>(ECHO);
    ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &silent);
    std::fputs("Password: ", stderr);
    const auto first = line();
    std::fputs("\nOnce more: ", stderr);
    const auto second = line();
    std::fputs("\n", stderr);
    ::tcsetattr(STDIN_FILENO, TCSAFLUSH, &before);
    if (first != second)
        throw std::runtime_error("the two passwords differ, so nothing was written; fix: try again");
    return first;
}

}  // namespace axon::server
