// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/http_server.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/tcp.h>
#include <microhttpd.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <strings.h>
#include <sys/socket.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "common/descriptor.hpp"
#include "console/core/deadlines.hpp"
#include "host/wake_up.hpp"

namespace axon::console {
namespace {

constexpr std::size_t kMemoryOfOne = 16 * 1024;  // of a connection: its request and the header of its answer
constexpr unsigned kSilenceSeconds = 20;         // of libmicrohttpd; Deadlines has ended most before
constexpr int kBacklog = 64;
constexpr std::chrono::milliseconds kLongest{60'000};

[[noreturn]] void fail(const std::string& what) {
    throw std::runtime_error("the console " + what);
}

/// One request and its answer.
struct Exchange {
    Exchange(MHD_Connection* its, std::shared_ptr<const WakeUp> its_waker)
        : waker(std::move(its_waker)), connection(its) {}

    const std::shared_ptr<const WakeUp> waker;

    Request request;
    bool asked = false;

    std::mutex mutex;
    // Guarded by mutex:
    MHD_Connection* connection;  // null when it has ended
    std::optional<Answer> answer;
    bool suspended = false;

    /// Any thread.
    void settle(Answer its) {
        const std::lock_guard lock(mutex);
        answer = std::move(its);
        resume();
    }
    void resume() {
        if (!suspended || connection == nullptr) return;
        suspended = false;
        MHD_resume_connection(connection);
        waker->wake();  // libmicrohttpd wakes only threads of its own
    }
};

using ExchangePtr = std::shared_ptr<Exchange>;

/// Of a header that is there several times, all values.
std::string header(MHD_Connection* connection, const char* name, const char* between = ", ") {
    struct Wanted {
        const char* name;
        const char* between;
        bool there = false;
        std::string value;
    } its{name, between};
    MHD_get_connection_values(
        connection, MHD_HEADER_KIND,
        [](void* cls, MHD_ValueKind, const char* key, const char* value) {
            auto& wanted = *static_cast<Wanted*>(cls);
            if (strcasecmp(key, wanted.name) != 0) return MHD_YES;
            if (std::exchange(wanted.there, true)) wanted.value += wanted.between;
            if (value != nullptr) wanted.value += value;
            return MHD_YES;
        },
        &its);
    return std::move(its.value);
}

bool has(MHD_Connection* connection, const char* name) {
    return MHD_lookup_connection_value(connection, MHD_HEADER_KIND, name) != nullptr;
}

std::string endOf(int fd, int (*ask)(int, sockaddr*, socklen_t*)) {
    sockaddr_in its{};
    socklen_t size = sizeof its;
    if (ask(fd, reinterpret_cast<sockaddr*>(&its), &size) != 0 || its.sin_family != AF_INET) return {};
    char text[INET_ADDRSTRLEN] = {};
    inet_ntop(AF_INET, &its.sin_addr, text, sizeof text);
    return text + (":" + std::to_string(ntohs(its.sin_port)));
}

std::uint32_t addressOf(const sockaddr* its, socklen_t size) {
    if (its == nullptr || size < static_cast<socklen_t>(sizeof(sockaddr_in)) || its->sa_family != AF_INET)
        return 0;
    return ntohl(reinterpret_cast<const sockaddr_in*>(its)->sin_addr.s_addr);
}

std::string textOf(const sockaddr* its, socklen_t size) {
    if (addressOf(its, size) == 0) return "an unknown address";
    const auto& end = *reinterpret_cast<const sockaddr_in*>(its);
    char text[INET_ADDRSTRLEN] = {};
    inet_ntop(AF_INET, &end.sin_addr, text, sizeof text);
    return text + (":" + std::to_string(ntohs(end.sin_port)));
}

int descriptorOf(MHD_Connection* connection) {
    const auto* info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    return info == nullptr ? -1 : info->connect_fd;
}

MHD_Result send(MHD_Connection* connection, const Answer& answer) {
    using Body = std::shared_ptr<const std::string>;
    MHD_Response* response = nullptr;
    if (answer.body) {
        auto* const kept = new Body(answer.body);
        response = MHD_create_response_from_buffer_with_free_callback_cls(
            (*kept)->size(), const_cast<char*>((*kept)->data()),
            [](void* its) { delete static_cast<Body*>(its); }, kept);
        if (response == nullptr) delete kept;
    } else {
        response = MHD_create_response_from_buffer(0, nullptr, MHD_RESPMEM_PERSISTENT);
    }
    if (response == nullptr) return MHD_NO;
    for (const auto& [name, value] : answer.headers)
        MHD_add_response_header(response, name.c_str(), value.c_str());
    const auto queued = MHD_queue_response(connection, static_cast<unsigned>(answer.status), response);
    MHD_destroy_response(response);
    return queued;
}

}  // namespace

struct HttpServer::Parts {
    explicit Parts(Settings its) : settings(std::move(its)) {
        sockaddr_in address{};
        address.sin_family = AF_INET;
        address.sin_port = htons(settings.port);
        const auto host = settings.host == "localhost" ? std::string("127.0.0.1") : settings.host;
        if (inet_pton(AF_INET, host.c_str(), &address.sin_addr) != 1)
            fail("cannot listen on '" + settings.host +
                 "': expected an address of four numbers, such as 127.0.0.1");
        listener = Descriptor(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
        const int on = 1;
        if (listener.get() >= 0) ::setsockopt(listener.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
        if (listener.get() < 0 ||
            ::bind(listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
            ::listen(listener.get(), kBacklog) != 0)
            fail(
                "cannot listen on " + settings.host + ":" + std::to_string(settings.port) + " (" +
                std::generic_category().message(errno) +
                "): another program may have this port, perhaps an axon-server that is already running; fix: "
                "choose another port with --console-endpoint, or 0 for a free one, or leave the console out "
                "with --no-console");
        const auto end = endOf(listener.get(), ::getsockname);
        port = static_cast<std::uint16_t>(std::stoul(end.substr(end.rfind(':') + 1)));
    }

    ~Parts() {
        stopping = true;
        waker->wake();
        if (thread.joinable()) thread.join();
        if (daemon == nullptr) return;
        // libmicrohttpd cannot end while connections are suspended; handle() gives them up.
        for (const auto& exchange : waiting) {
            const std::lock_guard lock(exchange->mutex);
            exchange->resume();
        }
        MHD_run(daemon);
        MHD_stop_daemon(daemon);
    }

    void serve(ConsoleCore& its_core, const Clock& its_clock) {
        core = &its_core;
        clock = &its_clock;
        deadlines.emplace(its_clock);
        unsigned flags = MHD_USE_EPOLL | MHD_ALLOW_SUSPEND_RESUME;
        std::vector<MHD_OptionItem> options{
            {MHD_OPTION_LISTEN_SOCKET, listener.get(), nullptr},
            {MHD_OPTION_CONNECTION_LIMIT, settings.connections_max, nullptr},
            {MHD_OPTION_CONNECTION_MEMORY_LIMIT, kMemoryOfOne, nullptr},
            {MHD_OPTION_CONNECTION_TIMEOUT, kSilenceSeconds, nullptr},
            {MHD_OPTION_STRICT_FOR_CLIENT, 1, nullptr},
            {MHD_OPTION_SIGPIPE_HANDLED_BY_APP, 1, nullptr},
            {MHD_OPTION_NOTIFY_CONNECTION, reinterpret_cast<intptr_t>(&connectionChanged), this},
            {MHD_OPTION_NOTIFY_COMPLETED, reinterpret_cast<intptr_t>(&requestEnded), this},
        };
        if (!settings.certificate.empty()) {
            flags |= MHD_USE_TLS;
            const char* versions = settings.tls_1_2 ? "NORMAL:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2"
                                                    : "NORMAL:-VERS-ALL:+VERS-TLS1.3";
            const auto add = [&](MHD_OPTION option, const char* text) {
                options.push_back({option, 0, const_cast<char*>(text)});
            };
            add(MHD_OPTION_HTTPS_MEM_CERT, settings.certificate.c_str());
            add(MHD_OPTION_HTTPS_MEM_KEY, settings.key.c_str());
            if (!settings.key_password.empty())
                add(MHD_OPTION_HTTPS_KEY_PASSWORD, settings.key_password.c_str());
            add(MHD_OPTION_HTTPS_PRIORITIES, versions);
        }
        options.push_back({MHD_OPTION_END, 0, nullptr});
        daemon = MHD_start_daemon(flags, 0, &mayConnect, this, &handle, this, MHD_OPTION_ARRAY,
                                  options.data(), MHD_OPTION_END);
        if (daemon == nullptr)
            fail(settings.certificate.empty()
                     ? "cannot be served: no descriptors or no memory are left"
                     : "cannot use its certificate: expected the files of IceSSL.CertFile and IceSSL.KeyFile "
                       "in PEM; fix: make them with axon certs issue --server HOST");
        [[maybe_unused]] const int owned = listener.release();  // MHD_stop_daemon closes it
        const auto* info = MHD_get_daemon_info(daemon, MHD_DAEMON_INFO_EPOLL_FD);
        if (info == nullptr) fail("cannot be served: libmicrohttpd has no epoll");
        epoll = info->epoll_fd;
        thread = std::thread([this] {
            pthread_setname_np(pthread_self(), "axon-console");
            run();
        });
    }

    void run() {
        while (!stopping) {
            pollfd both[] = {{epoll, POLLIN, 0}, {waker->fd(), POLLIN, 0}};
            auto wait = kLongest;
            if (const auto next = deadlines->next(); next != TimePoint::max())
                wait = std::clamp(std::chrono::ceil<std::chrono::milliseconds>(clock->realTimeUntil(next)),
                                  std::chrono::milliseconds{0}, kLongest);
            if (MHD_UNSIGNED_LONG_LONG due = 0; MHD_get_timeout(daemon, &due) == MHD_YES)
                wait = std::min<std::chrono::milliseconds>(
                    wait, std::chrono::milliseconds{std::min<MHD_UNSIGNED_LONG_LONG>(due, 60'000)});
            ::poll(both, 2, static_cast<int>(wait.count()));
            waker->drain();
            MHD_run(daemon);
            // Read by libmicrohttpd as the peer's end.
            for (const int late : deadlines->late()) {
                if (silent.erase(late) > 0)
                    core->turnAway(endOf(late, ::getpeername), RefusalCode::TimedOut,
                                   "no request of it was complete in " +
                                       std::to_string(Deadlines::kRequest.count()) + " s");
                ::shutdown(late, SHUT_RDWR);
            }
        }
    }

    unsigned mostOf(std::uint32_t address) const {
        const bool proxy = settings.connections_of_proxy_max != 0 && (address >> 24U) == 127;
        return proxy ? settings.connections_of_proxy_max : settings.connections_of_one_max;
    }

    static MHD_Result mayConnect(void* cls, const sockaddr* peer, socklen_t size) {
        const auto& parts = *static_cast<const Parts*>(cls);
        const auto address = addressOf(peer, size);
        const auto found = parts.connections.find(address);
        const auto most = parts.mostOf(address);
        if (found == parts.connections.end() || found->second < most) return MHD_YES;
        parts.core->turnAway(textOf(peer, size), RefusalCode::Overloaded,
                             "more than " + std::to_string(most) + " of one address");
        return MHD_NO;
    }

    /// A connection ends that has not sent a complete request. One that has said something is told:
    /// libmicrohttpd tells nobody what it does not understand, and its peer may be the first to leave.
    void endOfSilent(MHD_Connection* connection, int fd) const {
        tcp_info its{};
        socklen_t size = sizeof its;
        // A FIN counts as a byte, so who sends only one is not told from who only leaves.
        if (::getsockopt(fd, IPPROTO_TCP, TCP_INFO, &its, &size) != 0 || its.tcpi_bytes_received <= 1) return;
        const auto* info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
        core->turnAway(
            info == nullptr ? "an unknown address" : textOf(info->client_addr, sizeof(sockaddr_in)),
            RefusalCode::Malformed,
            settings.certificate.empty() ? "what it sent is no complete request of HTTP"
                                         : "what it sent is no TLS, or no complete request of HTTP");
    }

    static std::uint32_t peerOf(MHD_Connection* connection) {
        const auto* info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
        return info == nullptr ? 0 : addressOf(info->client_addr, sizeof(sockaddr_in));
    }

    static void connectionChanged(void* cls, MHD_Connection* connection, void** its,
                                  MHD_ConnectionNotificationCode what) {
        auto& parts = *static_cast<Parts*>(cls);
        if (what == MHD_CONNECTION_NOTIFY_STARTED) {
            const int fd = descriptorOf(connection);
            *its = reinterpret_cast<void*>(static_cast<intptr_t>(fd));
            parts.deadlines->opened(fd);
            parts.silent.insert(fd);
            ++parts.connections[peerOf(connection)];
        } else {
            if (const auto its_peer = parts.connections.find(peerOf(connection));
                its_peer != parts.connections.end() && --its_peer->second == 0)
                parts.connections.erase(its_peer);
            const int fd = static_cast<int>(reinterpret_cast<intptr_t>(*its));
            if (parts.silent.erase(fd) > 0 && !parts.stopping) parts.endOfSilent(connection, fd);
            parts.deadlines->closed(fd);
        }
    }

    static void requestEnded(void* cls, MHD_Connection* connection, void** its, MHD_RequestTerminationCode) {
        auto& parts = *static_cast<Parts*>(cls);
        auto* const held = static_cast<ExchangePtr*>(*its);
        if (held == nullptr) return;
        {
            const std::lock_guard lock((*held)->mutex);
            (*held)->connection = nullptr;
        }
        parts.waiting.erase(*held);
        delete held;
        *its = nullptr;
        parts.deadlines->answered(descriptorOf(connection));
    }

    static MHD_Result handle(void* cls, MHD_Connection* connection, const char* url, const char* method,
                             const char*, const char* upload, size_t* upload_size, void** its) {
        auto& parts = *static_cast<Parts*>(cls);
        if (parts.stopping) return MHD_NO;
        if (*its == nullptr) {
            auto exchange = std::make_shared<Exchange>(connection, parts.waker);
            exchange->request.method = method;
            exchange->request.path = url;
            *its = new ExchangePtr(std::move(exchange));
            if (has(connection, MHD_HTTP_HEADER_TRANSFER_ENCODING) &&
                has(connection, MHD_HTTP_HEADER_CONTENT_LENGTH))
                return send(connection, {400, {{"Connection", "close"}}, nullptr});
            return MHD_YES;
        }
        const ExchangePtr exchange = *static_cast<ExchangePtr*>(*its);
        auto& request = exchange->request;
        if (*upload_size != 0) {
            if (request.body.size() + *upload_size > ConsoleCore::kBodyMax) {
                request.too_large = true;
                request.body.clear();
            } else if (!request.too_large) {
                request.body.append(upload, *upload_size);
            }
            *upload_size = 0;
            return MHD_YES;
        }
        if (!exchange->asked) {
            exchange->asked = true;
            parts.ask(connection, exchange);
        }
        const std::lock_guard lock(exchange->mutex);
        if (exchange->answer) {
            parts.waiting.erase(exchange);
            return send(connection, *exchange->answer);
        }
        exchange->suspended = true;
        parts.waiting.insert(exchange);
        MHD_suspend_connection(connection);
        return MHD_YES;
    }

    void ask(MHD_Connection* connection, const ExchangePtr& exchange) {
        auto& request = exchange->request;
        const int fd = descriptorOf(connection);
        deadlines->asked(fd);
        silent.erase(fd);
        request.host = header(connection, MHD_HTTP_HEADER_HOST);
        request.origin = header(connection, MHD_HTTP_HEADER_ORIGIN);
        request.cookie = header(connection, MHD_HTTP_HEADER_COOKIE, "; ");
        request.content_type = header(connection, MHD_HTTP_HEADER_CONTENT_TYPE);
        request.accept_encoding = header(connection, MHD_HTTP_HEADER_ACCEPT_ENCODING);
        request.if_none_match = header(connection, MHD_HTTP_HEADER_IF_NONE_MATCH);
        request.forwarded_for = header(connection, "X-Forwarded-For");
        request.peer = endOf(fd, ::getpeername);
        request.local = endOf(fd, ::getsockname);
        core->handle(std::move(request), [exchange](Answer answer) { exchange->settle(std::move(answer)); });
    }

    const Settings settings;
    Descriptor listener;
    std::uint16_t port = 0;
    ConsoleCore* core = nullptr;
    const Clock* clock = nullptr;
    MHD_Daemon* daemon = nullptr;
    int epoll = -1;
    const std::shared_ptr<const WakeUp> waker = std::make_shared<const WakeUp>();
    std::atomic<bool> stopping{false};
    // Of its thread only:
    std::optional<Deadlines> deadlines;
    std::set<ExchangePtr> waiting;
    std::set<int> silent;                           // connections that have not sent a complete request yet
    std::map<std::uint32_t, unsigned> connections;  // of each address
    std::thread thread;
};

HttpServer::HttpServer(Settings settings) : parts_(std::make_unique<Parts>(std::move(settings))) {}

HttpServer::~HttpServer() = default;

std::uint16_t HttpServer::port() const {
    return parts_->port;
}

void HttpServer::serve(ConsoleCore& core, const Clock& clock) {
    parts_->serve(core, clock);
}

}  // namespace axon::console
