// SPDX-License-Identifier: GPL-2.0-or-later
// The stop as a datagram: whatever bytes arrive, what is accepted says the same when it is written again, a
// sentry executes it once, and nothing without the key's MAC is accepted. The input is one datagram; the same
// bytes with their MAC made right are tried as well, so that fields behind the MAC are reached.
#include <sodium.h>

#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>

#include "datagrams/stop_datagram.hpp"
#include "datagrams/stop_sentry.hpp"

namespace {

using namespace axon;
using namespace axon::datagrams;

const std::string kKey = "0123456789abcdef";
const std::string kOtherKey = "fedcba9876543210";

void examine(const std::string& bytes) {
    const auto read = decode(bytes, kKey);
    if (decode(bytes, kOtherKey)) std::abort();
    StopSentry sentry;
    if (!read) {
        sentry.hold({3, 7}, kKey, {"11111111-1111-4111-8111-111111111111", "client1", Role::Operator});
        if (sentry.judge(bytes).verdict != StopSentry::Verdict::Refused) std::abort();
        return;
    }
    const auto again = encode(*read, kKey);
    if (std::string(again.data(), again.size()) != bytes) std::abort();
    if (leaseOf(bytes) != read->lease || read->sequence <= 0) std::abort();
    sentry.hold(read->lease, kKey, {read->sender.toString(), "client1", Role::Operator});
    const bool stop = read->kind == StopDatagram::Kind::Stop;
    using Verdict = StopSentry::Verdict;
    if (sentry.judge(bytes).verdict != (stop ? Verdict::New : Verdict::Refused)) std::abort();
    if (sentry.judge(bytes).verdict != (stop ? Verdict::Again : Verdict::Refused)) std::abort();
    sentry.end();
    if (sentry.judge(bytes).verdict != Verdict::Refused) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    std::string input(reinterpret_cast<const char*>(bytes), size);
    examine(input);
    if (size != kStopDatagramBytes) return 0;
    crypto_auth_hmacsha256_state state;
    crypto_auth_hmacsha256_init(&state, reinterpret_cast<const unsigned char*>(kKey.data()), kKey.size());
    crypto_auth_hmacsha256_update(&state, bytes, size - 16);
    unsigned char mac[crypto_auth_hmacsha256_BYTES];
    crypto_auth_hmacsha256_final(&state, mac);
    std::memcpy(input.data() + size - 16, mac, 16);
    examine(input);
    return 0;
}
