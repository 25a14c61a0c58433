// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/communicator.hpp"

#include <Glacier2/Router.h>
#include <axon/commutil.h>
#include <pthread.h>
#include <sched.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <stdexcept>

#include "transport/ice/broken_protocol.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/ice/tls.hpp"

namespace axon::transport {
namespace {

/// What a router says of every exception of the servers behind it.
constexpr const char* kRouterWithoutServer = "internal server error";

Refusal noServerBehind() {
    return {RefusalCode::Unavailable,
            "the router answers, but no server behind it does; fix: start axon-server with the endpoints for "
            "routers that the router's configuration names (Glacier2.SessionManager, "
            "Glacier2.PermissionsVerifier)",
            {}};
}

}  // namespace

bool isWithoutServer(const std::exception_ptr& error) {
    try {
        std::rethrow_exception(error);
    } catch (const Glacier2::PermissionDeniedException& denied) {
        return denied.reason == kRouterWithoutServer;
    } catch (const Glacier2::CannotCreateSessionException& cannot) {
        return cannot.reason == kRouterWithoutServer;
    } catch (...) {
        return false;
    }
}

void requestRealTime(int priority) {
    sched_param parameters{};
    parameters.sched_priority = priority;
    // Threads that this one starts are ordinary ones, unless they ask for themselves.
    const int error = ::sched_setscheduler(0, SCHED_RR | SCHED_RESET_ON_FORK, &parameters) == 0 ? 0 : errno;
    static std::atomic<bool> said{false};  // a process has many such threads; its operator is told once
    if (error != 0 && !said.exchange(true)) {
        // The client library has a logger of its own; standard output is its program's.
        const auto logger = spdlog::get("axon");
        (logger ? logger : spdlog::default_logger())
            ->info(
                "signal lane: real-time scheduling is not permitted, so ordinary threads are used and stops "
                "are slower under full load; fix: LimitRTPRIO=30 in the systemd unit, or 'ulimit -r 30'");
    }
}

Ice::CommunicatorHolder makeCommunicator(const CommunicatorSettings& settings) {
    Ice::InitializationData init;
    init.properties = Ice::createProperties();
    const std::map<std::string, std::string> defaults = {
        {"Ice.MessageSizeMax",
         std::to_string(settings.lane == Lane::Signal ? kSignalSizeMaxKib : kMessageSizeMaxKib)},
        {"Ice.RetryIntervals", "-1"},
        {"Ice.IPv6", "0"},
        {"Ice.Warn.Connections", "0"},
        {"Ice.Warn.Dispatch", "0"},
        {"Ice.Default.InvocationTimeout", "5000"},  // twoway calls; oneway proxies have none
        // The client side keeps idle connections alive, the server side closes what is silent: half-open
        // ones.
        {"Ice.ACM.Timeout", "60"},
        {"Ice.ACM.Client.Close", "0"},
        {"Ice.ACM.Client.Heartbeat", "3"},
        {"Ice.ACM.Server.Close", "4"},
        {"Ice.ACM.Server.Heartbeat", "0"},
        {"Ice.ThreadPool.Server.Size", std::to_string(settings.server_threads)},
        {"Ice.ThreadPool.Server.Serialize", settings.server_threads > 1 ? "1" : "0"},
        {"Ice.ThreadPool.Client.Size", std::to_string(settings.client_threads)},
        {"Ice.ThreadPool.Client.Serialize", settings.client_threads > 1 ? "1" : "0"},
    };
    for (const auto& [key, value] : defaults) init.properties->setProperty(key, value);
    for (const auto& [key, value] : settings.properties) init.properties->setProperty(key, value);
    const bool tls = speaksTls(settings.properties);
    if (tls) prepareTls(init, settings.properties);
    prepareBrokenProtocol(init);

    // Ice runs the hook in each thread that it starts for this communicator.
    init.threadStart = [name = settings.name.substr(0, 15), lane = settings.lane,
                        priority = settings.priority] {
        pthread_setname_np(pthread_self(), name.c_str());
        if (lane == Lane::Signal) requestRealTime(priority);
    };
    try {
        Ice::CommunicatorHolder holder(init);
        if (tls) checkServers(holder.communicator());
        return holder;
    } catch (const Ice::PluginInitializationException& error) {
        throw std::runtime_error(
            "TLS cannot be used: " + error.reason +
            "; expected the files of IceSSL.CertFile, IceSSL.KeyFile and IceSSL.CAs in IceSSL.DefaultDir; "
            "fix: make them with axon certs issue, and check them with axon certs show FILE");
    } catch (const Ice::Exception& error) {
        throw std::runtime_error(std::string("Ice does not accept its properties: ") + error.what());
    }
}

bool callsBack(const Ice::ObjectPrx& given, const Ice::Current& current) {
    if (!given.ice_getAdapterId().empty()) return false;
    if (!current.con || given.ice_getEndpoints().empty()) return true;
    const auto from = DirectConnection::remoteAddressOf(*current.con);
    const auto endpoints = given.ice_getEndpoints();
    return !from.empty() && std::all_of(endpoints.begin(), endpoints.end(), [&](const auto& endpoint) {
        for (auto layer = endpoint->getInfo(); layer; layer = layer->underlying)
            if (const auto ip = std::dynamic_pointer_cast<Ice::IPEndpointInfo>(layer))
                return ip->host == from;
        return false;
    });
}

Refusal translate(std::exception_ptr error, bool setting_up_tls) {
    if (auto refusal = tlsRefusal(error, setting_up_tls)) return std::move(*refusal);
    if (isWithoutServer(error)) return noServerBehind();
    try {
        std::rethrow_exception(std::move(error));
    } catch (const Axon::CommUtil::RequestRefused& refused) {
        return {static_cast<RefusalCode>(refused.code), refused.reason, {}};
    } catch (const Glacier2::PermissionDeniedException& denied) {
        return {RefusalCode::PermissionDenied,
                denied.reason.empty() ? "the router refuses this user; fix: check user name and password"
                                      : denied.reason,
                {}};
    } catch (const Glacier2::CannotCreateSessionException& cannot) {
        return {RefusalCode::Unavailable, "the router answers, but opens no session: " + cannot.reason, {}};
    } catch (const Glacier2::SessionNotExistException&) {
        return {RefusalCode::NotConnected, "the session has ended; fix: connect again", {}};
    } catch (const Ice::TimeoutException&) {
        return {RefusalCode::TimedOut,
                "the other side did not answer in time; it may be overloaded or stopped",
                {}};
    } catch (const Ice::MemoryLimitException&) {
        return {RefusalCode::TooLarge,
                "the message is larger than " + std::to_string(kMessageSizeMaxKib) +
                    " KiB (on a signal lane " + std::to_string(kSignalSizeMaxKib) +
                    "); fix: send it in chunks",
                {}};
    } catch (const Ice::ConnectFailedException&) {
        return {RefusalCode::NotConnected,
                "nothing listens there; fix: start axon-server (or the router), or correct the port",
                {}};
    } catch (const Ice::DNSException& unknown) {
        return {RefusalCode::NotConnected,
                "the host " + unknown.host + " is not known; fix: correct the address",
                {}};
    } catch (const Ice::ObjectNotExistException&) {
        return {RefusalCode::NotConnected, "the session has ended; fix: connect again", {}};
    } catch (const Ice::ConnectionManuallyClosedException&) {
        return {RefusalCode::NotConnected, "the connection was closed", {}};
    } catch (const Ice::SocketException&) {
        return {RefusalCode::NotConnected, "the connection was lost; fix: connect again", {}};
    } catch (const Ice::CloseConnectionException&) {
        return {RefusalCode::NotConnected, "the other side closed the connection", {}};
    } catch (const Ice::ProtocolException& protocol) {
        return {RefusalCode::Malformed, std::string("not understood as Ice: ") + protocol.ice_id(), {}};
    } catch (const Ice::CommunicatorDestroyedException&) {
        return {RefusalCode::NotConnected, "this program is shutting down", {}};
    } catch (const Ice::Exception& other) {
        return {RefusalCode::Internal, other.what(), {}};
    } catch (const std::exception& other) {
        return {RefusalCode::Internal, other.what(), {}};
    }
}

std::string tcpEndpoint(const std::string& host_and_port) {
    return parseEndpoint(host_and_port).text();
}

}  // namespace axon::transport
