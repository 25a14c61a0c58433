// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users_file.hpp"

#include <algorithm>
#include <exception>
#include <functional>
#include <new>

#include "cli/holding.hpp"
#include "cli/words.hpp"

// axon users
namespace axon::cli {
namespace {

using users::UserRole;
using users::Users;

constexpr const char* kFile = "/etc/axon/users.cfg";

std::string fileOf(const Json& args) {
    return args.value("file", std::string(kFile));
}

bool wantsPassword(const Json& args) {
    const auto action = args.value("action", std::string());
    return action == "add" || action == "password";
}

std::string prepareUsers(Json& args) {
    const auto name = args.value("user", std::string());
    // What else is wrong is said by the verb.
    if (!wantsPassword(args) || name.empty() || (args.at("action") == "add") != args.contains("role"))
        return {};
    try {
        args.at("action") == "add" ? users::mayAdd(fileOf(args), name) : users::mayChange(fileOf(args), name);
        args["secret"] = users::readNewPassword();
    } catch (const std::exception& error) {
        return error.what();
    }
    return {};
}

int list(Session& session, const std::string& file) {
    const auto its = Users::read(file, users::MayBeEmpty::Yes);
    auto all = Json::array();
    for (const auto& user : its.all())
        all.push_back(
            {{"name", user.name}, {"role", users::toString(user.role)}, {"hash", users::kindOf(user.hash)}});
    auto lists = Json::array();
    for (const auto& rule : its.access().rules())
        lists.push_back({{"right", toString(rule.right)}, {"entity", rule.entity}, {"who", rule.who}});
    session.events.emit({{"event", "users"},
                         {"file", file},
                         {"fingerprint", its.fingerprint()},
                         {"users", all},
                         {"lists", lists}});
    return kDone;
}

/// What the change may have left behind.
void warn(Session& session, const std::string& file) {
    const auto its = Users::read(file, users::MayBeEmpty::Yes);
    const bool admin = std::any_of(its.all().begin(), its.all().end(),
                                   [](const auto& user) { return user.role == UserRole::Admin; });
    if (!admin)
        session.events.emit(
            {{"event", "finding"},
             {"level", "warn"},
             {"name", file},
             {"message", "no user is admin: nobody can rearm what others hold, or take it over by force"},
             {"fix", "axon users add NAME admin, or axon users role NAME admin"}});
}

int usersVerb(Session& session) {
    const std::string action = session.args.at("action");
    const auto name = session.args.value("user", std::string());
    const auto role = users::userRole(session.args.value("role", std::string()));
    const auto file = fileOf(session.args);
    const bool needs_role = action == "add" || action == "role";
    if (action == "list" && !name.empty()) return misused(session, "axon users list takes no name");
    if (action != "list" && name.empty())
        return misused(session, "expected the name of a user",
                       "axon users " + action + " NAME" + (needs_role ? " ROLE" : ""));
    if (needs_role && !role)
        return misused(session, "expected the role observer, operator, admin or entity",
                       "axon users " + action + " " + shellWord(name) + " operator");
    if (!needs_role && role) return misused(session, "a role is for axon users add and axon users role");
    const auto secret = session.args.value("secret", std::string());
    try {
        if (action == "list") return list(session, file);
        if (action == "add")
            users::addUser(file, name, *role, secret);
        else if (action == "role")
            users::setRole(file, name, *role);
        else if (action == "password")
            users::setPassword(file, name, secret);
        else
            users::removeUser(file, name);
        Json event{{"event", "user_changed"}, {"action", action}, {"file", file}, {"name", name}};
        if (role) event["role"] = users::toString(*role);
        session.events.emit(event);
        if (needs_role || action == "remove") warn(session, file);
        return kDone;
    } catch (const std::bad_alloc&) {
        session.events.emit(usageEvent("there is too little memory to make a hash of the password, 19 MiB"));
    } catch (const std::exception& error) {
        session.events.emit(usageEvent(error.what()));
    }
    return kUsage;
}

}  // namespace

extern const Verb kUsers{
    "users",
    "List and change who may log in at a server",
    "  axon users list                             who may log in, and as what\n"
    "  axon users add ann operator                 asks for the password twice\n"
    "  axon users role ann observer                takes rights away or gives some\n"
    "  axon users password ann                     gives her a new password\n"
    "  axon users remove ann                       ends her sessions, too\n"
    "  pwgen 20 1 | axon users add robot1 entity   the first line of standard input is the password\n"
    "  axon users list --file users.cfg            another file than /etc/axon/users.cfg\n"
    "Roles: an observer may watch and stop everything; an operator may also check out and command; an admin "
    "may\n"
    "also take over by force, and rearm what others hold; entity is for Entity Managers alone. Servers that "
    "run\n"
    "usually take a change over within 2 s; then their logs say users: taken. Whoever is removed or gets a\n"
    "lower role then loses their sessions, and robots that they hold stop. Several servers need the same "
    "file: the fingerprint of axon users list shows "
    "whether\n"
    "they have it. docs/reference/server_configuration.md says more.\n",
    Runs::Local,
    {{"action",
      Takes::Choice,
      true,
      false,
      "list, add, role, password or remove",
      {"list", "add", "role", "password", "remove"}},
     {"user", Takes::Text, false, false, "Name of the user"},
     {"role",
      Takes::Choice,
      false,
      false,
      "add, role: observer, operator, admin or entity",
      {"observer", "operator", "admin", "entity"}}},
    {{"file", Takes::File, "File of users (default /etc/axon/users.cfg)"}},
    usersVerb,
    prepareUsers};

}  // namespace axon::cli
