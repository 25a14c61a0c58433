// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/login_desk.hpp"

#include <pthread.h>
#include <sodium.h>
#include <unistd.h>

#include <new>
#include <stdexcept>
#include <utility>

#include "common/refuse.hpp"
#include "common/utf8.hpp"

namespace axon::server {

using transport::LoggedIn;
using transport::LoginRequest;
using transport::PeerCertificate;
using users::UserRole;

namespace {

constexpr std::size_t kWaitingMax = 4096;
constexpr std::size_t kWaitingOfOneMax = 256;
constexpr std::size_t kUserShown = 64;
constexpr std::size_t kLoginTextMax = 1024;  // of the user's name, and of the password
constexpr const char* kBehindARouter = "somebody behind a router";
constexpr const char* kVouched = "a router or the web console";  // it has seen the connection

/// For logs and refusals.
std::string cut(const std::string& name) {
    return std::string(cutUtf8(validUtf8(name.substr(0, 2 * kUserShown)), kUserShown));
}

}  // namespace

LoginDesk::LoginDesk(std::shared_ptr<const users::Users> users, const Clock& clock, Note note,
                     OwnerOf owner_of, audit::AuditTrail* trail)
    : has_users_(users != nullptr),
      note_(std::move(note)),
      owner_of_(std::move(owner_of)),
      trail_(audit::orNone(trail)),
      guard_(clock),
      users_(std::move(users)) {
    if (sodium_init() < 0)
        throw std::runtime_error("libsodium cannot be used: the kernel gives no random bytes");
    randombytes_buf(key_.data(), key_.size());
    if (users_) fingerprint_ = users_->fingerprint();
    thread_ = std::thread([this] {
        pthread_setname_np(pthread_self(), "axon-login");
        run();
    });
}

LoginDesk::~LoginDesk() {
    close();
}

void LoginDesk::close() {
    {
        const std::lock_guard lock(mutex_);
        closed_ = true;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
}

std::optional<Refusal> LoginDesk::wrongCertificate(Door door,
                                                   const std::optional<PeerCertificate>& certificate,
                                                   const std::string& peer) const {
    if (!certificate) return std::nullopt;
    const std::string expected = door == Door::Client ? "client" : "entity";
    const auto& [name, unit] = *certificate;
    if (unit == expected && !name.empty()) return std::nullopt;
    note_("audit: failed log-in from " + peer + " (its certificate, " + cut(name) + ", has OU=" + cut(unit) +
          "; expected OU=" + expected + ")");
    return refuse(RefusalCode::PermissionDenied,
                  "the certificate that was shown is of the kind '" + cut(unit) +
                      "'; expected one of the kind '" + expected +
                      "' at this port; fix: issue one with axon certs issue --" + expected + " NAME");
}

void LoginDesk::record(Door door, const std::string& user, const std::string& peer,
                       const Result<LoggedIn>& who) const {
    const std::string what = door == Door::Client ? "log-in of a client" : "log-in of an Entity Manager";
    if (!who.ok()) {
        const auto refused = what + ": " + who.refusal().message;
        return trail_.note({.kind = audit::Kind::Refusal,
                            .user = user,
                            .peer = peer,
                            .what = refused,
                            .outcome = refusalName(who.refusal().code)});
    }
    const auto& its = who.value();
    const auto admitted = door == Door::Client ? what + " as " + toString(its.role) : what;
    trail_.note({.kind = audit::Kind::Login,
                 .user = its.user.empty() ? user : its.user,
                 .name = its.entity,
                 .peer = peer,
                 .what = admitted,
                 .outcome = "OK"});
}

LoginDesk::Answer LoginDesk::recorded(Door door, const LoginRequest& request, Answer answer) const {
    // Not the request itself, which has the password.
    const auto user = request.user.empty() && request.certificate ? request.certificate->name : request.user;
    return [this, door, user = cut(user), peer = request.from(),
            answer = std::move(answer)](Result<LoggedIn> who) {
        record(door, user, peer, who);
        answer(std::move(who));
    };
}

void LoginDesk::client(LoginRequest request, Answer answer) {
    answer = recorded(Door::Client, request, std::move(answer));
    if (auto wrong = wrongCertificate(Door::Client, request.certificate, request.from()))
        return answer(std::move(*wrong));
    enqueue(Door::Client, std::move(request), std::move(answer));
}

void LoginDesk::entity(LoginRequest request, Answer answer) {
    answer = recorded(Door::Entity, request, std::move(answer));
    if (auto wrong = wrongCertificate(Door::Entity, request.certificate, request.from()))
        return answer(std::move(*wrong));
    const auto name = request.certificate ? request.certificate->name : std::string();
    if (!has_users_ || (request.certificate && request.user.empty()))
        return answer(LoggedIn{{}, Role::Operator, name});
    answer = [answer = std::move(answer), name](Result<LoggedIn> who) {
        if (!who) return answer(std::move(who));
        auto its = std::move(who).value();
        its.entity = name;
        answer(std::move(its));
    };
    enqueue(Door::Entity, std::move(request), std::move(answer));
}

void LoginDesk::enqueue(Door door, LoginRequest request, Answer answer) {
    const auto address = request.from().substr(0, request.from().rfind(':'));
    // Before it waits: nobody keeps memory here that the server has not asked for.
    const auto turnAway = [&](const Refusal& its) {
        if (lines_.admit(steady_.now()))
            note_("audit: a log-in from " + request.from() + " was refused: " + its.message);
        answer(its);
    };
    if (request.user.size() > kLoginTextMax || request.password.size() > kLoginTextMax)
        return turnAway(refuse(RefusalCode::Malformed, "expected a user name and a password of at most " +
                                                           std::to_string(kLoginTextMax) + " bytes each"));
    std::optional<Refusal> refusal;
    const auto digest = has_users_ && !request.user.empty() ? digestOf(request.password) : std::nullopt;
    {
        const std::lock_guard lock(mutex_);
        const auto its = jobs_.find(address);
        if (closed_) {
            refusal = refuse(RefusalCode::Unavailable, "the server is shutting down");
        } else if (waiting_ < kWaitingMax && digest && isKnown(request.user, *digest)) {
            of_known_.push_back({door, std::move(request), address, std::move(answer)});
            ++waiting_;
        } else if (waiting_ >= kWaitingMax ||
                   (its != jobs_.end() && its->second.size() >= kWaitingOfOneMax)) {
            refusal =
                refuse(RefusalCode::Overloaded, "too many log-ins are waiting; fix: try again in a moment");
        } else {
            if (its == jobs_.end()) turns_.push_back(address);
            jobs_[address].push_back({door, std::move(request), address, std::move(answer)});
            ++waiting_;
        }
    }
    if (refusal) return turnAway(*refusal);
    changed_.notify_one();
}

void LoginDesk::run() {
    while (true) {
        Job job;
        bool closed = false;
        {
            std::unique_lock lock(mutex_);
            changed_.wait(lock, [this] { return closed_ || !turns_.empty() || !of_known_.empty(); });
            if (!of_known_.empty()) {
                job = std::move(of_known_.front());
                of_known_.pop_front();
            } else if (turns_.empty()) {
                return;
            } else {
                const auto its = jobs_.find(turns_.front());
                turns_.pop_front();
                job = std::move(its->second.front());
                its->second.pop_front();
                if (its->second.empty()) {
                    jobs_.erase(its);
                } else {
                    turns_.push_back(its->first);
                }
            }
            --waiting_;
            closed = closed_;
        }
        auto who = closed ? Result<LoggedIn>(refuse(RefusalCode::Unavailable, "the server is shutting down"))
                          : decide(job);
        sodium_memzero(job.request.password.data(), job.request.password.size());
        job.answer(std::move(who));
    }
}

Result<LoggedIn> LoginDesk::decide(const Job& job) {
    const auto& request = job.request;
    if (!has_users_) {
        const auto uid = owner_of_(request.peer, request.local);
        const auto name = request.certificate ? request.certificate->name : std::string();
        return LoggedIn{name, uid && (*uid == 0 || *uid == ::geteuid()) ? Role::Admin : Role::Operator};
    }
    try {
        return decideWithUsers(job);
    } catch (const std::bad_alloc&) {
        note_("audit: a password could not be verified: there is too little memory");
        return refuse(RefusalCode::Overloaded,
                      "the server has too little memory to verify a password; fix: try again, or give its "
                      "machine more memory");
    }
}

Result<LoggedIn> LoginDesk::decideWithUsers(const Job& job) {
    const auto& request = job.request;
    const bool certified = request.certificate && job.door == Door::Client;
    const auto& its_user = certified && request.user.empty() ? request.certificate->name : request.user;
    const auto user = cut(its_user);
    const auto failed = [&](const std::string& why) {
        note_("audit: failed log-in of '" + user + "' from " + request.from() + " (" + why + ")");
    };
    if (certified && its_user != request.certificate->name) {
        failed("its certificate is '" + cut(request.certificate->name) + "'s");
        return refuse(RefusalCode::PermissionDenied,
                      "the certificate that was shown belongs to the user '" +
                          cut(request.certificate->name) + "', who cannot log in as '" + user +
                          "'; fix: leave the user name out, or use the certificate of '" + user + "'");
    }
    if (const auto wait = guard_.mustWait(job.address, user); !certified && wait > Duration{}) {
        failed("tried too early");
        const auto seconds = std::chrono::ceil<std::chrono::seconds>(wait).count();
        return refuse(RefusalCode::PermissionDenied, "too many wrong passwords for '" + user + "' from " +
                                                         job.address + "; fix: try again in " +
                                                         std::to_string(seconds) + " s");
    }
    const auto role = certified ? usersNow()->roleOf(its_user) : verify(request.user, request.password);
    if (certified && !role) {
        failed("not in users.cfg");
        return refuse(RefusalCode::PermissionDenied,
                      "the certificate is valid, but the server has no user '" + user +
                          "'; fix: ask the administrator of the server to add '" + user +
                          "' with axon users add");
    }
    if (!role) {
        guard_.failed(job.address, user);
        failed("wrong name or password");
        return refuse(RefusalCode::PermissionDenied,
                      user.empty() ? "this server asks for a user and a password; fix: log in with those "
                                     "that its administrator gave you"
                                   : "wrong user or password; fix: correct them, or ask the administrator "
                                     "of the server to set a new one with axon users password");
    }
    guard_.succeeded(job.address, user);
    auto who = admit(*role, job.door, user);
    if (!who) failed(std::string("role ") + toString(*role) + " at the other door");
    return who;
}

Result<LoggedIn> LoginDesk::vouched(Door door, const std::string& user) const {
    if (!has_users_) return LoggedIn{};
    if (const auto role = usersNow()->roleOf(user)) return admit(*role, door, user);
    return refuse(RefusalCode::PermissionDenied,
                  "this server has no user " + cut(user) +
                      ", which another server of this installation has accepted; fix: give all servers "
                      "behind the router the same users.cfg");
}

Result<LoggedIn> LoginDesk::vouchedClient(const std::string& user,
                                          const std::optional<PeerCertificate>& certificate) {
    const auto& its = certificate ? certificate->name : user;
    auto who = [&]() -> Result<LoggedIn> {
        if (auto wrong = wrongCertificate(Door::Client, certificate, kBehindARouter))
            return std::move(*wrong);
        if (!has_users_ && certificate) return LoggedIn{its, Role::Operator, {}};
        return vouched(Door::Client, its);
    }();
    record(Door::Client, cut(its), kVouched, who);
    return who;
}

Result<LoggedIn> LoginDesk::vouchedEntity(const std::string& user,
                                          const std::optional<PeerCertificate>& certificate) {
    auto who = [&]() -> Result<LoggedIn> {
        if (auto wrong = wrongCertificate(Door::Entity, certificate, kBehindARouter))
            return std::move(*wrong);
        if (certificate) return LoggedIn{{}, Role::Operator, certificate->name};
        return vouched(Door::Entity, user);
    }();
    record(Door::Entity, cut(certificate ? certificate->name : user), kVouched, who);
    return who;
}

bool LoginDesk::mayVouch(const std::string& peer, const std::string& local) {
    const auto uid = owner_of_(peer, local);
    return uid && (*uid == 0 || *uid == ::geteuid());
}

void LoginDesk::turnedAway(const std::string& peer, const std::string& what, const Refusal& refusal) {
    const auto text = what + ": " + refusal.message;
    trail_.note(
        {.kind = audit::Kind::Refusal, .peer = peer, .what = text, .outcome = refusalName(refusal.code)});
}

Result<LoggedIn> LoginDesk::admit(UserRole role, Door door, const std::string& user) {
    const bool is_entity = role == UserRole::Entity;
    if (is_entity != (door == Door::Entity)) {
        return refuse(RefusalCode::PermissionDenied,
                      is_entity ? "user '" + user +
                                      "' has the role entity, which is for Entity Managers; fix: log in as "
                                      "an observer, operator or admin"
                                : "user '" + user + "' has the role " + toString(role) +
                                      "; fix: give the Entity Manager a user of the role entity (Axon.User)");
    }
    switch (role) {
        case UserRole::Observer:
            return LoggedIn{user, Role::Observer};
        case UserRole::Admin:
            return LoggedIn{user, Role::Admin};
        case UserRole::Operator:
        case UserRole::Entity:
            break;
    }
    return LoggedIn{user, Role::Operator};
}

std::optional<LoginDesk::Digest> LoginDesk::digestOf(const std::string& password) const {
    if (password.size() > users::kPasswordMax) return std::nullopt;
    Digest digest{};
    crypto_generichash(digest.data(), digest.size(), reinterpret_cast<const unsigned char*>(password.data()),
                       password.size(), key_.data(), key_.size());
    return digest;
}

bool LoginDesk::isKnown(const std::string& user, const Digest& digest) const {
    const auto found = known_.find(user);
    return found != known_.end() && sodium_memcmp(found->second.data(), digest.data(), digest.size()) == 0;
}

std::optional<UserRole> LoginDesk::verify(const std::string& user, const std::string& password) {
    const auto digest = digestOf(password);
    while (true) {
        std::shared_ptr<const users::Users> users;
        {
            const std::lock_guard lock(mutex_);
            if (digest && isKnown(user, *digest)) return users_->roleOf(user);
            users = users_;
        }
        const auto role = users->verify(user, password);
        const std::lock_guard lock(mutex_);
        if (users != users_) continue;  // the answer is one of yesterday
        if (role && digest) known_[user] = *digest;
        return role;
    }
}

std::shared_ptr<const users::Users> LoginDesk::usersNow() const {
    const std::lock_guard lock(mutex_);
    return users_;
}

void LoginDesk::setUsers(std::shared_ptr<const users::Users> users) {
    auto fingerprint = users->fingerprint();
    const std::lock_guard lock(mutex_);
    fingerprint_.swap(fingerprint);
    std::erase_if(known_, [&](const auto& known) { return !users->keeps(known.first, *users_); });
    users_.swap(users);
}

std::optional<Role> LoginDesk::clientRole(const std::string& user) const {
    const auto role = usersNow()->roleOf(user);
    if (!role) return std::nullopt;
    const auto who = admit(*role, Door::Client, user);
    return who ? std::optional(who.value().role) : std::nullopt;
}

std::shared_ptr<const users::Access> LoginDesk::access() const {
    auto users = usersNow();
    const auto* its = &users->access();
    return {std::move(users), its};
}

std::string LoginDesk::fingerprint() const {
    const std::lock_guard lock(mutex_);
    return fingerprint_;
}

bool LoginDesk::mayBeEntityManager(const std::string& user) const {
    return usersNow()->roleOf(user) == UserRole::Entity;
}

}  // namespace axon::server
