// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/console_desk.hpp"

#include <utility>

#include "common/refuse.hpp"

namespace axon::server {

using transport::LoggedIn;
using transport::LoginRequest;

namespace {

constexpr const char* kSession = "a session of the web console";

std::string addressOf(const std::string& end) {
    return end.substr(0, end.rfind(':'));
}

Refusal onlyClients() {
    return refuse(RefusalCode::PermissionDenied,
                  "this port is for the sessions of the web console; fix: connect to the port for clients or "
                  "Entity Managers");
}

}  // namespace

ConsoleDesk::ConsoleDesk(LoginDesk& desk, bool has_users, console::Visitors& visitors, Note note)
    : desk_(desk), has_users_(has_users), visitors_(visitors), note_(std::move(note)) {}

void ConsoleDesk::usersChanged(const users::Users& before, const users::Users& now) {
    for (const auto& user : visitors_.users())
        if (!now.keeps(user, before)) visitors_.forget(user);
}

void ConsoleDesk::login(const std::string& user, const std::string& password, const console::Request& request,
                        Answered answered) {
    desk_.client({user, password, request.peer, request.local},
                 [answered = std::move(answered)](Result<LoggedIn> who) {
                     if (!who) return answered(who.refusal());
                     answered(Visitor{who->user, toString(who->role)});
                 });
}

std::optional<Refusal> ConsoleDesk::foreign(const LoginRequest& request) const {
    if (!request.origin || (sites_ && sites_->isOurs(*request.origin, addressOf(request.local))))
        return std::nullopt;
    note_("audit: console: a session that a foreign page opens from " + request.peer + " was refused");
    auto refusal = refuse(RefusalCode::PermissionDenied,
                          "this session is opened by a page that is not this server's console; fix: open "
                          "the console at the address in the server's ready line, or add the address of "
                          "its proxy to Console.Proxies");
    desk_.turnedAway(request.peer, kSession, refusal);
    return refusal;
}

void ConsoleDesk::client(LoginRequest request, Answer answer) {
    if (auto refusal = foreign(request)) return answer(std::move(*refusal));
    if (!has_users_) {
        request.user.clear();
        request.password.clear();
        if (++waiting_ > kWaitingMax) {
            --waiting_;
            auto refusal = refuse(RefusalCode::Overloaded,
                                  "too many browsers are logging in; fix: try again in a few seconds");
            desk_.turnedAway(request.peer, kSession, refusal);
            return answer(std::move(refusal));
        }
        return desk_.client(std::move(request), [this, answer = std::move(answer)](Result<LoggedIn> who) {
            --waiting_;
            answer(std::move(who));
        });
    }
    if (const auto user = visitors_.redeem(request.password)) return answer(desk_.vouchedClient(*user));
    note_("audit: console: failed log-in from " + request.peer + " (no ticket, or an old one)");
    auto refusal =
        refuse(RefusalCode::PermissionDenied,
               "a session of the web console is opened with a ticket as its password, which is good once "
               "and for 30 s; fix: ask for a new one (POST /ticket)");
    desk_.turnedAway(request.peer, kSession, refusal);
    answer(std::move(refusal));
}

void ConsoleDesk::entity(LoginRequest, Answer answer) {
    answer(onlyClients());
}

Result<LoggedIn> ConsoleDesk::vouchedClient(const std::string&,
                                            const std::optional<transport::PeerCertificate>&) {
    return onlyClients();
}

Result<LoggedIn> ConsoleDesk::vouchedEntity(const std::string&,
                                            const std::optional<transport::PeerCertificate>&) {
    return onlyClients();
}

void ConsoleDesk::Signals::client(LoginRequest request, Answer answer) {
    if (auto refusal = desk_.foreign(request)) return answer(std::move(*refusal));
    answer(LoggedIn{});
}

void ConsoleDesk::Signals::entity(LoginRequest, Answer answer) {
    answer(onlyClients());
}

Result<LoggedIn> ConsoleDesk::Signals::vouchedClient(const std::string&,
                                                     const std::optional<transport::PeerCertificate>&) {
    return onlyClients();
}

Result<LoggedIn> ConsoleDesk::Signals::vouchedEntity(const std::string&,
                                                     const std::optional<transport::PeerCertificate>&) {
    return onlyClients();
}

}  // namespace axon::server
