// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <string_view>

#include "axon/types.hpp"
#include "client/core/core_context.hpp"
#include "client/core/requests.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"

namespace axon::proto {
class ResourceCredit;
}

namespace axon::client {

/// What a client wants of an entity besides tasks: parameters, resources, texts, raw data, and the commands
/// of the signal lane. Part of SessionCore; it has no state but its requests. Refused here: NOT_CONNECTED,
/// NOT_HOLDER, and what the services profile of the lease does not have.
class Commands {
  public:
    explicit Commands(const CoreParts& parts) : parts_(parts) {}

    void set(const Held& held, std::string_view service, const Argument& argument, Done done);
    Result<void> sendText(const Held& held, std::string_view text);
    Result<void> sendRaw(const Held& held, std::string_view bytes);
    /// `sequence`: of the signals of this client; 0 = the next one.
    Result<void> reset(const Held& held, std::int64_t sequence = 0);
    Result<void> clear(const Held& held, std::int64_t sequence = 0);
    /// No lease needed.
    void rearm(const std::string& entity, Done done);
    /// Offers a resource. Credits come through the observer until `done`; its time counts from the last of
    /// them.
    Id128 offer(const Held& held, std::string_view service, std::string_view resource,
                const std::string& file_name, std::uint64_t size, const std::string& sha256, Done done);
    /// At most 64 KiB, inside the window of the last credit. The refusal of a transfer that has ended.
    Result<void> sendChunk(const Id128& transfer, std::uint64_t offset, std::string_view content);

    void onResourceCredit(const proto::ResourceCredit& credit);

  private:
    const CoreParts& parts_;
};

}  // namespace axon::client
