// SPDX-License-Identifier: GPL-2.0-or-later
// Requests to the web console, whose fields are the lines of the input: method, path, Host, Origin, Cookie,
// type, Accept-Encoding, If-None-Match, and the body is what is left. Each is answered once; nobody gets a
// cookie without the password or a ticket without the cookie, or anything under a foreign name.
#include <array>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "common/refuse.hpp"
#include "console/core/console_core.hpp"
#include "console/core/form.hpp"

namespace {

using namespace axon;
using namespace axon::console;

void require(bool holds) {
    if (!holds) std::abort();
}

class Files final : public FilesPort {
  public:
    std::shared_ptr<const BuiltFiles> files() override { return all_; }
    std::string folder() const override { return "folder"; }

  private:
    const std::shared_ptr<const BuiltFiles> all_ = std::make_shared<const BuiltFiles>(
        BuiltFiles{{"/index.html",
                    {"text/html", "aa", std::make_shared<const std::string>("page"),
                     std::make_shared<const std::string>("gz"), nullptr}}});
};

class Passwords final : public LoginPort {
  public:
    bool needed() const override { return true; }
    void login(const std::string& user, const std::string& password, const Request&,
               Answered answered) override {
        right = user == "anna" && password == "secret";
        if (right) return answered(Visitor{user, "operator"});
        answered(refuse(RefusalCode::PermissionDenied, "wrong user or password"));
    }
    void turnedAway(const std::string&, const std::string&, const Refusal&) override {}
    bool right = false;
};

std::string_view line(std::string_view& text) {
    const auto end = text.find('\n');
    const auto its = text.substr(0, end);
    text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
    return its;
}

bool has(const Answer& answer, std::string_view name) {
    for (const auto& [key, value] : answer.headers)
        if (key == name) return true;
    return false;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    std::string_view rest(reinterpret_cast<const char*>(bytes), size);
    parseForm(rest);
    cookie(rest, "axon-10417");
    accepts(rest, "gzip");
    matchesTag(rest, "\"aa\"");
    if (const auto client = forwardedFor(rest))
        require(client->size() <= 45 &&
                client->find_first_not_of("0123456789abcdefABCDEF:.") == std::string::npos);

    ManualClock clock;
    SeededRandom random(1);
    Visitors visitors(clock, random);
    const auto key = visitors.enter("anna");
    Files files;
    Passwords passwords;
    ConsoleCore core(Sites({false, 10417, 10418, 10419, {"lab"}, {"https://lab.example"}}), files, passwords,
                     visitors,
                     [](const std::string& note) { require(note.find('\n') == std::string::npos); });
    Request request;
    request.method = line(rest);
    request.path = line(rest);
    request.host = line(rest);
    request.origin = line(rest);
    request.cookie = line(rest);
    request.content_type = line(rest);
    request.accept_encoding = line(rest);
    request.if_none_match = line(rest);
    request.body = rest;
    request.peer = "127.0.0.1:50122";
    request.local = "127.0.0.1:10417";
    const auto asked = request;
    int answers = 0;
    core.handle(request, [&](const Answer& answer) {
        ++answers;
        require(answer.status >= 200 && answer.status < 504);
        require(has(answer, "Content-Security-Policy") && has(answer, "X-Content-Type-Options"));
        for (const auto& [name, value] : answer.headers)
            require(value.find_first_of(std::string_view("\r\n\0", 3)) == std::string::npos);
        const bool page = answer.body && (*answer.body == "page" || *answer.body == "gz");
        require(!page || asked.path == "/" || asked.path == "/index.html");
        if (asked.path == "/login" && answer.status == 200)
            require(passwords.right && has(answer, "Set-Cookie"));
        if (asked.path == "/ticket" && answer.status == 200)
            require(asked.cookie.find(key) != std::string::npos && !asked.origin.empty());
        if (asked.host.find(':') == std::string::npos && asked.host.find('.') == std::string::npos)
            require(answer.status == 421);  // ours have a port, or are that of the proxy
    });
    require(answers == 1);
    return 0;
}
