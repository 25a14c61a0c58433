// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/shared_clock.hpp"

#include <fcntl.h>
#include <sys/mman.h>

#include <cstring>

#include "lab/sockets.hpp"

namespace axon::lab {

SharedClock::SharedClock(const std::string& path) {
    const Descriptor file(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644));
    if (!file || ::ftruncate(file.get(), sizeof(Page)) != 0) failWithErrno("--clock " + path);
    void* at = ::mmap(nullptr, sizeof(Page), PROT_READ | PROT_WRITE, MAP_SHARED, file.get(), 0);
    if (at == MAP_FAILED) failWithErrno("--clock " + path);
    page_ = static_cast<Page*>(at);
    set(Duration{});
    std::memcpy(page_->magic, "AXONCLK1", sizeof page_->magic);
}

SharedClock::~SharedClock() {
    ::munmap(page_, sizeof(Page));
}

}  // namespace axon::lab
