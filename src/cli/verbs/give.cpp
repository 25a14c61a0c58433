// SPDX-License-Identifier: GPL-2.0-or-later
#include <fstream>
#include <iostream>
#include <iterator>
#include <stop_token>
#include <thread>

#include "cli/arguments.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"
#include "common/utf8.hpp"
#include "messages/text.hpp"

// axon set, axon upload, axon send
namespace axon::cli {
namespace {

/// What one message may carry; more is for `axon upload`. Twice as many hexadecimal digits fit the agent's
/// line.
constexpr std::size_t kLargestMessage = std::size_t{256} * 1024;

int set(Session& session) {
    const auto name = session.args.at("entity").get<std::string>();
    const auto found = session.station->find(name);
    if (!found) return refuse(session, found.refusal(), name);
    const auto services = session.station->services(found->id);
    if (!services) return refuse(session, services.refusal(), name);
    const auto service = findService(services.value(), session.args.at("service").get<std::string>());
    if (!service) return refuse(session, service.refusal(), name);
    const auto arguments =
        readArguments(*service.value(), session.args.at("parameters").get<std::vector<std::string>>());
    if (!arguments) {
        if (arguments.refusal().code == RefusalCode::Malformed)
            return misused(session, arguments.refusal().message,
                           "axon info " + shellWord(name) + " " + shellWord(service.value()->name) +
                               " shows what it takes");
        return refuse(session, arguments.refusal(), name);
    }
    int exit = kDone;
    const auto holding = Holding::of(session, name, "command", exit);
    if (!holding) return exit;
    for (const auto& argument : arguments.value()) {
        const auto done = session.station->set(found->id, service.value()->name, argument);
        if (!done) return refuse(session, done.refusal(), name);
        auto values = Json::array();
        for (const auto& value : argument.values) values.push_back(toJson(value));
        session.events.emit({{"event", "set"},
                             {"entity", holding->call()},
                             {"service", service.value()->name},
                             {"parameter", argument.name},
                             {"values", values},
                             {"units", argument.units}});
    }
    return kDone;
}

std::string prepareUpload(Json& args) {
    std::error_code error;
    const std::filesystem::path file = args.at("file").get<std::string>();
    const auto status = std::filesystem::status(file, error);
    if (!std::filesystem::is_regular_file(status)) {
        return "expected a file to upload, found " +
               std::string(std::filesystem::is_directory(status) ? "a directory"
                           : std::filesystem::exists(status)     ? "something that is not a file"
                           : status.type() == std::filesystem::file_type::not_found ? "none"
                                                                                    : error.message()) +
               " at " + inQuotes(file.string(), 200);
    }
    args["file"] = std::filesystem::absolute(file, error).string();
    return {};
}

int upload(Session& session) {
    const auto name = session.args.at("entity").get<std::string>();
    const auto found = session.station->find(name);
    if (!found) return refuse(session, found.refusal(), name);
    const auto services = session.station->services(found->id);
    if (!services) return refuse(session, services.refusal(), name);
    const auto service = findService(services.value(), session.args.at("service").get<std::string>());
    if (!service) return refuse(session, service.refusal(), name);
    const auto resource = findResource(*service.value(), session.args.at("resource").get<std::string>());
    if (!resource) return refuse(session, resource.refusal(), name);
    int exit = kDone;
    const auto holding = Holding::of(session, name, "upload", exit);
    if (!holding) return exit;

    const std::string file = session.args.at("file");
    const Json about{{"event", "upload"},
                     {"entity", holding->call()},
                     {"service", service.value()->name},
                     {"resource", resource.value()->name},
                     {"file", file}};
    // The library's call waits for the whole transfer: on a thread, so that progress is shown and Ctrl-C
    // heard. What the thread needs it owns, because an interrupted verb leaves it behind.
    std::stop_source give_up;
    auto work = [mailbox = session.mailbox, station = session.station, about, file, entity = found->id,
                 service_name = service.value()->name, resource_name = resource.value()->name,
                 stopping = give_up.get_token()] {
        const auto done = station->upload(
            entity, service_name, resource_name, file,
            [&](std::uint64_t sent, std::uint64_t total) {
                auto event = about;
                event["sent"] = sent;
                event["total"] = total;
                mailbox->post(std::move(event), true);
            },
            stopping);
        Json end{{"event", "end"}};
        if (!done) {
            end["error"] = errorEvent(done.refusal());
            end["exit"] = exitOf(done.refusal());
        }
        mailbox->post(std::move(end));
    };
    std::thread(std::move(work)).detach();
    while (true) {
        const auto event = session.mailbox->wait();
        if (!event) {
            session.mailbox->takeInterrupt();
            give_up.request_stop();
            session.events.emit(
                {{"event", "notice"},
                 {"message",
                  "interrupted; run the same axon upload again to continue where this one ended"}});
            return kInterrupted;
        }
        if (event->at("event") != "end") {
            session.events.emit(*event);
            continue;
        }
        if (event->contains("error")) {
            session.events.emit(event->at("error"));
            return event->at("exit");
        }
        auto uploaded = about;
        uploaded["event"] = "uploaded";
        session.events.emit(uploaded);
        return kDone;
    }
}

/// Reads what is to be sent here: the agent has another standard input and another working directory.
std::string prepareSend(Json& args) {
    const bool file = args.contains("file");
    if (file == args.contains("text")) return "expected either TEXT or --file FILE";
    std::string content;
    if (!file) {
        content = args.at("text").get<std::string>();
    } else {
        const auto path = args.at("file").get<std::string>();
        std::ifstream opened;
        std::error_code unknown;
        if (path != "-" && std::filesystem::is_directory(path, unknown))
            return "expected a file to send, found a directory at " + inQuotes(path, 200);
        if (path != "-") opened.open(path, std::ios::binary);
        std::istream& in = path == "-" ? std::cin : opened;
        if (!in) return "cannot read " + inQuotes(path, 200);
        content.resize(kLargestMessage + 1);
        in.read(content.data(), static_cast<std::streamsize>(content.size()));
        content.resize(static_cast<std::size_t>(in.gcount()));
    }
    if (content.size() > kLargestMessage) {
        return "a message carries at most 256 KiB: send files with axon upload";
    }
    args.erase("file");
    if (args.value("raw", false)) {
        args.erase("text");
        args["hex"] = toHex(content);
    } else {
        if (!isUtf8(content)) return "the text is not UTF-8: send bytes with --raw";
        args["text"] = content;
    }
    return {};
}

int send(Session& session) {
    const auto name = session.args.at("entity").get<std::string>();
    int exit = kDone;
    const auto holding = Holding::of(session, name, "message", exit);
    if (!holding) return exit;
    const auto& entity = holding->entity();
    const auto listening = session.args.contains("for") ? listenTo(session, entity) : nullptr;
    std::size_t size = 0;
    Result<void> sent;
    if (session.args.contains("hex")) {
        const auto bytes = fromHex(session.args.at("hex").get<std::string>());
        if (!bytes) return misused(session, "expected hexadecimal digits");
        size = bytes->size();
        sent = session.station->sendRaw(entity.id, *bytes);
    } else {
        const auto text = session.args.at("text").get<std::string>();
        size = text.size();
        sent = session.station->sendText(entity.id, text);
    }
    if (!sent) return refuse(session, sent.refusal(), name);
    session.events.emit({{"event", "sent"},
                         {"entity", holding->call()},
                         {"size", size},
                         {"raw", session.args.contains("hex")}});
    if (!listening) return kDone;
    const auto end =
        std::chrono::steady_clock::now() + std::chrono::duration_cast<std::chrono::steady_clock::duration>(
                                               Seconds(session.args.at("for").get<double>()));
    while (const auto event = session.mailbox->wait(end)) session.events.emit(*event);
    return session.mailbox->takeInterrupt() ? kInterrupted : kDone;
}

}  // namespace

extern const Verb kSet{"set",
                       "Set parameters of a service",
                       "  axon set PeopleBot Driving 'Range Threshold=500'\n"
                       "  axon set PeopleBot Driving range_threshold=500mm\n"
                       "The robot application grants or denies each value. Values that are not savable are "
                       "cleared after each task.\n",
                       Runs::Holder,
                       {{"entity", Takes::Entity, true, false, "The entity"},
                        {"service", Takes::Service, true, false, "Name or global id of the service"},
                        {"parameters", Takes::KeyValue, true, true, "PARAMETER=VALUE"}},
                       {},
                       set};

extern const Verb kUpload{"upload",
                          "Upload a file as a resource of a service",
                          "  axon upload PeopleBot Navigation Map lab.map\n"
                          "An interrupted upload continues where it ended.\n",
                          Runs::Holder,
                          {{"entity", Takes::Entity, true, false, "The entity"},
                           {"service", Takes::Service, true, false, "Name or global id of the service"},
                           {"resource", Takes::Resource, true, false, "Name of the resource"},
                           {"file", Takes::File, true, false, "File to upload"}},
                          {},
                          upload,
                          prepareUpload};

extern const Verb kSend{"send",
                        "Send a text or bytes to the robot's application",
                        "  axon send PeopleBot 'hello there'\n"
                        "  axon send PeopleBot --raw --file frame.bin\n"
                        "  date | axon send PeopleBot --file - --for 2     then show the answers for 2 s\n",
                        Runs::Holder,
                        {{"entity", Takes::Entity, true, false, "The entity"},
                         {"text", Takes::Text, false, false, "Text to send"}},
                        {{"file", Takes::File, "Send the content of this file; - is the standard input"},
                         {"raw", Takes::Nothing, "Send raw data instead of text"},
                         {"for", Takes::Duration, "Then show for this long what the robot sends"}},
                        send,
                        prepareSend};

}  // namespace axon::cli
