// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "cli/session.hpp"

namespace axon::cli {

/// The streams that an entity sends now, by name: [{"name", "kind"}]. No profile lists them, so this listens
/// for 0.25 s, and a stream that sends more rarely may be missing. Empty too if the entity cannot be watched.
Json streamsOf(Session& session, const std::string& entity);

}  // namespace axon::cli
