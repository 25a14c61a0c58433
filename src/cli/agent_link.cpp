// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/agent_link.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <functional>

#include "cli/words.hpp"

namespace axon::cli {

std::filesystem::path runtimeDirectory() {
    const char* base = std::getenv("XDG_RUNTIME_DIR");
    if (base != nullptr && *base == '/') return std::filesystem::path(base) / "axon";
    return "/tmp/axon-" + std::to_string(::getuid());
}

Refusal checkRuntimeDirectory(const std::filesystem::path& directory, bool& exists) {
    struct stat found {};
    exists = ::lstat(directory.c_str(), &found) == 0;
    if (!exists) return {};
    const auto path = directory.string();
    if (!S_ISDIR(found.st_mode)) {
        return {RefusalCode::PermissionDenied,
                "expected a directory at " + path + ", found something else: remove it",
                {}};
    }
    if (found.st_uid != ::getuid()) {
        return {
            RefusalCode::PermissionDenied,
            path + " belongs to another user: remove it, or set XDG_RUNTIME_DIR to a directory of your own",
            {}};
    }
    if ((found.st_mode & 0777U) != 0700U) {
        return {RefusalCode::PermissionDenied, "other users can enter " + path + ": chmod 700 " + path, {}};
    }
    return {};
}

Result<AgentPlace> agentPlace(const std::string& server) {
    const auto directory = runtimeDirectory();
    if (::mkdir(directory.c_str(), 0700) != 0 && errno != EEXIST) {
        return Refusal{RefusalCode::PermissionDenied,
                       "cannot create " + directory.string() + " (" + std::strerror(errno) +
                           "): set XDG_RUNTIME_DIR to a directory of your own",
                       {}};
    }
    bool exists = false;
    if (auto refusal = checkRuntimeDirectory(directory, exists); !refusal.ok()) return refusal;
    std::string name = "agent-";
    for (const char c : server)
        name += std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '.' || c == '-' ? c : '_';
    // sun_path holds 108 bytes.
    if (directory.string().size() + name.size() > 95)
        name = "agent-" + std::to_string(std::hash<std::string>{}(server));
    return AgentPlace{directory, directory / (name + ".sock"), directory / (name + ".lock"),
                      directory / (name + ".log")};
}

bool sendLine(int fd, const Json& json) {
    const auto text = line(json) + "\n";
    std::size_t sent = 0;
    while (sent < text.size()) {
        const auto count = ::send(fd, text.data() + sent, text.size() - sent, MSG_NOSIGNAL);
        if (count < 0 && errno == EINTR) continue;
        if (count <= 0) return false;
        sent += static_cast<std::size_t>(count);
    }
    return true;
}

bool LineReader::feed(const char* bytes, std::size_t count) {
    buffer_.append(bytes, count);
    return buffer_.size() <= kLongestLine || buffer_.find('\n') != std::string::npos;
}

std::optional<std::string> LineReader::next() {
    const auto end = buffer_.find('\n');
    if (end == std::string::npos) return std::nullopt;
    auto text = buffer_.substr(0, end);
    buffer_.erase(0, end + 1);
    return text;
}

std::optional<AgentLink> AgentLink::open(const std::filesystem::path& socket) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const auto path = socket.string();
    if (path.size() >= sizeof address.sun_path) return std::nullopt;
    std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
    Descriptor fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    if (!fd.open() || ::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
        return std::nullopt;
    ucred peer{};
    socklen_t size = sizeof peer;
    if (::getsockopt(fd.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0 || peer.uid != ::getuid())
        return std::nullopt;
    return AgentLink(std::move(fd));
}

AgentLink::Outcome AgentLink::request(const std::string& verb, const Json& args, Events& events,
                                      std::chrono::milliseconds accepted_within) {
    if (!sendLine(fd_.get(), {{"verb", verb}, {"args", args}})) return {Ending::NoAnswer};
    const auto deadline = std::chrono::steady_clock::now() + accepted_within;
    bool accepted = false;
    while (true) {
        while (const auto text = reader_.next()) {
            const auto event = Json::parse(*text, nullptr, false);
            if (!event.is_object()) return {Ending::Broken};
            accepted = true;
            if (event.contains("event")) {  // whatever its other members are called
                events.emit(event);
                continue;
            }
            if (event.value("elsewhere", false)) return {Ending::Elsewhere};
            if (event.value("done", false))
                return {Ending::Done, event.value("exit", static_cast<int>(kRefused))};
        }
        int wait_ms = -1;
        if (!accepted) {
            const auto left =
                std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
            if (left.count() <= 0) return {Ending::NoAnswer};
            wait_ms = static_cast<int>(left.count());
        }
        pollfd watched{fd_.get(), POLLIN, 0};
        if (::poll(&watched, 1, wait_ms) <= 0) continue;
        char bytes[16384];
        const auto count = ::recv(fd_.get(), bytes, sizeof bytes, 0);
        if (count < 0 && errno == EINTR) continue;
        if (count <= 0) return {accepted ? Ending::Broken : Ending::NoAnswer};
        if (!reader_.feed(bytes, static_cast<std::size_t>(count))) return {Ending::Broken};
    }
}

int AgentLink::process() const {
    ucred peer{};
    socklen_t size = sizeof peer;
    return ::getsockopt(fd_.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0 ? peer.pid : 0;
}

void AgentLink::interrupt() const {
    sendLine(fd_.get(), {{"interrupt", true}});
}

}  // namespace axon::cli
