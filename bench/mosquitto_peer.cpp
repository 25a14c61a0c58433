// SPDX-License-Identifier: GPL-2.0-or-later
#include "mosquitto_peer.hpp"

#include <mosquitto.h>
#include <poll.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <array>
#include <stdexcept>
#include <vector>

#include "board.hpp"

namespace axon::bench {

namespace {

struct Receiver {
    Board* board = nullptr;
    std::size_t index = 0;
    mosquitto* client = nullptr;
};

void check(int code, const char* what) {
    if (code != MOSQ_ERR_SUCCESS) throw std::runtime_error(std::string(what) + ": " + mosquitto_strerror(code));
}

void onMessage(mosquitto*, void* object, const mosquitto_message* message) {
    const auto now = nowNs();
    auto& receiver = *static_cast<Receiver*>(object);
    auto& slot = (*receiver.board)[receiver.index];
    const char kind = message->topic[0];  // "s/17" or "d/17"
    if (kind == 's') {
        slot.stop_at = now;
        ++slot.stops;
    } else {
        if (!batchIntact(static_cast<const char*>(message->payload), static_cast<std::size_t>(message->payloadlen))) ++slot.corrupt;
        slot.data_at = now;
        ++slot.data;
    }
}

void onConnect(mosquitto* client, void* object, int) {
    const auto index = std::to_string(static_cast<Receiver*>(object)->index);
    mosquitto_subscribe(client, nullptr, ("s/" + index).c_str(), 0);
    mosquitto_subscribe(client, nullptr, ("d/" + index).c_str(), 0);
}

void onSubscribe(mosquitto*, void* object, int mid, int, const int*) {
    if (mid == 2) ++static_cast<Receiver*>(object)->board->ready();
}

}  // namespace

int runMosquittoReceivers(const std::string& board_file, std::size_t count, std::uint16_t port) {
    Board board(board_file, count, false);
    mosquitto_lib_init();
    const int epoll = ::epoll_create1(0);
    std::vector<Receiver> receivers(count);
    for (std::size_t i = 0; i < count; ++i) {
        auto& receiver = receivers[i];
        receiver.board = &board;
        receiver.index = i;
        receiver.client = mosquitto_new(nullptr, true, &receiver);
        mosquitto_int_option(receiver.client, MOSQ_OPT_TCP_NODELAY, 1);
        mosquitto_message_callback_set(receiver.client, onMessage);
        mosquitto_connect_callback_set(receiver.client, onConnect);
        mosquitto_subscribe_callback_set(receiver.client, onSubscribe);
        check(mosquitto_connect(receiver.client, "127.0.0.1", port, 600), "mosquitto_connect");
        epoll_event wish{};
        wish.events = EPOLLIN;
        wish.data.ptr = &receiver;
        ::epoll_ctl(epoll, EPOLL_CTL_ADD, mosquitto_socket(receiver.client), &wish);
    }
    const auto parent = ::getppid();
    std::array<epoll_event, 256> events{};
    while (::getppid() == parent) {
        const int ready = ::epoll_wait(epoll, events.data(), events.size(), 500);
        for (int i = 0; i < ready; ++i) {
            auto& receiver = *static_cast<Receiver*>(events[static_cast<std::size_t>(i)].data.ptr);
            mosquitto_loop_read(receiver.client, 1);
            while (mosquitto_want_write(receiver.client)) mosquitto_loop_write(receiver.client, 1);
        }
    }
    return 0;
}

struct MosquittoSender::State {
    mosquitto* client = nullptr;
};

MosquittoSender::MosquittoSender(std::uint16_t port) : state_(std::make_unique<State>()) {
    mosquitto_lib_init();
    state_->client = mosquitto_new(nullptr, true, nullptr);
    mosquitto_int_option(state_->client, MOSQ_OPT_TCP_NODELAY, 1);
    check(mosquitto_connect(state_->client, "127.0.0.1", port, 600), "mosquitto_connect");
    check(mosquitto_loop_start(state_->client), "mosquitto_loop_start");
}

MosquittoSender::~MosquittoSender() {
    mosquitto_disconnect(state_->client);
    mosquitto_loop_stop(state_->client, true);
    mosquitto_destroy(state_->client);
}

void MosquittoSender::send(std::size_t receiver, bool stop, const std::string& bytes) {
    const auto topic = (stop ? "s/" : "d/") + std::to_string(receiver);
    check(mosquitto_publish(state_->client, nullptr, topic.c_str(), static_cast<int>(bytes.size()), bytes.data(), 0, false),
          "mosquitto_publish");
}

}  // namespace axon::bench
