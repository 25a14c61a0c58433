// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/refusal.hpp"
#include "common/result.hpp"
#include "console/core/sites.hpp"
#include "console/core/visitors.hpp"

namespace axon::console {

/// A request of HTTP that is complete. Of a header that is not there the text is empty; of one that is there
/// several times it is all values, with ", " between them.
struct Request {
    std::string method;
    std::string path;  ///< decoded, without a query
    std::string host, origin, cookie, content_type, accept_encoding, if_none_match, forwarded_for;
    std::string body;
    bool too_large = false;  ///< the body was larger than kBodyMax, and is not here
    std::string peer;   ///< "127.0.0.1:50122"; of a proxy on this machine the address that it forwards for
    std::string local;  ///< "127.0.0.1:10417"
};

struct Answer {
    int status = 200;
    std::vector<std::pair<std::string, std::string>> headers;
    std::shared_ptr<const std::string> body;  ///< null: none
};

/// A file of the console, in every coding in which it was built.
struct BuiltFile {
    std::string type;                             ///< "text/html; charset=utf-8"
    std::string tag;                              ///< of its content, 32 hexadecimal digits
    std::shared_ptr<const std::string> plain;     ///< never null
    std::shared_ptr<const std::string> gzip, br;  ///< null where they were not built
};

/// The files of the console by their paths: "/index.html", "/assets/index-4f1b.js".
using BuiltFiles = std::map<std::string, BuiltFile, std::less<>>;

/// Where the files come from. Threads: that of the console.
class FilesPort {
  public:
    virtual ~FilesPort() = default;
    /// Never null. Empty where the console has not been built.
    virtual std::shared_ptr<const BuiltFiles> files() = 0;
    /// The folder, for the page that says so.
    virtual std::string folder() const = 0;
};

/// Who may come in.
class LoginPort {
  public:
    struct Visitor {
        std::string user;
        std::string role;
    };
    using Answered = std::function<void(Result<Visitor>)>;
    virtual ~LoginPort() = default;
    /// Whether the server has users. Constant.
    virtual bool needed() const = 0;
    /// `answered` is called once, perhaps before the call returns, on any thread.
    virtual void login(const std::string& user, const std::string& password, const Request& request,
                       Answered answered) = 0;
    /// Somebody at this address was refused `what` he asked for. For the records.
    virtual void turnedAway(const std::string& peer, const std::string& what, const Refusal& refusal) = 0;
};

/// What the console answers to a request.
///
///     GET, HEAD  a file        the built console; its first page where the path is "/"
///     POST       /login        user=…&password=… : a cookie, {"user": …, "role": …}
///     POST       /logout       the cookie is void
///     POST       /ticket       {"user": …, "password": …, "endpoint": …}, with which to open a session
///
/// A request whose Host is not ours is refused, and so is a POST whose Origin is not that of its page.
/// Everything else goes over the session.
///
/// Pure. Threads: handle() one; the answer to a log-in comes on the thread on which it is decided.
class ConsoleCore {
  public:
    static constexpr std::size_t kBodyMax = 4096;

    /// `strangers` gets the lines that anybody can cause, `note` the others; none: `note` gets all of them.
    ConsoleCore(Sites sites, FilesPort& files, LoginPort& logins, Visitors& visitors,
                std::function<void(const std::string& line)> note,
                std::function<void(const std::string& line)> strangers = {});

    /// `reply` is called once, perhaps before the call returns.
    void handle(Request request, std::function<void(Answer)> reply);
    /// A connection from there was closed, or its request refused, before it was one that can be answered.
    void turnAway(const std::string& peer, RefusalCode code, const std::string& why);

  private:
    /// The answer to a request that is refused; the log and the records have it.
    Answer refuse(const Request& request, int status, RefusalCode code, const std::string& message);
    Answer file(const Request& request, const Site& site);
    void login(const Request& request, const Site& site, std::function<void(Answer)> reply);
    Answer logout(const Request& request, const Site& site);
    Answer ticket(const Request& request, const Site& site);
    std::string cookieName(const Site& site) const;
    std::string setCookie(const Site& site, std::string_view value, std::chrono::seconds life) const;
    /// With the headers that every answer has.
    static Answer secured(Answer answer, const Site* site);

    const Sites sites_;
    FilesPort& files_;
    LoginPort& logins_;
    Visitors& visitors_;
    const std::function<void(const std::string&)> note_, strangers_;
};

}  // namespace axon::console
