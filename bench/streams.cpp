// SPDX-License-Identifier: GPL-2.0-or-later
#include "streams.hpp"

#include <unistd.h>

#include <chrono>
#include <thread>
#include <vector>

#include "axon_crowd.hpp"
#include "mosquitto_peer.hpp"

namespace axon::bench {

namespace {

using namespace std::chrono_literals;

/// send(i) to each receiver in turn while the board says go; it returns whether it was taken.
template <class Send>
int stream(StreamBoard& board, std::size_t receivers, const Send& send) {
    const auto parent = ::getppid();
    std::string bytes = content(kDataBytes);
    std::vector<std::uint32_t> numbers(receivers, 0);
    ++board.ready();
    while (::getppid() == parent) {
        if (board.go() == 0) {
            std::this_thread::sleep_for(1ms);
            continue;
        }
        for (std::size_t i = 0; i < receivers; ++i) {
            setNumber(bytes, numbers[i]);
            if (send(i, bytes)) {
                ++numbers[i];
                ++board[0].sent;
            } else {
                ++board[0].refused;
            }
        }
    }
    return 0;
}

}  // namespace

int runAxonStream(const std::string& board_file, const std::string& server, std::size_t readers,
                  std::size_t stalled) {
    StreamBoard board(board_file, 1, false);
    const auto client = connectClient(server);
    std::vector<std::string> names;
    for (std::size_t i = 0; i < readers; ++i) names.push_back("reader-" + std::to_string(i));
    for (std::size_t i = 0; i < stalled; ++i) names.push_back("stalled-" + std::to_string(i));
    const auto held = holdAll(*client, names);
    return stream(board, held.size(), [&](std::size_t i, const std::string& bytes) {
        return held[i].sendRaw(bytes, client::Seconds{1}).ok();
    });
}

int runMosquittoStream(const std::string& board_file, std::uint16_t port, std::size_t receivers) {
    StreamBoard board(board_file, 1, false);
    MosquittoSender sender(port, 0);
    return stream(board, receivers, [&](std::size_t i, const std::string& bytes) {
        sender.send(i, Kind::Data, bytes);
        return true;
    });
}

}  // namespace axon::bench
