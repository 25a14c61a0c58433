// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/picture_server.hpp"

#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <list>
#include <mutex>
#include <thread>

#include "lab/acts_server.hpp"
#include "lab/sockets.hpp"

namespace axon::lab {
namespace {

using Bytes = std::vector<std::uint8_t>;
using Kind = PictureRequest::Kind;

constexpr std::size_t kLongestRequest = 8192;
constexpr std::size_t kMostConnections = 64;
constexpr std::string_view kBoundary = "axon-lab-picture";

constexpr std::string_view kCameraPage =
    "<!doctype html><title>Camera</title><body style='margin:0;background:#222'><img src='/stream' "
    "style='width:100%'>";
constexpr std::string_view kOverviewPage =
    "<!doctype html><title>Virtual laboratory</title><body style='margin:0;background:#222'><img "
    "src='/overview/stream' style='width:100%'>";

void append(Bytes& to, std::string_view text) {
    to.insert(to.end(), text.begin(), text.end());
}

Bytes answer(std::string_view status, std::string_view type, std::span<const std::uint8_t> body) {
    Bytes bytes;
    append(bytes,
           fmt::format("HTTP/1.1 {}\r\nContent-Type: {}\r\nContent-Length: {}\r\nCache-Control: no-store\r\n"
                       "Connection: close\r\n\r\n",
                       status, type, body.size()));
    bytes.insert(bytes.end(), body.begin(), body.end());
    return bytes;
}
Bytes answer(std::string_view status, std::string_view type, std::string_view body) {
    return answer(status, type, Bytes(body.begin(), body.end()));
}
Bytes streamHead(std::string_view type) {
    Bytes bytes;
    append(bytes, fmt::format("HTTP/1.1 200 OK\r\nContent-Type: {}\r\nCache-Control: no-store\r\n"
                              "Connection: close\r\n\r\n",
                              type));
    return bytes;
}

}  // namespace

std::optional<PictureRequest> parsePictureRequest(std::string_view bytes, bool overview) {
    if (bytes.find("\r\n\r\n") == std::string_view::npos && bytes.find("\n\n") == std::string_view::npos) {
        if (bytes.size() > kLongestRequest) return PictureRequest{Kind::NotAllowed};
        return std::nullopt;
    }
    const auto line = bytes.substr(0, bytes.find_first_of("\r\n"));
    if (!line.starts_with("GET ")) return PictureRequest{Kind::NotAllowed};
    auto path = line.substr(4, line.find(' ', 4) - 4);
    path = path.substr(0, path.find('?'));
    if (path == "/") return PictureRequest{Kind::Page};
    if (overview) {
        if (path == "/overview/stream") return PictureRequest{Kind::Stream};
        if (path == "/overview.png") return PictureRequest{Kind::Png};
        if (path == "/overview.jpg") return PictureRequest{Kind::Jpeg};
    } else {
        if (path == "/stream") return PictureRequest{Kind::Stream};
        if (path == "/frame.jpg") return PictureRequest{Kind::Jpeg};
        if (path == "/raw") return PictureRequest{Kind::Raw};
    }
    return PictureRequest{Kind::NotFound};
}

class PictureServer::Loop {
  public:
    Loop(const std::string& address, const Ports& ports) : wake_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
        if (!wake_.open()) failWithErrno("eventfd");
        for (std::size_t i = 0; i < ports.cameras.size(); ++i)
            listeners_.push_back({listenOn(address, ports.cameras[i]), i, false});
        for (std::size_t i = 0; i < ports.acts.size(); ++i)
            listeners_.push_back({listenOn(address, ports.acts[i]), i, true});
        overview_ = ports.cameras.size();
        if (ports.overview) listeners_.push_back({listenOn(address, *ports.overview), overview_, false});
        latest_.resize(overview_ + 1);
    }
    ~Loop() { stop(); }

    Ports ports() const {
        Ports ports;
        for (const auto& listener : listeners_) {
            const int port = portOf(listener.socket);
            if (listener.acts)
                ports.acts.push_back(port);
            else if (listener.view == overview_)
                ports.overview = port;
            else
                ports.cameras.push_back(port);
        }
        return ports;
    }

    void start(Cameras& cameras) {
        cameras_ = &cameras;
        thread_ = std::thread([this] { run(); });
    }
    void stop() {
        if (!thread_.joinable()) return;
        {
            const std::lock_guard lock(mutex_);
            ending_ = true;
        }
        wake();
        thread_.join();
    }

    void newPicture(std::size_t view, SharedPicture picture) {
        {
            const std::lock_guard lock(mutex_);
            latest_[view] = std::move(picture);
        }
        wake();
    }

  private:
    struct Listener {
        Descriptor socket;
        std::size_t view;
        bool acts;
    };
    struct Connection {
        Descriptor socket;
        std::size_t view = 0;
        std::optional<ActsServer> acts;
        std::string request;
        std::optional<Kind> wants;  // what it waits for
        bool watching = false;      // counted as a watcher
        bool closing = false;       // when all is sent
        bool broken = false;
        Bytes out;
        std::size_t sent = 0;

        bool idle() const { return sent == out.size(); }
        void say(Bytes bytes) {
            if (idle()) out.clear(), sent = 0;
            out.insert(out.end(), bytes.begin(), bytes.end());
        }
    };
    /// One picture in all the forms that somebody wanted, made once.
    struct Forms {
        SharedPicture picture;
        Bytes jpeg, png, ppm;
        const Bytes& as(Kind kind) {
            auto& form = kind == Kind::Raw ? ppm : kind == Kind::Png ? png : jpeg;
            if (form.empty())
                form = kind == Kind::Raw   ? encodePpm(*picture)
                       : kind == Kind::Png ? encodePng(*picture)
                                           : encodeJpeg(*picture);
            return form;
        }
    };

    void wake() {
        const std::uint64_t one = 1;
        [[maybe_unused]] const auto written = ::write(wake_.get(), &one, sizeof one);
    }

    void run() {
        std::vector<pollfd> watched;
        while (true) {
            watched.assign(1, {wake_.get(), POLLIN, 0});
            for (const auto& listener : listeners_) watched.push_back({listener.socket.get(), POLLIN, 0});
            for (const auto& c : connections_)
                watched.push_back({c.socket.get(), static_cast<short>(POLLIN | (c.idle() ? 0 : POLLOUT)), 0});
            ::poll(watched.data(), watched.size(), -1);
            std::vector<SharedPicture> pictures;
            {
                std::uint64_t ignored = 0;
                [[maybe_unused]] const auto got = ::read(wake_.get(), &ignored, sizeof ignored);
                const std::lock_guard lock(mutex_);
                if (ending_) return;
                pictures = std::exchange(latest_, std::vector<SharedPicture>(latest_.size()));
            }
            std::size_t at = 1 + listeners_.size();
            for (auto& c : connections_) {
                if ((watched[at].revents & (POLLIN | POLLERR | POLLHUP)) != 0) read(c);
                ++at;
            }
            for (std::size_t view = 0; view < pictures.size(); ++view) {
                if (pictures[view]) show(view, pictures[view]);
            }
            for (auto& c : connections_) write(c);
            connections_.remove_if([this](Connection& c) {
                if (!c.broken && !(c.closing && c.idle())) return false;
                if (c.watching) cameras_->watch(c.view, false);
                return true;
            });
            for (std::size_t i = 0; i < listeners_.size(); ++i) {
                if (watched[1 + i].revents != 0) accept(listeners_[i]);
            }
        }
    }

    void accept(const Listener& listener) {
        auto socket = acceptFrom(listener.socket);
        if (!socket.open() || connections_.size() >= kMostConnections) return;
        auto& c = connections_.emplace_back();
        c.socket = std::move(socket);
        c.view = listener.view;
        if (listener.acts) {
            c.acts.emplace();
            watch(c);
        }
    }

    void watch(Connection& c) {
        c.watching = true;
        cameras_->watch(c.view, true);
    }

    void read(Connection& c) {
        std::array<std::uint8_t, 4096> chunk;
        const auto got = ::recv(c.socket.get(), chunk.data(), chunk.size(), 0);
        if (got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR)) {
            c.broken = true;
            return;
        }
        if (got < 0) return;
        const auto bytes = std::span(chunk).first(static_cast<std::size_t>(got));
        if (c.acts) {
            c.say(c.acts->receive(bytes));
            c.closing = c.acts->quit();
        } else if (!c.wants && !c.closing) {
            c.request.append(bytes.begin(), bytes.end());
            if (const auto request = parsePictureRequest(c.request, c.view == overview_))
                begin(c, request->kind);
        }
    }

    void begin(Connection& c, Kind kind) {
        const auto failure = cameras_->failure();
        if (failure && kind != Kind::NotFound && kind != Kind::NotAllowed) {
            c.say(answer("503 Service Unavailable", "text/plain", *failure + "\n"));
            c.closing = true;
            return;
        }
        const bool overview = c.view == overview_;
        switch (kind) {
            case Kind::Stream:
                c.say(streamHead(fmt::format("multipart/x-mixed-replace; boundary={}", kBoundary)));
                break;
            case Kind::Raw:
                c.say(streamHead("application/octet-stream"));
                break;
            case Kind::Jpeg:
            case Kind::Png:
                break;
            case Kind::Page:
                c.say(answer("200 OK", "text/html", overview ? kOverviewPage : kCameraPage));
                c.closing = true;
                return;
            case Kind::NotFound:
                c.say(answer("404 Not Found", "text/plain",
                             overview ? "expected /overview/stream, /overview.png or /overview.jpg\n"
                                      : "expected /stream, /frame.jpg or /raw\n"));
                c.closing = true;
                return;
            case Kind::NotAllowed:
                c.say(answer("400 Bad Request", "text/plain", "expected GET and a path\n"));
                c.closing = true;
                return;
        }
        c.wants = kind;
        if (kind == Kind::Stream || kind == Kind::Raw)
            watch(c);
        else
            cameras_->wantOne(c.view);
    }

    void show(std::size_t view, const SharedPicture& picture) {
        Forms forms{picture, {}, {}, {}};
        for (auto& c : connections_) {
            if (c.view != view || c.closing) continue;
            if (c.acts) {
                c.say(c.acts->newPicture(picture));
                continue;
            }
            if (!c.wants) continue;
            const auto& form = forms.as(*c.wants);
            switch (*c.wants) {
                case Kind::Stream:
                    if (!c.idle()) break;  // slow reader: this one is left out
                    {
                        Bytes part;
                        append(part,
                               fmt::format("--{}\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n",
                                           kBoundary, form.size()));
                        part.insert(part.end(), form.begin(), form.end());
                        append(part, "\r\n");
                        c.say(std::move(part));
                    }
                    break;
                case Kind::Raw:
                    if (c.idle()) c.say(form);
                    break;
                default:
                    c.say(answer("200 OK", *c.wants == Kind::Png ? "image/png" : "image/jpeg", form));
                    c.closing = true;
            }
        }
    }

    static void write(Connection& c) {
        while (!c.idle()) {
            const auto sent = ::send(c.socket.get(), c.out.data() + c.sent, c.out.size() - c.sent,
                                     MSG_NOSIGNAL | MSG_DONTWAIT);
            if (sent <= 0) {
                if (sent < 0 && errno != EAGAIN && errno != EINTR) c.broken = true;
                return;
            }
            c.sent += static_cast<std::size_t>(sent);
        }
    }

    // Constant once started.
    Descriptor wake_;
    std::vector<Listener> listeners_;
    std::size_t overview_ = 0;
    Cameras* cameras_ = nullptr;

    std::list<Connection> connections_;  // of the thread

    std::mutex mutex_;
    std::vector<SharedPicture> latest_;  // guarded by mutex_
    bool ending_ = false;                // guarded by mutex_
    std::thread thread_;
};

PictureServer::PictureServer(const std::string& address, const Ports& ports)
    : loop_(std::make_unique<Loop>(address, ports)) {}
PictureServer::~PictureServer() = default;
PictureServer::Ports PictureServer::ports() const {
    return loop_->ports();
}
void PictureServer::start(Cameras& cameras) {
    loop_->start(cameras);
}
void PictureServer::stop() {
    loop_->stop();
}
void PictureServer::newPicture(std::size_t view, SharedPicture picture) {
    loop_->newPicture(view, std::move(picture));
}

}  // namespace axon::lab
