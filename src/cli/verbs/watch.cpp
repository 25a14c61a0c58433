// SPDX-License-Identifier: GPL-2.0-or-later
#include <cstdlib>
#include <filesystem>
#include <set>

#include "cli/agent_link.hpp"
#include "cli/desktop.hpp"
#include "cli/frames.hpp"
#include "cli/heard_streams.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"
#include "messages/text.hpp"

// axon watch
namespace axon::cli {
namespace {

/// What was measured, without what the event says itself.
Json sampleEvent(const std::string& entity, const Sample& sample) {
    Json event{
        {"event", "sample"}, {"entity", entity}, {"stream", sample.stream}, {"sequence", sample.sequence}};
    auto content = Json::parse(sample.json(), nullptr, false);
    if (content.is_object()) {
        // Protobuf's JSON writes 64-bit integers as texts.
        if (const auto taken = content.value("taken_at_us", ""); !taken.empty() && taken.size() < 19) {
            event["taken_at_us"] = std::strtoll(taken.c_str(), nullptr, 10);
        }
        for (const auto* known : {"stream", "sequence", "taken_at_us"}) content.erase(known);
    }
    event["sample"] = std::move(content);
    return event;
}

/// Where the pictures of a stream go: to a file, and to a page that shows it.
class PictureFile {
  public:
    explicit PictureFile(std::filesystem::path file) : file_(std::move(file)) {}

    /// For a sample with a picture, writes it, and puts its place where the pixels were. MALFORMED if it has
    /// none, or the file cannot be written.
    Result<void> take(Json& event) const {
        const auto picture = pictureOf(event.at("sample"));
        if (!picture) {
            return Refusal{RefusalCode::Malformed, "the stream " + event.value("stream", "") +
                                                       " has no pictures in jpeg, png, rgb8, bgr8 or mono8"};
        }
        if (const auto written = replaceFile(file_, *picture); !written) return written;
        event["file"] = file_.string();
        event["size"] = picture->size();
        return {};
    }

  private:
    const std::filesystem::path file_;
};

/// $XDG_RUNTIME_DIR/axon/view-ENTITY-STREAM, private as its parent is.
Result<std::filesystem::path> viewFolder(const Session& session, const std::string& entity_id,
                                         const std::string& stream) {
    const auto place = agentPlace(session.settings.server);
    if (!place) return place.refusal();
    const auto folder = place->directory / viewFolderName(entity_id, stream);
    std::error_code failed;
    std::filesystem::create_directory(folder, failed);
    if (failed)
        return Refusal{RefusalCode::Malformed, "cannot make " + folder.string() + ": " + failed.message()};
    return folder;
}

/// What --save and --view want of the pictures; nothing if neither is given.
Result<std::optional<PictureFile>> pictureFile(Session& session, const Entity& entity) {
    if (session.args.value("view", false)) {
        const auto stream = session.args.at("streams").at(0).get<std::string>();
        const auto folder = viewFolder(session, entity.id, stream);
        if (!folder) return folder.refusal();
        // A viewer tells the kind of a picture by its first bytes, not by its name.
        const auto picture = session.args.contains("save")
                                 ? std::filesystem::path(session.args.at("save").get<std::string>())
                                 : folder.value() / "picture";
        const auto page = folder.value() / "index.html";
        if (const auto made =
                replaceFile(page, viewerPage(callOf(session, entity) + " " + stream, picture.string()));
            !made)
            return made.refusal();
        const bool opened = Desktop::of(session.args.value("desktop", Json())).open(page.string());
        session.events.emit({{"event", "viewing"}, {"file", page.string()}, {"opened", opened}});
        return std::optional(PictureFile(picture));
    }
    if (session.args.contains("save"))
        return std::optional(PictureFile(session.args.at("save").get<std::string>()));
    return std::optional<PictureFile>();
}

/// An absolute path, and the desktop of whoever typed this: the verb may run in the agent, whose folder and
/// desktop are others.
std::string prepareWatch(Json& args) {
    const bool pictures = args.contains("save") || args.value("view", false);
    if (pictures && args.value("streams", std::vector<std::string>{}).size() != 1)
        return "--save and --view need the name of one stream, such as camera";
    if (args.contains("save"))
        args["save"] = std::filesystem::absolute(args.at("save").get<std::string>()).string();
    if (args.value("view", false)) args["desktop"] = Desktop::here().json();
    return {};
}

/// How long a stream that was named may be silent before the user is told.
constexpr std::chrono::seconds kSilence{1};

/// Says which of these streams the entity does not send, and which ones it sends.
void tellSilent(Session& session, const std::string& entity, const std::string& call,
                std::set<std::string> silent) {
    std::string sent;
    for (const auto& stream : streamsOf(session, entity)) {
        const auto name = stream.at("name").get<std::string>();
        silent.erase(name);
        sent += (sent.empty() ? "" : ", ") + name;
    }
    for (const auto& name : silent) {
        session.events.emit({{"event", "notice"},
                             {"message", call + " sends no stream " + inQuotes(name) + " now; " +
                                             (sent.empty() ? "it sends none at all" : "it sends " + sent)}});
    }
}

int watch(Session& session) {
    const auto name = session.args.at("entity").get<std::string>();
    const auto found = session.station->find(name);
    if (!found) return refuse(session, found.refusal(), name);
    const auto listening = listenTo(session, found.value());
    const auto mailbox = session.mailbox;
    const auto call = callOf(session, found.value());
    auto pictures = pictureFile(session, found.value());
    if (!pictures) return misused(session, pictures.refusal().message, {});
    const auto streams = session.args.value("streams", std::vector<std::string>{});
    const auto watching = session.station->watch(found->id, streams, [mailbox, call](const Sample& sample) {
        mailbox->post(sampleEvent(call, sample), true);
    });
    if (!watching) return refuse(session, watching.refusal(), name);
    session.events.emit({{"event", "watching"}, {"entity", call}});

    using Clock = std::chrono::steady_clock;
    std::optional<Clock::time_point> end;
    if (session.args.contains("for")) {
        end = Clock::now() +
              std::chrono::duration_cast<Clock::duration>(Seconds(session.args.at("for").get<double>()));
    }
    std::set<std::string> silent(streams.begin(), streams.end());
    std::optional<Clock::time_point> patience;
    if (!silent.empty()) patience = std::min(end.value_or(Clock::time_point::max()), Clock::now() + kSilence);
    bool any = false;
    while (true) {
        auto event = session.mailbox->wait(patience ? patience : end);
        if (!event && session.mailbox->takeInterrupt()) return kInterrupted;
        if (event && event->at("event") == "sample") silent.erase(event->at("stream").get<std::string>());
        if (patience && Clock::now() >= *patience) {
            patience.reset();
            if (!silent.empty()) tellSilent(session, found->id, call, silent);
        }
        if (!event) {
            if (end && Clock::now() >= *end) break;
            continue;
        }
        if (pictures.value() && event->at("event") == "sample") {
            if (const auto taken = pictures.value()->take(*event); !taken)
                return misused(session, taken.refusal().message,
                               "axon watch without --save and --view shows it");
            event->at("sample").at("image").erase("pixels");
        }
        session.events.emit(*event);
        any = true;
        if (const auto dropped = session.mailbox->takeDropped(); dropped > 0) {
            session.events.emit({{"event", "dropped"}, {"count", dropped}});
        }
        // A clock that is looked at only when nothing comes would never end a busy watch.
        if (end && Clock::now() >= *end) break;
    }
    if (session.mailbox->takeInterrupt()) return kInterrupted;
    // Of the streams that were named, not one sample.
    if (!streams.empty() && silent.size() == std::set<std::string>(streams.begin(), streams.end()).size())
        return kNotConfirmed;
    if (!any && streams.empty())
        session.events.emit({{"event", "notice"}, {"message", "nothing was received from " + call}});
    return kDone;
}

}  // namespace

extern const Verb kWatch{
    "watch",
    "Show the streams of an entity, and its messages to the holder",
    "  axon watch PeopleBot                  all streams until Ctrl-C\n"
    "  axon watch PeopleBot pose --for 10\n"
    "  axon watch PeopleBot pose --json | jq -c .sample\n"
    "  axon watch PeopleBot camera --save now.jpg   keeps the newest picture in now.jpg\n"
    "  axon watch PeopleBot camera --view           shows the pictures in a browser\n"
    "With --for, the exit status is 4 if none of the streams that are named has sent anything.\n"
    "Texts and raw data go to the holder only: they are shown if axon checkout holds the entity.\n",
    Runs::Anywhere,
    {{"entity", Takes::Entity, true, false, "The entity"},
     {"streams", Takes::Stream, false, true, "Names of streams; without a name, all of them"}},
    {{"for", Takes::Duration, "End after this long"},
     {"save", Takes::File, "Write the newest picture of the one stream into this file"},
     {"view", Takes::Nothing,
      "Show the pictures of the one stream on a page that renews itself, and open it on a desktop"}},
    watch,
    prepareWatch};

}  // namespace axon::cli
