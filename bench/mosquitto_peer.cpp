// SPDX-License-Identifier: GPL-2.0-or-later
#include "mosquitto_peer.hpp"

#include <mosquitto.h>
#include <poll.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <array>
#include <fstream>
#include <stdexcept>
#include <vector>

#include "board.hpp"
#include "child.hpp"
#include "tcp.hpp"

namespace axon::bench {

namespace {

struct Receiver {
    Board* board = nullptr;
    std::size_t index = 0, topic = 0;
    int qos = 0;
    mosquitto* client = nullptr;
};

/// Nobody writes a PINGREQ here: the connection must outlast every run.
constexpr int kKeepAlive_s = 65535;
/// More than any batch: what bounds a message in flight is the socket.
constexpr int kUnbounded = 65535;

void check(int code, const char* what) {
    if (code != MOSQ_ERR_SUCCESS)
        throw std::runtime_error(std::string(what) + ": " + mosquitto_strerror(code));
}

void onMessage(mosquitto*, void* object, const mosquitto_message* message) {
    const auto now = nowNs();
    auto& receiver = *static_cast<Receiver*>(object);
    auto& slot = (*receiver.board)[receiver.index];
    const auto kind = message->topic[0] == 's' ? Kind::Stop : Kind::Data;  // "s/17" or "d/17"
    slot.arrived(kind, now, static_cast<const char*>(message->payload),
                 static_cast<std::size_t>(message->payloadlen));
}

void onConnect(mosquitto* client, void* object, int) {
    const auto& receiver = *static_cast<Receiver*>(object);
    const auto topic = std::to_string(receiver.topic);
    mosquitto_subscribe(client, nullptr, ("s/" + topic).c_str(), receiver.qos);
    mosquitto_subscribe(client, nullptr, ("d/" + topic).c_str(), receiver.qos);
}

void onSubscribe(mosquitto*, void* object, int mid, int, const int*) {
    if (mid == 2) ++static_cast<Receiver*>(object)->board->ready();
}

}  // namespace

int runMosquittoReceivers(const std::string& board_file, std::size_t count, std::uint16_t port, int qos,
                          std::size_t first) {
    Board board(board_file, count, false);
    mosquitto_lib_init();
    const int epoll = ::epoll_create1(0);
    std::vector<Receiver> receivers(count);
    for (std::size_t i = 0; i < count; ++i) {
        auto& receiver = receivers[i];
        receiver.board = &board;
        receiver.index = i;
        receiver.topic = first + i;
        receiver.qos = qos;
        receiver.client = mosquitto_new(nullptr, true, &receiver);
        mosquitto_int_option(receiver.client, MOSQ_OPT_TCP_NODELAY, 1);
        mosquitto_message_callback_set(receiver.client, onMessage);
        mosquitto_connect_callback_set(receiver.client, onConnect);
        mosquitto_subscribe_callback_set(receiver.client, onSubscribe);
        check(mosquitto_connect(receiver.client, "127.0.0.1", port, kKeepAlive_s), "mosquitto_connect");
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

MosquittoBroker::MosquittoBroker(const std::filesystem::path& folder, bool bounded)
    : port_(freePort()),
      child_(
          [this, &folder, bounded] {
              std::ofstream(folder / "mosquitto.conf")
                  << "listener " << port_
                  << " 127.0.0.1\nallow_anonymous true\nset_tcp_nodelay true\n"
                  // As another user it would outlive us: who changes it is no longer told that its parent
                  // dies.
                  << (::geteuid() == 0 ? "user root\n" : "") << (bounded ? "" : "max_queued_messages 0\n")
                  << "max_inflight_messages 0\npersistence false\n";
              return std::vector<std::string>{findProgram("mosquitto"), "-c",
                                              (folder / "mosquitto.conf").string()};
          }(),
          folder / "mosquitto.log") {
    child_.waitUntil([this] { return tcp::listens(port_); }, "mosquitto did not start",
                     std::chrono::seconds{10});
}

MosquittoSender::MosquittoSender(std::uint16_t port, int qos) : qos_(qos) {
    mosquitto_lib_init();
    client_ = mosquitto_new(nullptr, true, nullptr);
    mosquitto_int_option(client_, MOSQ_OPT_TCP_NODELAY, 1);
    mosquitto_int_option(client_, MOSQ_OPT_SEND_MAXIMUM, kUnbounded);
    check(mosquitto_connect(client_, "127.0.0.1", port, kKeepAlive_s), "mosquitto_connect");
    if (qos_ > 0) check(mosquitto_loop_start(client_), "mosquitto_loop_start");
}

MosquittoSender::~MosquittoSender() {
    mosquitto_disconnect(client_);
    mosquitto_loop_stop(client_, true);
    mosquitto_destroy(client_);
}

void MosquittoSender::send(std::size_t receiver, Kind kind, const std::string& bytes) {
    const auto topic = (kind == Kind::Stop ? "s/" : "d/") + std::to_string(receiver);
    check(mosquitto_publish(client_, nullptr, topic.c_str(), static_cast<int>(bytes.size()), bytes.data(),
                            qos_, false),
          "mosquitto_publish");
    // Without the library's thread it has written by itself what the socket took.
    while (qos_ == 0 && mosquitto_want_write(client_) && !interrupted) {
        pollfd wish{mosquitto_socket(client_), POLLOUT, 0};
        ::poll(&wish, 1, 100);
        check(mosquitto_loop_write(client_, 1), "mosquitto_loop_write");
    }
}

namespace {

class MosquittoSubject final : public Subject {
  public:
    MosquittoSubject(const std::filesystem::path& folder, std::size_t n, int qos)
        : board_((folder / "board").string(), n, true),
          broker_(folder, false),
          receivers_(
              ourselves("mosquitto-receivers", {(folder / "board").string(), std::to_string(n),
                                                std::to_string(broker_.port()), std::to_string(qos), "0"}),
              folder / "receivers.log") {
        receivers_.waitUntil([this] { return board_.ready() >= board_.size(); },
                             "mosquitto's receivers did not start", std::chrono::seconds{60});
        sender_ = std::make_unique<MosquittoSender>(broker_.port(), qos);
    }
    Board& board() override { return board_; }
    std::string ended() const override {
        return whichHasEnded({{"mosquitto", &broker_.process()}, {"its receivers' process", &receivers_}});
    }
    void send(Message message, const std::string& bytes, std::vector<std::int64_t>& called) override {
        for (std::size_t i = 0; i < board_.size(); ++i) {
            called[i] = nowNs();
            sender_->send(i, kindOf(message), bytes);
        }
    }

  private:
    Board board_;
    MosquittoBroker broker_;
    Child receivers_;
    std::unique_ptr<MosquittoSender> sender_;
};

}  // namespace

std::unique_ptr<Subject> startMosquitto(const std::filesystem::path& folder, std::size_t n, int qos) {
    return std::make_unique<MosquittoSubject>(folder, n, qos);
}

}  // namespace axon::bench
