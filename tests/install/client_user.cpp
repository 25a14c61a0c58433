// SPDX-License-Identifier: GPL-2.0-or-later
#include <axon/client.hpp>
#include <cstdio>

// Nothing listens at port 1: what is shown is that the library compiles, links and answers in another
// project.
int main() {
    axon::client::Options options;
    options.server = "127.0.0.1:1";
    options.timeout = axon::client::Seconds(0.5);
    const auto connected = axon::client::Client::connect(options);
    if (connected) return 1;
    std::printf("%s\n", connected.refusal().message.c_str());
    return 0;
}
