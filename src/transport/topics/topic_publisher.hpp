// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/result.hpp"
#include "common/snapshot.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/link_trust.hpp"
#include "transport/outbox/forward.hpp"
#include "transport/outbox/proxy_sender.hpp"

namespace axon::transport {

/// Where one of several servers publishes to: the topic, on a connection for each lane, and each neighbour
/// straight, on one for each lane, too: for signals besides the topic and first, for messages that are for it
/// alone instead of the topic. All that is sent is oneway and asynchronous, behind an Outbox for each of
/// them, so that nobody who does not read holds up anybody.
///
/// States: nowhere ─ publishTo() ► there ─ publishTo({}) ► nowhere; the neighbours come and go by reach(),
/// which leaves alone what leads where it led, for messages may wait there. A connection that failed stays
/// closed until reopen(), which the owner calls now and then. Threads: any; sending reads immutable lists, of
/// which each lane has its own.
///
/// Over TLS a place is not there before its connection has been opened and the server at its other end has
/// shown the certificate of its kind and name; all messages go over that very connection. Until then, and
/// while it is opened again after a loss, messages go the other way where there is one, and are lost
/// otherwise, as while the topic is down.
template <class Prx>
class TopicPublisher {
  public:
    /// A connection to `signals`, where that neighbour said that it takes signals, was refused. Any thread.
    using Refused = std::function<void(const std::string& server, const std::string& signals)>;

    /// `data`, `signal`: of their connections; null where nothing will be published. `who` is for the log.
    /// What `refused` uses outlives both communicators.
    /// `links`: of a server whose links are under TLS, and `neighbours` is the kind of the servers; null: the
    /// links are plain.
    TopicPublisher(std::shared_ptr<Ice::Communicator> data, std::shared_ptr<Ice::Communicator> signal,
                   std::string who, Refused refused, LinkTrust* links = nullptr,
                   certificates::Kind neighbours = certificates::Kind::Server)
        : data_communicator_(std::move(data)),
          signal_communicator_(std::move(signal)),
          who_(std::move(who)),
          refused_(std::move(refused)),
          links_(links),
          neighbours_(neighbours) {}

    /// The publishers of the topic, or its subscribers themselves, as stringified proxies; none: it is down.
    /// Over TLS it waits for the connections, two seconds at most, so that what is published next finds the
    /// topic.
    void publishTo(const std::vector<std::string>& proxies) {
        Places places;
        for (const auto& proxy : proxies) places.push_back({{}, proxy});
        Opening opening;
        Lines complaints;
        {
            const std::lock_guard lock(changes_);
            store(data_, routes(*data_communicator_, places, "axon-topic", {}, {}, complaints));
            store(signal_, routes(*signal_communicator_, places, "axon-topic-signal",
                                  OutboxLimits::ofSignals(), {}, complaints));
            opening = toOpen({&data_, &signal_});
        }
        warn(complaints);
        const auto deadline = std::chrono::steady_clock::now() + kPatience;
        for (const auto& opened : open(opening)) opened.wait_until(deadline);
    }
    void reach(const std::vector<ServerAnnouncement>& neighbours) {
        Places signals;
        Places messages;
        for (const auto& neighbour : neighbours) {
            signals.push_back({neighbour.name, neighbour.signals});
            if (!neighbour.messages.empty()) messages.push_back({neighbour.name, neighbour.messages});
        }
        Opening opening;
        Lines complaints;
        {
            const std::lock_guard lock(changes_);
            store(direct_, routes(*signal_communicator_, signals, "axon-direct", OutboxLimits::ofSignals(),
                                  *direct_.load(), complaints));
            store(direct_data_, routes(*data_communicator_, messages, "axon-direct-data", {},
                                       *direct_data_.load(), complaints));
            opening = toOpen({&direct_, &direct_data_});
        }
        warn(complaints);
        open(opening);
    }
    /// Gives those whose connection failed another one.
    void reopen() {
        Opening opening;
        {
            const std::lock_guard lock(changes_);
            for (auto* list : {&data_, &signal_, &direct_, &direct_data_}) {
                auto all = *list->load();
                bool changed = false;
                for (auto& route : all) {
                    if (route.sender == nullptr || !route.sender->closed()) continue;
                    try {
                        route.sender = links_ != nullptr ? nullptr : sender(route.proxy, limitsOf(*list));
                    } catch (const Ice::CommunicatorDestroyedException&) {  // the server is ending
                        return;
                    }
                    changed = true;
                }
                if (changed) store(*list, std::move(all));
            }
            if (links_ != nullptr) opening = toOpen({&data_, &signal_, &direct_, &direct_data_});
        }
        open(opening);
    }

    /// Before anything is announced: where this server takes signals and messages directly, as stringified
    /// proxies.
    void setDirect(std::string signals, std::string messages) {
        own_signals_ = std::move(signals);
        own_messages_ = std::move(messages);
    }
    ice::ServerAnnouncement announcement(const ServerAnnouncement& self) const {
        auto announced = toIce(self);
        announced.signals = own_signals_;
        announced.messages = own_messages_;
        return announced;
    }
    /// What an announcement says, of about so many bytes: to all, by the topic; on the signal lane, as a
    /// heartbeat, straight to each neighbour. Whose connection failed gets another one first.
    template <class Call>
    void announce(Lane lane, std::size_t bytes, const Call& call) {
        reopen();
        if (lane == Lane::Signal) return beat(call);
        toAll(Traffic::Control, bytes, call);
    }

    /// Over the topic. Arguments, here and below, and result are those of ProxySender::send.
    template <class... Arguments>
    bool toAll(Arguments&&... arguments) const {
        const auto routes = data_.load();  // held, because another thread may store a new one
        bool taken = true;
        for (const auto& route : *routes)
            if (route.sender) taken = route.sender->send(arguments...) && taken;
        return taken;
    }
    /// On the signal lane: to each neighbour, then over the topic.
    template <class... Arguments>
    void signalToAll(Arguments&&... arguments) const {
        toNeighbours(Lane::Signal, arguments...);
        const auto routes = signal_.load();  // held, because another thread may store a new one
        for (const auto& route : *routes)
            if (route.sender) route.sender->send(arguments...);
    }
    /// To each neighbour, straight.
    template <class... Arguments>
    void toNeighbours(Lane lane, Arguments&&... arguments) const {
        const auto routes = directRoutes(lane);
        for (const auto& route : *routes)
            if (route.sender) route.sender->send(arguments...);
    }
    /// To this server alone: straight, or by the topic while it is not reached.
    template <class... Arguments>
    bool toOne(const std::string& server, Arguments&&... arguments) const {
        const auto taken = toNeighbour(Lane::Data, server, arguments...);
        return taken ? *taken : toAll(arguments...);
    }
    /// To this neighbour, straight. Nothing where it is not reached.
    template <class... Arguments>
    std::optional<bool> toNeighbour(Lane lane, const std::string& server, Arguments&&... arguments) const {
        const auto routes = directRoutes(lane);
        const auto found = std::find_if(routes->begin(), routes->end(),
                                        [&](const Route& route) { return route.place.server == server; });
        if (found == routes->end() || !found->sender) return std::nullopt;
        return found->sender->send(std::forward<Arguments>(arguments)...);
    }

  private:
    struct Place {
        std::string server;  // empty: the topic
        std::string proxy;
        bool operator==(const Place&) const = default;
    };
    using Places = std::vector<Place>;
    /// To open a connection over TLS. Guarded by changes_.
    struct Attempt {
        bool runs = false;
        std::chrono::steady_clock::time_point not_before;
        std::string complaint;  // the last one
    };
    struct Route {
        Place place;
        std::shared_ptr<Prx> proxy;
        std::shared_ptr<const ProxySender<Prx>> sender;  // null: over TLS, not opened yet
        /// Null over plain TCP.
        std::shared_ptr<Attempt> attempt;
    };
    using Routes = std::vector<Route>;
    struct ToOpen {
        Snapshot<Routes>* list;
        Route route;
    };
    using Opening = std::vector<ToOpen>;
    using Lines = std::vector<std::string>;
    static constexpr std::chrono::seconds kPatience{2};
    static constexpr std::chrono::seconds kTryAgain{1};

    /// Tells each neighbour that this server lives. Over plain TCP Ice opens a closed connection again for
    /// that, and learns whether it is refused; over TLS unreached() does.
    template <class Call>
    void beat(const Call& call) const {
        const auto routes = directRoutes(Lane::Signal);
        for (const auto& route : *routes) {
            if (!route.sender) continue;
            route.sender->send(
                Traffic::Heartbeat, std::size_t{0},
                [this, call, place = route.place](Prx& prx, Answered answered, Failed then, Sent sent) {
                    const auto fails = [this, place, then = std::move(then)](std::exception_ptr error) {
                        if (isRefused(error)) refused_(place.server, place.proxy);
                        then(std::move(error));
                    };
                    call(prx, std::move(answered), fails, std::move(sent));
                });
        }
    }
    static bool isRefused(const std::exception_ptr& error) {
        try {
            std::rethrow_exception(error);
        } catch (const Ice::ConnectionRefusedException&) {
            return true;
        } catch (...) {
            return false;
        }
    }

    OutboxLimits limitsOf(const Snapshot<Routes>& list) const {
        return &list == &signal_ || &list == &direct_ ? OutboxLimits::ofSignals() : OutboxLimits{};
    }
    /// Of these lists, what is to be opened now. `changes_` is held.
    Opening toOpen(const std::vector<Snapshot<Routes>*>& lists) const {
        Opening opening;
        const auto now = std::chrono::steady_clock::now();
        for (auto* list : lists) {
            const auto routes = list->load();
            for (const auto& route : *routes) {
                if (route.sender || !route.attempt || route.attempt->runs || now < route.attempt->not_before)
                    continue;
                route.attempt->runs = true;
                opening.push_back({list, route});
            }
        }
        return opening;
    }
    /// Returns what is ready when each of them is there or has failed. `changes_` is not held.
    std::vector<std::future<void>> open(const Opening& opening) {
        std::vector<std::future<void>> opened;
        for (const auto& [list, route] : opening) {
            const auto done = std::make_shared<std::promise<void>>();
            opened.push_back(done->get_future());
            try {
                route.proxy->ice_getConnectionAsync(
                    [this, list = list, route = route, done](const std::shared_ptr<Ice::Connection>& to) {
                        connected(*list, route, to);
                        done->set_value();
                    },
                    [this, list = list, route = route, done](const std::exception_ptr& error) {
                        unreached(*list, route, error);
                        done->set_value();
                    });
            } catch (const Ice::Exception&) {
                unreached(*list, route, std::current_exception());
                done->set_value();
            }
        }
        return opened;
    }
    void connected(Snapshot<Routes>& list, const Route& route, const std::shared_ptr<Ice::Connection>& to) {
        const auto kind = route.place.server.empty() ? certificates::Kind::Storm : neighbours_;
        const auto why = notServer(*to, kind, route.place.server);
        if (why) {
            to->close(Ice::ConnectionClose::Forcefully);
            return failed(route, *why, true);
        }
        const std::lock_guard lock(changes_);
        route.attempt->runs = false;
        route.attempt->complaint.clear();
        auto all = *list.load();
        for (auto& one : all) {
            if (one.attempt != route.attempt) continue;
            try {
                const auto fixed = Ice::uncheckedCast<Prx>(to->createProxy(route.proxy->ice_getIdentity()))
                                       ->ice_oneway()
                                       ->ice_invocationTimeout(-1);
                one.sender = sender(fixed, limitsOf(list));
            } catch (const Ice::Exception&) {  // it has closed meanwhile, or the server is ending
                return;
            }
            return store(list, std::move(all));
        }
    }
    void unreached(const Snapshot<Routes>& list, const Route& route, const std::exception_ptr& error) {
        if (&list == &direct_ && isRefused(error)) refused_(route.place.server, route.place.proxy);
        try {
            std::rethrow_exception(error);
        } catch (const Ice::CommunicatorDestroyedException&) {  // the server is ending
        } catch (const std::exception&) {
            failed(route, translate(error, true).message);
        }
    }
    /// It is tried again, and told of once for each reason: without the mutex, for which heartbeats wait.
    void failed(const Route& route, const std::string& why, bool wrong_server = false) {
        {
            const std::lock_guard lock(changes_);
            route.attempt->runs = false;
            route.attempt->not_before = std::chrono::steady_clock::now() + kTryAgain;
            if (std::exchange(route.attempt->complaint, why) == why) return;
        }
        const auto called = route.place.server.empty() ? "IceStorm" : "server " + route.place.server;
        if (wrong_server) return links_->noteWrongServer(called, why);
        spdlog::warn("{}: {} is out of reach: {}", who_, called, why);
    }

    /// Ice shares a connection between the proxies with one id and address. Each server has one of its own:
    /// who announces another server's address would have that one's closed.
    static std::string connectionOf(const Place& place, const std::string& connection) {
        return place.server.empty() ? connection : connection + "-" + place.server;
    }
    /// Held by the caller, because another thread may store new ones.
    std::shared_ptr<const Routes> directRoutes(Lane lane) const {
        return (lane == Lane::Signal ? direct_ : direct_data_).load();
    }
    static void store(Snapshot<Routes>& to, Routes routes) {
        to.store(std::make_shared<const Routes>(std::move(routes)));
    }
    std::shared_ptr<const ProxySender<Prx>> sender(const std::shared_ptr<Prx>& proxy,
                                                   OutboxLimits limits) const {
        return std::make_shared<const ProxySender<Prx>>(
            proxy, limits, Until::Written, [who = who_](bool, const std::string& why) {
                spdlog::warn("{}: messages cannot be published: {}", who, why);
            });
    }
    void warn(const Lines& lines) const {
        for (const auto& line : lines) spdlog::warn("{}: {}", who_, line);
    }
    /// `complaints`: for warn(), when `changes_` is not held any more.
    Routes routes(Ice::Communicator& communicator, const Places& places, const std::string& connection,
                  OutboxLimits limits, const Routes& before, Lines& complaints) const {
        Routes routes;
        for (const auto& place : places) {
            const auto same = std::find_if(before.begin(), before.end(),
                                           [&](const Route& route) { return route.place == place; });
            if (same != before.end()) {
                routes.push_back(*same);
                continue;
            }
            try {
                auto proxy = Ice::uncheckedCast<Prx>(communicator.stringToProxy(place.proxy))
                                 ->ice_oneway()
                                 ->ice_invocationTimeout(-1)
                                 ->ice_connectionId(connectionOf(place, connection));
                if (links_ != nullptr) {
                    // A proxy that caches its connection would return it also when it is closed.
                    const auto asked = proxy->ice_secure(true)->ice_connectionCached(false);
                    routes.push_back({place, asked, nullptr, std::make_shared<Attempt>()});
                } else {
                    routes.push_back({place, proxy, sender(proxy, limits), nullptr});
                }
            } catch (const Ice::Exception& error) {
                complaints.push_back("'" + place.proxy +
                                     "' is not a proxy to which messages can be published (" +
                                     error.ice_id() + ")");
            }
        }
        return routes;
    }

    const std::shared_ptr<Ice::Communicator> data_communicator_;
    const std::shared_ptr<Ice::Communicator> signal_communicator_;
    const std::string who_;
    const Refused refused_;
    LinkTrust* const links_;  // null: the links are plain
    const certificates::Kind neighbours_;
    std::string own_signals_, own_messages_;  // constant after setDirect()
    std::mutex changes_;                      // of the lists, one at a time
    Snapshot<Routes> data_;
    Snapshot<Routes> signal_;
    Snapshot<Routes> direct_;
    Snapshot<Routes> direct_data_;
};

/// Follows one control message to the network. Calls `lost` if the message is not written: while the topic is
/// down, or when its connection fails before it was sent. Copies of its
/// shared_ptr travel in the message's call.
class PublicationTicket {
  public:
    using Lost = std::function<void(const Header&)>;
    PublicationTicket(const Lost& lost, const Header& head) : lost_(lost), head_(head) {}
    ~PublicationTicket() {
        if (!given_) fail();
    }
    PublicationTicket(const PublicationTicket&) = delete;
    PublicationTicket& operator=(const PublicationTicket&) = delete;

    /// The call (forward.hpp) of the message that this ticket is to follow.
    template <class Call>
    static auto follow(const std::shared_ptr<PublicationTicket>& ticket, Call call) {
        return [ticket, call = std::move(call)](auto& prx, const ice::Header& head, const ByteRange& bytes,
                                                Answered answered, Failed failed, Sent sent) {
            call(
                prx, head, bytes, std::move(answered),
                [ticket, failed = std::move(failed)](std::exception_ptr error) {
                    ticket->fail();
                    failed(std::move(error));
                },
                std::move(sent));
            ticket->given_ = true;
        };
    }
    /// When it was published: whether nothing has become of it and nothing will, and nobody was told. The
    /// caller says so then.
    static bool returned(const std::shared_ptr<PublicationTicket>& ticket) {
        return ticket.use_count() == 1 && !ticket->given_ && !ticket->settled_.exchange(true);
    }

  private:
    void fail() {
        if (!settled_.exchange(true)) lost_(head_);
    }
    const Lost& lost_;  // outlives the communicators
    const Header head_;
    std::atomic<bool> given_{false};
    std::atomic<bool> settled_{false};
};

}  // namespace axon::transport
