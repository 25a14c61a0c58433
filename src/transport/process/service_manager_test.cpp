// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/service_manager.hpp"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "common/descriptor.hpp"

namespace axon::transport {
namespace {

/// What listens as systemd does.
class ServiceManager {
  public:
    explicit ServiceManager(const std::string& name) {
        sockaddr_un address{};
        address.sun_family = AF_UNIX;
        name.copy(address.sun_path, sizeof address.sun_path - 1);
        if (name.front() == '@') address.sun_path[0] = '\0';
        const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + name.size());
        EXPECT_EQ(::bind(socket_.get(), reinterpret_cast<const sockaddr*>(&address), size), 0);
        ::setenv("NOTIFY_SOCKET", name.c_str(), 1);
    }
    ~ServiceManager() { ::unsetenv("NOTIFY_SOCKET"); }
    ServiceManager(const ServiceManager&) = delete;
    ServiceManager& operator=(const ServiceManager&) = delete;

    std::string told() const {
        std::array<char, 64> text{};
        const auto size = ::recv(socket_.get(), text.data(), text.size(), MSG_DONTWAIT);
        return size < 0 ? "nothing" : std::string(text.data(), static_cast<std::size_t>(size));
    }

  private:
    Descriptor socket_{::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0)};
};

TEST(ServiceManager, IsToldOverASocketInTheFileSystem) {
    auto folder = (std::filesystem::temp_directory_path() / "axon-notify-XXXXXX").string();
    ASSERT_NE(::mkdtemp(folder.data()), nullptr);
    {
        const ServiceManager manager(folder + "/notify");
        EXPECT_EQ(manager.told(), "nothing");
        tellServiceManagerReady();
        EXPECT_EQ(manager.told(), "READY=1");
    }
    std::filesystem::remove_all(folder);
}

TEST(ServiceManager, IsToldOverAnAbstractSocket) {
    const ServiceManager manager("@axon-notify-" + std::to_string(::getpid()));
    tellServiceManagerReady();
    EXPECT_EQ(manager.told(), "READY=1");
}

TEST(ServiceManager, ThatCannotBeReachedEndsNothing) {
    ::setenv("NOTIFY_SOCKET", "/nowhere/axon/notify", 1);
    tellServiceManagerReady();
    ::setenv("NOTIFY_SOCKET", std::string(200, 'x').c_str(), 1);
    tellServiceManagerReady();
    ::unsetenv("NOTIFY_SOCKET");
    tellServiceManagerReady();
}

}  // namespace
}  // namespace axon::transport
