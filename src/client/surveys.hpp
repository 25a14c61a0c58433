// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <stop_token>
#include <string>
#include <vector>

#include "axon/client.hpp"

// Questions that are put to several entities at once, and whose answers are awaited: one function for each of
// Client's functions of the same name. On the user's thread; each holds the session's locks only while it
// asks.
namespace axon::client {

Result<Proposal> propose(Client::Session& session, const GlobalService& service, const Bindings& chosen);
Result<RunHistory> runHistory(Client::Session& session, const std::vector<std::string>& names, int most);
Result<std::vector<DrillReport>> drill(Client::Session& session, const std::vector<std::string>& names,
                                       int count, Seconds period, const std::stop_token& give_up);

}  // namespace axon::client
