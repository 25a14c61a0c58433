// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/sites.hpp"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <stdexcept>

namespace axon::console {
namespace {

constexpr std::string_view kHttp = "http://";
constexpr std::string_view kHttps = "https://";
// A proxy tells the two lanes apart by them.
constexpr const char* kResource = "/axon";
constexpr const char* kSignalResource = "/axon-signal";

struct Authority {
    std::string host;
    std::uint16_t port;
};

std::string lower(std::string_view text) {
    std::string out(text);
    std::transform(out.begin(), out.end(), out.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    return out;
}

bool isHostName(std::string_view name) {
    return !name.empty() && name.size() <= 253 && std::isalnum(static_cast<unsigned char>(name.front())) &&
           std::all_of(name.begin(), name.end(), [](unsigned char c) {
               return std::isalnum(c) != 0 || c == '.' || c == '-' || c == '_';
           });
}

/// HOST or HOST:PORT, an address of IPv6 excepted: there is no listener for one.
std::optional<Authority> authorityOf(std::string_view text, bool tls) {
    const auto colon = text.find(':');
    const auto host = text.substr(0, colon);
    if (!isHostName(host)) return std::nullopt;
    unsigned port = tls ? 443 : 80;
    if (colon != std::string_view::npos) {
        const auto digits = text.substr(colon + 1);
        const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), port);
        if (error != std::errc{} || end != digits.data() + digits.size() || port == 0 || port > 65535)
            return std::nullopt;
    }
    return Authority{lower(host), static_cast<std::uint16_t>(port)};
}

/// As a browser writes it: without the port that the scheme implies.
std::string written(const Authority& its, bool tls) {
    return its.port == (tls ? 443 : 80) ? its.host : its.host + ":" + std::to_string(its.port);
}

std::string socketOf(const Authority& its, bool tls) {
    return (tls ? "wss://" : "ws://") + written(its, tls);
}

std::string endpointOf(const Authority& its, bool tls, const char* resource) {
    return std::string(tls ? "wss" : "ws") + " -h " + its.host + " -p " + std::to_string(its.port) + " -r " +
           resource;
}

Site siteOf(const Authority& pages, std::uint16_t session_port, std::uint16_t signal_port, bool tls) {
    const Authority sessions{pages.host, session_port}, signals{pages.host, signal_port};
    Site site;
    site.origin = std::string(tls ? kHttps : kHttp) + written(pages, tls);
    site.socket = socketOf(sessions, tls);
    site.endpoint = endpointOf(sessions, tls, kResource);
    site.signal_socket = socketOf(signals, tls);
    site.signal_endpoint = endpointOf(signals, tls, kSignalResource);
    site.secure = tls;
    return site;
}

}  // namespace

bool isOfThisMachine(std::string_view address) {
    return address.starts_with("127.");
}

Sites::Sites(const Settings& settings)
    : tls_(settings.tls),
      port_(settings.port),
      session_port_(settings.session_port),
      signal_port_(settings.signal_port) {
    for (const auto& name : settings.names) {
        if (!isHostName(name))
            throw std::invalid_argument("'" + name +
                                        "': expected the name of a host without a port, such as lab.example");
        names_.push_back(lower(name));
    }
    for (const auto& origin : settings.proxies) {
        const bool tls = origin.starts_with(kHttps);
        const auto rest = std::string_view(origin).substr(tls                         ? kHttps.size()
                                                          : origin.starts_with(kHttp) ? kHttp.size()
                                                                                      : origin.size());
        const auto its = authorityOf(rest, tls);
        if (!its)
            throw std::invalid_argument("'" + origin +
                                        "': expected the address that a browser calls, without a path, such "
                                        "as https://lab.example or https://lab.example:8443");
        auto& added =
            proxies_.emplace_back(Proxy{written(*its, tls), siteOf(*its, its->port, its->port, tls)});
        added.site.proxy = true;
    }
}

std::optional<Site> Sites::direct(std::string_view host, std::string_view local) const {
    const auto its = authorityOf(host, tls_);
    if (!its || its->port != port_) return std::nullopt;
    const bool ours = its->host == local || (its->host == "localhost" && isOfThisMachine(local)) ||
                      std::find(names_.begin(), names_.end(), its->host) != names_.end();
    if (!ours) return std::nullopt;
    return siteOf(*its, session_port_, signal_port_, tls_);
}

std::optional<Site> Sites::ofHost(std::string_view host, std::string_view local) const {
    for (const auto& proxy : proxies_) {
        const auto its = authorityOf(host, proxy.site.secure);
        if (its && written(*its, proxy.site.secure) == proxy.authority) return proxy.site;
    }
    return direct(host, local);
}

std::optional<Site> Sites::ofOrigin(std::string_view origin, std::string_view local) const {
    const auto its = lower(origin);
    for (const auto& proxy : proxies_)
        if (its == proxy.site.origin) return proxy.site;
    const auto scheme = tls_ ? kHttps : kHttp;
    if (!its.starts_with(scheme)) return std::nullopt;
    auto site = direct(std::string_view(its).substr(scheme.size()), local);
    if (site && site->origin != its) site.reset();
    return site;
}

Site Sites::ofAddress(const std::string& local) const {
    return siteOf({local, port_}, session_port_, signal_port_, tls_);
}

}  // namespace axon::console
