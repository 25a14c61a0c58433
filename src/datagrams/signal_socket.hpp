// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <vector>

namespace axon::datagrams {

/// Options that a signal lane's TCP socket gets, on either end (docs/reference/datagrams.md, "Socket
/// options of the signal lane"): no delay; a minimum retransmission time-out of 10 ms instead of 200, a
/// maximum of 1 s instead of 120, not doubled while few packets are under way, which needs Reno's congestion
/// control; acknowledgements within 8 ms; data that nobody acknowledges for 10 s ends the connection; marked
/// as expedited forwarding and as the highest priority that needs no privilege. Names those that this kernel
/// does not have or does not permit, empty when all are set. Never fails for it.
std::vector<std::string> prepareSignalSocket(int fd);

/// The marks alone: DSCP and priority, and no more than 64 KiB waiting to be read.
std::vector<std::string> prepareDatagramSocket(int fd);

}  // namespace axon::datagrams
