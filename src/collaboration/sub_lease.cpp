// SPDX-License-Identifier: GPL-2.0-or-later
#include "collaboration/sub_lease.hpp"

#include <sodium.h>

#include <array>
#include <stdexcept>

namespace axon::collaboration {

namespace {

using Mac = std::array<unsigned char, crypto_generichash_BYTES>;

/// BLAKE2b takes the key as it is, 16 bytes or more. Each field goes with its length, so that none can be
/// taken for a part of another.
Mac macOf(const proto::SubLease& lease, const Grant& grant, std::string_view key) {
    if (key.size() != crypto_generichash_KEYBYTES_MIN)
        throw std::invalid_argument("a lease key has 16 bytes");
    std::string text;
    const auto add = [&text](std::string_view field) {
        text.append(std::to_string(field.size())).append(":").append(field);
    };
    add("axon sub-lease 1");
    add(grant.run_id);
    add(grant.master);
    add(grant.entity);
    add(std::to_string(lease.epoch()));
    add(std::to_string(lease.number()));
    add(lease.root());
    add(std::to_string(lease.stop_generation()));
    const auto bytes = [](std::string_view from) {
        return reinterpret_cast<const unsigned char*>(from.data());
    };
    Mac mac{};
    crypto_generichash(mac.data(), mac.size(), bytes(text), text.size(), bytes(key), key.size());
    return mac;
}

}  // namespace

void seal(proto::SubLease& lease, const Grant& grant, std::string_view key) {
    const auto mac = macOf(lease, grant, key);
    lease.set_proof(mac.data(), mac.size());
}

bool isSealed(const proto::SubLease& lease, const Grant& grant, std::string_view key) {
    const auto mac = macOf(lease, grant, key);
    return lease.proof().size() == mac.size() &&
           sodium_memcmp(mac.data(), lease.proof().data(), mac.size()) == 0;
}

}  // namespace axon::collaboration
