// SPDX-License-Identifier: GPL-2.0-or-later
#include "nats_peer.hpp"

#include <charconv>
#include <stdexcept>

#include "child.hpp"

namespace axon::bench {

namespace {

constexpr const char* kConnect =
    "CONNECT "
    "{\"verbose\":false,\"pedantic\":false,\"lang\":\"c++\",\"version\":\"1\",\"name\":\"axon-bench\"}\r\n";
constexpr std::string_view kEndOfLine = "\r\n";

/// The last word of "MSG SUBJECT SID SIZE".
std::size_t sizeIn(std::string_view line) {
    std::size_t size = 0;
    const auto word = line.substr(line.rfind(' ') + 1);
    if (std::from_chars(word.data(), word.data() + word.size(), size).ec != std::errc{})
        throw std::runtime_error("nats-server says: " + std::string(line));
    return size;
}

/// What is neither a message nor a question is passed over; an error is thrown.
void takeLine(const tcp::Connection& connection, std::string_view line) {
    if (line == "PING") connection.write({"PONG\r\n"});
    if (line.substr(0, 4) == "-ERR") throw std::runtime_error("nats-server says: " + std::string(line));
}

}  // namespace

std::string NatsReceiver::hello(std::size_t index) const {
    const auto name = std::to_string(index);
    return kConnect + ("SUB s." + name + " 1\r\nSUB d." + name + " 2\r\nPING\r\n");
}

std::size_t NatsReceiver::consume(const tcp::Connection& connection, std::string_view received,
                                  std::int64_t when, Slot& slot, const std::function<void()>& ready) const {
    std::size_t used = 0;
    for (;;) {
        const auto left = received.substr(used);
        const auto end = left.find(kEndOfLine);
        if (end == std::string_view::npos) return used;
        const auto line = left.substr(0, end);
        auto whole = end + kEndOfLine.size();
        if (line.substr(0, 4) == "MSG ") {
            const auto size = sizeIn(line);
            if (left.size() < whole + size + kEndOfLine.size()) return used;
            slot.arrived(line[4] == 's' ? Kind::Stop : Kind::Data, when, left.data() + whole, size);
            whole += size + kEndOfLine.size();
        } else if (line == "PONG") {
            ready();
        } else {
            takeLine(connection, line);
        }
        used += whole;
    }
}

namespace {

class NatsSubject final : public Subject {
  public:
    NatsSubject(const std::filesystem::path& folder, std::size_t n)
        : board_((folder / "board").string(), n, true),
          port_(freePort()),
          server_({findProgram("nats-server"), "-a", "127.0.0.1", "-p", std::to_string(port_)},
                  folder / "nats.log") {
        server_.waitUntil([this] { return tcp::listens(port_); }, "nats-server did not start",
                          std::chrono::seconds{10});
        receivers_ = std::make_unique<Child>(
            ourselves("nats-receivers",
                      {(folder / "board").string(), std::to_string(n), std::to_string(port_)}),
            folder / "receivers.log");
        receivers_->waitUntil([this] { return board_.ready() >= board_.size(); },
                              "the receivers of NATS did not start", std::chrono::seconds{60});
        sender_ = std::make_unique<tcp::Connection>(port_);
        sender_->write({kConnect});
    }
    Board& board() override { return board_; }
    std::string ended() const override {
        return whichHasEnded({{"nats-server", &server_}, {"its receivers' process", receivers_.get()}});
    }
    void send(Message message, const std::string& bytes, std::vector<std::int64_t>& called) override {
        inbox_.take(*sender_, buffer_, [this](std::string_view received) {
            std::size_t used = 0;
            for (auto end = received.find(kEndOfLine); end != std::string_view::npos;
                 end = received.find(kEndOfLine, used)) {
                takeLine(*sender_, received.substr(used, end - used));
                used = end + kEndOfLine.size();
            }
            return used;
        });
        const auto size = " " + std::to_string(bytes.size()) + "\r\n";
        for (std::size_t i = 0; i < board_.size(); ++i) {
            called[i] = nowNs();
            sender_->write({(message == Message::Stop ? "PUB s." : "PUB d.") + std::to_string(i) + size,
                            bytes, kEndOfLine});
        }
    }

  private:
    Board board_;
    std::uint16_t port_;
    Child server_;
    std::unique_ptr<Child> receivers_;
    std::unique_ptr<tcp::Connection> sender_;
    tcp::Inbox inbox_;
    std::vector<char> buffer_ = std::vector<char>(64 * 1024);
};

}  // namespace

std::unique_ptr<Subject> startNats(const std::filesystem::path& folder, std::size_t n) {
    return std::make_unique<NatsSubject>(folder, n);
}

}  // namespace axon::bench
