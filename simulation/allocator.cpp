// SPDX-License-Identifier: GPL-2.0-or-later
// Memory of axon-simulate. A seed makes and forgets a hundred thousand small objects, all on one thread: they
// come from lists of that thread, by size, and go back to them. What a thread has taken it keeps.
#include <array>
#include <cstddef>
#include <cstdlib>
#include <new>

namespace {

constexpr std::size_t kGrain = 16;
constexpr std::size_t kLargest = 2048;  // above that it is malloc's
constexpr std::size_t kChunk = std::size_t{512} * 1024;

struct Free {
    Free* next;
};
/// Before each block; keeps it aligned for everything.
struct alignas(std::max_align_t) Mark {
    std::size_t list;
};
static_assert(sizeof(Mark) == kGrain);

struct Pool {
    std::array<Free*, kLargest / kGrain + 1> lists;
    char* at;
    char* end;
};
constinit thread_local Pool pool{};

void* take(std::size_t size) {
    const auto list = (size + kGrain - 1) / kGrain;
    if (list >= pool.lists.size()) {
        auto* mark = static_cast<Mark*>(std::malloc(sizeof(Mark) + size));
        if (mark == nullptr) throw std::bad_alloc();
        mark->list = pool.lists.size();
        return mark + 1;
    }
    if (auto* found = pool.lists[list]) {
        pool.lists[list] = found->next;
        return found;
    }
    const auto bytes = sizeof(Mark) + (list == 0 ? kGrain : list * kGrain);
    if (static_cast<std::size_t>(pool.end - pool.at) < bytes) {
        pool.at = static_cast<char*>(std::malloc(kChunk));
        if (pool.at == nullptr) throw std::bad_alloc();
        pool.end = pool.at + kChunk;
    }
    auto* mark = reinterpret_cast<Mark*>(pool.at);
    pool.at += bytes;
    mark->list = list;
    return mark + 1;
}

void give(void* block) {
    if (block == nullptr) return;
    auto* mark = static_cast<Mark*>(block) - 1;
    if (mark->list >= pool.lists.size()) {
        std::free(mark);
        return;
    }
    auto* free = static_cast<Free*>(block);
    free->next = pool.lists[mark->list];
    pool.lists[mark->list] = free;
}

}  // namespace

void* operator new(std::size_t size) {
    return take(size);
}
void operator delete(void* block) noexcept {
    give(block);
}
void operator delete(void* block, std::size_t) noexcept {
    give(block);
}
