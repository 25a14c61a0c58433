// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/agent.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <vector>

#include "cli/words.hpp"

namespace axon::cli {

struct Agent::Connection final : Events {
    explicit Connection(Descriptor descriptor) : fd(std::move(descriptor)) {}

    void emit(const Json& event) override {
        if (!broken && !sendLine(fd.get(), event)) {
            broken = true;
            mailbox->interrupt();
        }
    }

    Descriptor fd;
    LineReader reader;
    std::string verb;
    std::shared_ptr<Mailbox> mailbox;  // set while a verb runs
    std::thread thread;
    bool gone = false;                // the peer: serve()'s thread
    std::atomic<bool> broken{false};  // the way to the peer
    std::atomic<bool> finished{false};
};

Agent::Agent(Descriptor listening, Perform perform, Holds holds, std::chrono::milliseconds linger)
    : perform_(std::move(perform)),
      holds_(std::move(holds)),
      linger_(linger),
      listening_(std::move(listening)) {}

Agent::~Agent() {
    for (auto& connection : connections_) {
        if (!connection->thread.joinable()) continue;
        connection->mailbox->interrupt();
        connection->thread.join();
    }
}

void Agent::wake() const {
    woken_.wake();
}

void Agent::stop() {
    stopping_ = true;
    wake();
}

void Agent::adopt(Descriptor descriptor) {
    const timeval patience{5, 0};
    ::setsockopt(descriptor.get(), SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
    connections_.push_back(std::make_unique<Connection>(std::move(descriptor)));
}

void Agent::serve() {
    auto last_needed = std::chrono::steady_clock::now();
    while (!stopping_) {
        reap();
        if (look_) {
            look_(std::any_of(connections_.begin(), connections_.end(),
                              [](const auto& connection) { return connection->thread.joinable(); }));
        }
        if (!connections_.empty() || holds_()) {
            last_needed = std::chrono::steady_clock::now();
        } else if (end_when_alone_ || std::chrono::steady_clock::now() - last_needed >= linger_) {
            break;
        }
        if (connections_.empty() && holds_()) end_when_alone_ = false;

        std::vector<pollfd> watched{{woken_.fd(), POLLIN, 0}};
        if (listening_.open() && connections_.size() < kMostConnections)
            watched.push_back({listening_.get(), POLLIN, 0});
        const auto first = watched.size();
        std::vector<Connection*> order;
        for (auto& connection : connections_) {
            if (connection->gone) continue;
            watched.push_back({connection->fd.get(), POLLIN, 0});
            order.push_back(connection.get());
        }
        // A second is how late a lease that was lost is noticed for the purpose of ending.
        if (::poll(watched.data(), watched.size(), 1000) <= 0) continue;
        if ((watched[0].revents & POLLIN) != 0) woken_.drain();
        if (first == 2 && (watched[1].revents & POLLIN) != 0) {
            Descriptor accepted(::accept4(listening_.get(), nullptr, nullptr, SOCK_CLOEXEC));
            ucred peer{};
            socklen_t size = sizeof peer;
            if (accepted.open() && ::getsockopt(accepted.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0 &&
                peer.uid == ::getuid()) {
                adopt(std::move(accepted));
            }
        }
        for (std::size_t i = 0; i < order.size(); ++i) {
            if (watched[first + i].revents != 0) read(*order[i]);
        }
    }
    for (auto& connection : connections_) {
        if (connection->thread.joinable()) connection->mailbox->interrupt();
    }
    for (auto& connection : connections_) {
        if (connection->thread.joinable()) connection->thread.join();
    }
    connections_.clear();
}

void Agent::reap() {
    for (auto at = connections_.begin(); at != connections_.end();) {
        auto& connection = **at;
        if (connection.finished) {
            connection.thread.join();
            if (connection.verb == "checkout" || connection.verb == "release") end_when_alone_ = !holds_();
        }
        const bool over = connection.finished || (connection.gone && !connection.thread.joinable());
        at = over ? connections_.erase(at) : std::next(at);
    }
}

void Agent::read(Connection& connection) {
    char bytes[16384];
    const auto count = ::recv(connection.fd.get(), bytes, sizeof bytes, MSG_DONTWAIT);
    if (count < 0 && (errno == EINTR || errno == EAGAIN)) return;
    if (count <= 0 || !connection.reader.feed(bytes, static_cast<std::size_t>(count))) {
        connection.gone = true;
        if (connection.mailbox) connection.mailbox->interrupt();
        return;
    }
    while (const auto text = connection.reader.next()) take(connection, *text);
}

void Agent::take(Connection& connection, const std::string& text) {
    const auto request = Json::parse(text, nullptr, false);
    if (request.is_object() && request.value("interrupt", Json(false)) == true) {
        if (connection.mailbox) connection.mailbox->interrupt();
        return;
    }
    const bool sensible = request.is_object() && request.contains("verb") && request["verb"].is_string() &&
                          request.contains("args") && request["args"].is_object();
    if (!sensible || connection.mailbox) {
        sendLine(connection.fd.get(),
                 usageEvent("the agent expects one request on a connection, as a line of JSON"));
        connection.gone = true;
        if (connection.mailbox) connection.mailbox->interrupt();
        return;
    }
    connection.verb = request["verb"];
    connection.mailbox = std::make_shared<Mailbox>();
    connection.emit({{"accepted", true}});
    connection.thread = std::thread([this, &connection, args = request["args"]] {
        std::optional<int> exit = kRefused;
        try {
            exit = perform_({connection.verb, args, connection, connection.mailbox});
        } catch (const nlohmann::json::exception& malformed) {
            // Arguments that another program made up; the command's own come from its parser.
            connection.emit(
                usageEvent(std::string("the arguments do not have the expected form: ") + malformed.what()));
            exit = kUsage;
        }
        connection.emit(exit ? Json{{"done", true}, {"exit", *exit}} : Json{{"elsewhere", true}});
        connection.finished = true;
        wake();
    });
}

Result<Descriptor> listenAt(const std::filesystem::path& socket) {
    const auto failed = [&](const char* what) {
        return Refusal{RefusalCode::PermissionDenied,
                       std::string("cannot ") + what + " " + socket.string() + ": " + std::strerror(errno),
                       {}};
    };
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const auto path = socket.string();
    if (path.size() >= sizeof address.sun_path) {
        errno = ENAMETOOLONG;
        return failed("listen at");
    }
    std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
    ::unlink(path.c_str());
    Descriptor fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    if (!fd.open()) return failed("create a socket for");
    // The directory is 0700 already; the mode of the socket says the same to who looks.
    const auto mask = ::umask(0177);
    const int bound = ::bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address);
    ::umask(mask);
    if (bound != 0) return failed("bind");
    if (::listen(fd.get(), 16) != 0) return failed("listen at");
    return fd;
}

}  // namespace axon::cli
