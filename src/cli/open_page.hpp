// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

// Shows something in the user's browser. Threads: that of the verb.
namespace axon::cli {

/// Whether there is a graphical session in which a page can be shown.
bool hasDisplay();

/// Hands a file or an address to xdg-open. 0, or why not, as errno says it. Waits for xdg-open, which does
/// not wait for the browser.
int openPage(const std::string& page);

}  // namespace axon::cli
