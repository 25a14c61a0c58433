// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/ports/resource_places.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <system_error>
#include <utility>

#include "common/descriptor.hpp"
#include "common/utf8.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace fs = std::filesystem;

namespace {

constexpr std::size_t kCopyAtOnce = 1U << 20U;
constexpr std::size_t kNameShown = 100;

bool lies(const fs::path& path, const fs::path& folder) {
    return std::mismatch(folder.begin(), folder.end(), path.begin(), path.end()).first == folder.end();
}

std::string shownPath(const fs::path& path) {
    return inQuotes(path.string(), 512);
}

ResourcePlace refused(RefusalCode code, std::string message) {
    ResourcePlace place;
    place.refusal = {code, std::move(message), {}};
    return place;
}

/// Of something that a system call has said about the path.
Refusal failed(const char* what, const fs::path& path, int error) {
    std::string message = std::string("the Entity Manager cannot ") + what + ' ' + shownPath(path) + ": " +
                          std::generic_category().message(error);
    switch (error) {
        case EACCES:
        case EPERM:
            return {RefusalCode::PermissionDenied,
                    message + "; give its user the right to, on the robot's machine",
                    {}};
        case EROFS:
            return {RefusalCode::PermissionDenied,
                    message + "; the profile's url must name a place that can be written",
                    {}};
        case ENOSPC:
        case EDQUOT:
            return {RefusalCode::Overloaded, message + "; make room on the robot's disk", {}};
        default:
            return {RefusalCode::Internal, message, {}};
    }
}

ResourcePlace lookAt(const fs::path& path) {
    ResourcePlace place;
    place.path = path.string();
    struct stat facts {};
    if (::stat(path.c_str(), &facts) != 0) {
        if (errno != ENOENT && errno != ENOTDIR) place.refusal = failed("look at", path, errno);
    } else if (!S_ISREG(facts.st_mode)) {
        place.refusal = {
            RefusalCode::BadName, shownPath(path) + " is no ordinary file; a url names a file", {}};
    } else {
        place.there = true;
        place.size = static_cast<std::uint64_t>(facts.st_size);
    }
    if (place.refusal.ok() && !isUtf8(place.path))
        place.refusal = {RefusalCode::BadName, shownPath(path) + " is not UTF-8 text; rename the folder", {}};
    if (!place.refusal.ok()) place.path.clear();
    return place;
}

/// All of it, beside the place and under another name; the descriptor keeps its mode.
Refusal copy(int from, const fs::path& from_path, int to, const fs::path& to_path) {
    std::string part(kCopyAtOnce, '\0');
    ::lseek(from, 0, SEEK_SET);
    while (true) {
        const auto got = ::read(from, part.data(), part.size());
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return failed("read", from_path, errno);
        if (got == 0) break;
        for (ssize_t done = 0; done < got;) {
            const auto put = ::write(to, part.data() + done, static_cast<std::size_t>(got - done));
            if (put < 0 && errno == EINTR) continue;
            if (put <= 0) return failed("write", to_path, errno);
            done += put;
        }
    }
    return ::fsync(to) == 0 ? Refusal{} : failed("write", to_path, errno);
}

}  // namespace

ResourcePlace findResourcePlace(const ResourceRoots& roots, std::string_view url) {
    if (const auto bad = checkResourceUrl(url); !bad.ok()) return refused(bad.code, bad.message);
    const fs::path named{std::string(url)};
    const bool absolute = named.is_absolute();
    if (!absolute && roots.profiles.empty())
        return refused(RefusalCode::BadName,
                       "the robot application does not say in which folder its profiles lie, so " +
                           inQuotes(url) +
                           " leads nowhere; give it an Entity Interfacer that says so, or an absolute url");
    const auto path = absolute ? named : fs::path(roots.profiles) / named;
    std::error_code error;
    const auto real = fs::weakly_canonical(path, error);
    if (error) return refused(RefusalCode::Internal, failed("look at", path, error.value()).message);
    bool below = false;  // as it is written
    std::string folders;
    for (const auto& folder : absolute ? roots.permitted : std::vector<std::string>{roots.profiles}) {
        std::error_code missing;
        const auto root = fs::canonical(folder, missing);
        folders += (folders.empty() ? "" : ", ") + shownPath(folder);
        if (!missing && lies(real, root)) return lookAt(real);
        below = below || lies(path, fs::path(folder).lexically_normal());
    }
    if (below)
        return refused(RefusalCode::BadName,
                       shownPath(path) + " leads to " + shownPath(real) +
                           ", out of its folder, by a symbolic link; name a file below " + folders);
    return refused(RefusalCode::BadName, shownPath(path) +
                                             " lies in no folder that the robot application permits (" +
                                             (folders.empty() ? std::string("it permits none") : folders) +
                                             "); add its folder to resource_folders of the application's "
                                             "Entity Interfacer, or write a path relative to the profile");
}

Refusal mayReplaceResource(const ResourcePlace& place) {
    if (!place.refusal.ok()) return place.refusal;
    struct stat facts {};
    if (::stat(place.path.c_str(), &facts) == 0) {
        const bool read_only = (facts.st_mode & (S_IWUSR | S_IWGRP | S_IWOTH)) == 0;
        if (read_only || ::access(place.path.c_str(), W_OK) != 0)
            return {RefusalCode::PermissionDenied,
                    shownPath(place.path) +
                        " is read-only for the Entity Manager: it was not replaced; give its user the right "
                        "to write there",
                    {}};
    }
    // The nearest folder that is there: the others are made.
    auto folder = fs::path(place.path).parent_path();
    while (::access(folder.c_str(), F_OK) != 0 && errno == ENOENT && folder.has_relative_path())
        folder = folder.parent_path();
    if (::access(folder.c_str(), W_OK | X_OK) != 0) return failed("write in the folder", folder, errno);
    return {};
}

Result<void> replaceResource(const std::string& from, const ResourcePlace& place) {
    if (auto refusal = mayReplaceResource(place); !refusal.ok()) return refusal;
    const fs::path to = place.path;
    std::error_code error;
    fs::create_directories(to.parent_path(), error);
    if (error) return failed("make the folder", to.parent_path(), error.value());
    const Descriptor arrived(::open(from.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
    if (!arrived.open()) return failed("open", from, errno);
    struct stat old {};
    const mode_t mode = ::stat(to.c_str(), &old) == 0 ? old.st_mode & 0777U : 0644U;
    struct stat arrived_facts {
    }, folder_facts{};
    const bool same_disk = ::fstat(arrived.get(), &arrived_facts) == 0 &&
                           ::stat(to.parent_path().c_str(), &folder_facts) == 0 &&
                           arrived_facts.st_dev == folder_facts.st_dev;
    if (same_disk) {
        if (::fchmod(arrived.get(), mode) != 0) return failed("set the mode of", from, errno);
        // A later life takes what lies there for whole.
        if (::fsync(arrived.get()) != 0) return failed("write", from, errno);
        if (::rename(from.c_str(), to.c_str()) == 0) return {};
        if (errno != EXDEV) return failed("replace", to, errno);
    }
    const auto fresh = to.parent_path() / (".axon-new-" + to.filename().string().substr(0, kNameShown));
    ::unlink(fresh.c_str());  // of a life that ended in the middle
    const Descriptor copied(
        ::open(fresh.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600));
    if (!copied.open()) return failed("write", fresh, errno);
    auto refusal = copy(arrived.get(), from, copied.get(), fresh);
    if (refusal.ok() && ::fchmod(copied.get(), mode) != 0) refusal = failed("set the mode of", fresh, errno);
    if (refusal.ok() && ::rename(fresh.c_str(), to.c_str()) != 0) refusal = failed("replace", to, errno);
    if (!refusal.ok()) {
        ::unlink(fresh.c_str());
        return refusal;
    }
    ::unlink(from.c_str());
    return {};
}

}  // namespace axon::entity_manager
