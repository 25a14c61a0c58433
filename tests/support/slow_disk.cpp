// SPDX-License-Identifier: GPL-2.0-or-later
// Stands in for functions of the C library, so the checks of its headers would be in the way.
#undef _FORTIFY_SOURCE
#include "support/slow_disk.hpp"

#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace {

constexpr std::size_t kDescriptors = 4096;
constexpr long kTrialMs = 2000;

// Of constant initialisation: the functions below are called before main() begins.
char folder[512];
char trigger[520];
std::atomic<long> each_ms{0};
std::atomic<std::uint64_t> calls{0};
std::array<std::atomic<bool>, kDescriptors> ours{};  // descriptors of files in the folder

__attribute__((constructor)) void readEnvironment() {
    const char* wanted = std::getenv("AXON_SLOW_DISK");
    if (wanted == nullptr) return;
    std::snprintf(folder, sizeof folder, "%s", wanted);
    std::snprintf(trigger, sizeof trigger, "%s/../slow", wanted);
}

void wait() {
    long ms = each_ms;
    if (trigger[0] != 0) ms = ::syscall(SYS_faccessat, AT_FDCWD, trigger, F_OK) == 0 ? kTrialMs : 0;
    if (ms <= 0) return;
    ++calls;
    timespec left{ms / 1000, ms % 1000 * 1'000'000};
    while (::nanosleep(&left, &left) != 0) {
    }
}
bool inside(const char* path) {
    return folder[0] != 0 && path != nullptr && std::strncmp(path, folder, std::strlen(folder)) == 0;
}
void touch(const char* path) {
    if (inside(path)) wait();
}
void touch(int fd) {
    if (fd >= 0 && static_cast<std::size_t>(fd) < kDescriptors && ours[static_cast<std::size_t>(fd)]) wait();
}
int opened(int fd, const char* path) {
    if (fd >= 0 && static_cast<std::size_t>(fd) < kDescriptors)
        ours[static_cast<std::size_t>(fd)] = inside(path);
    return fd;
}
template <class Function>
Function next(const char* name) {
    return reinterpret_cast<Function>(::dlsym(RTLD_NEXT, name));
}

}  // namespace

#define AXON_NEXT(name) static const auto real = next<decltype(&::name)>(#name)

extern "C" {

int open(const char* path, int flags, ...) {
    AXON_NEXT(open);
    va_list more;
    va_start(more, flags);
    const auto mode = va_arg(more, mode_t);
    va_end(more);
    touch(path);
    return opened(real(path, flags, mode), path);
}
int open64(const char* path, int flags, ...) {
    AXON_NEXT(open64);
    va_list more;
    va_start(more, flags);
    const auto mode = va_arg(more, mode_t);
    va_end(more);
    touch(path);
    return opened(real(path, flags, mode), path);
}
FILE* fopen(const char* path, const char* mode) {
    AXON_NEXT(fopen);
    touch(path);
    return real(path, mode);
}
FILE* fopen64(const char* path, const char* mode) {
    AXON_NEXT(fopen64);
    touch(path);
    return real(path, mode);
}
int close(int fd) {
    AXON_NEXT(close);
    touch(fd);
    // Before it is closed: another thread may then be given the same number, for a socket.
    if (fd >= 0 && static_cast<std::size_t>(fd) < kDescriptors) ours[static_cast<std::size_t>(fd)] = false;
    return real(fd);
}
ssize_t write(int fd, const void* bytes, size_t size) {
    AXON_NEXT(write);
    touch(fd);
    return real(fd, bytes, size);
}
int fsync(int fd) {
    AXON_NEXT(fsync);
    touch(fd);
    return real(fd);
}
int ftruncate(int fd, off_t size) noexcept {
    AXON_NEXT(ftruncate);
    touch(fd);
    return real(fd, size);
}
int rename(const char* from, const char* to) noexcept {
    AXON_NEXT(rename);
    touch(to);
    return real(from, to);
}
int unlink(const char* path) noexcept {
    AXON_NEXT(unlink);
    touch(path);
    return real(path);
}
int remove(const char* path) noexcept {
    AXON_NEXT(remove);
    touch(path);
    return real(path);
}
int mkdir(const char* path, mode_t mode) noexcept {
    AXON_NEXT(mkdir);
    touch(path);
    return real(path, mode);
}
int stat(const char* path, struct stat* facts) noexcept {
    static const auto real = next<int (*)(const char*, struct stat*)>("stat");
    touch(path);
    return real(path, facts);
}
int lstat(const char* path, struct stat* facts) noexcept {
    static const auto real = next<int (*)(const char*, struct stat*)>("lstat");
    touch(path);
    return real(path, facts);
}
DIR* opendir(const char* path) {
    AXON_NEXT(opendir);
    touch(path);
    return real(path);
}

}  // extern "C"

namespace axon::test {

void makeSlow(const std::filesystem::path& at, std::chrono::milliseconds each) {
    std::snprintf(folder, sizeof folder, "%s", at.c_str());
    each_ms = each.count();
}

std::uint64_t slowCalls() {
    return calls;
}

}  // namespace axon::test
