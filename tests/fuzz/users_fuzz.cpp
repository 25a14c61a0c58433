// SPDX-License-Identifier: GPL-2.0-or-later
// users.cfg and the kernel's table of sockets: any text is accepted or refused with the line. What is
// accepted is accepted again with one user more.
#include <cstdint>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <string_view>

#include "host/socket_owner.hpp"
#include "users/users_file.hpp"

namespace {

constexpr const char* kHash =
    "$6$saltsalt$jCP90RmSIIja2o9FRs25ASQaR1lMN6uKHmNcHaoNCpAXgV3n5NfAlQdZQcvMVQO1BTCOFF0LzoHFZBt9E45NW0";

void require(bool holds) {
    if (!holds) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    using axon::users::Users;
    const std::string text(reinterpret_cast<const char*>(bytes), size);
    axon::socketOwner(std::string_view(text), "127.0.0.1:50122", "127.0.0.1:10410");
    std::size_t before = 0;
    try {
        before = Users::parse(text, "f").size();
    } catch (const std::runtime_error& error) {
        const std::string what = error.what();
        require(what.rfind("f:", 0) == 0 && what.find(": expected ") != std::string::npos);
        return 0;
    }
    const auto more = axon::users::withUser(text, "added", axon::users::UserRole::Admin, kHash);
    const auto after = Users::parse(more, "f").size();
    require(after == before || after == before + 1);
    require(axon::users::withUser(more, "added", axon::users::UserRole::Admin, kHash) == more);
    return 0;
}
