// SPDX-License-Identifier: MIT
// The data thread of the Communicator: requests in, callbacks called, profiles out; and the task threads.
#include <axon/link.pb.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>

#include "common/utf8.hpp"
#include "entity_interfacer/communicator.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kProfileMax = kFrameMax - 4096;
constexpr std::size_t kThrownMax = 1000;  // of what an exception says, in bytes
constexpr auto kProfileLook = 1s;
constexpr auto kNotSentAgain = 10s;

std::optional<std::string> readFile(const std::filesystem::path& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) return std::nullopt;
    std::string text(kProfileMax + 1, '\0');
    in.read(text.data(), static_cast<std::streamsize>(text.size()));
    if (in.bad()) return std::nullopt;
    text.resize(static_cast<std::size_t>(in.gcount()));
    return text;
}

std::filesystem::path absolutePath(const std::filesystem::path& path) {
    std::error_code error;
    const auto absolute = std::filesystem::absolute(path, error);
    return (error ? path : absolute).lexically_normal();
}

RefusalCode codeOf(const Decision& decision) {
    if (decision.granted()) return RefusalCode::Ok;
    return decision.isRobotLost() ? RefusalCode::RobotLost : RefusalCode::Denied;
}

}  // namespace

bool Communicator::send(const proto::EiToEm& message, Link::Kind kind) {
    const auto link = currentLink();
    return !link || link->sendData(message, kind);
}

void Communicator::setPosition(double x, double y, double z) {
    proto::EiToEm message;
    auto& position = *message.mutable_position();
    position.set_xpos(x);
    position.set_ypos(y);
    position.set_zpos(z);
    statements_.positionIs(x, y, z);
    send(message, Link::Kind::Droppable);
}

void Communicator::setServiceActive(std::string_view service, bool active, std::string_view reason) {
    statements_.activeIs(service, active, reason,
                         [this](const proto::EiToEm& said) { send(said, Link::Kind::Control); });
}

void Communicator::sendTaskFeedback(std::string_view service, std::string_view text) {
    for (const auto& task : tasks_.ofService(service)) task->feedback(text);
}

std::shared_ptr<Stream::Channel> Communicator::channel(std::string_view name) {
    const auto valid = validUtf8(name);
    return channels_.channel(valid, [&] { return std::make_shared<Stream::Channel>(valid, *this); });
}

void Communicator::upload(bool services, const std::filesystem::path& file) {
    auto text = readFile(file);
    if (!text || text->empty() || text->size() > kProfileMax)
        throw Misconfiguration("axon: " + file.string() + ": expected a readable " +
                               (services ? "services" : "basic") +
                               " profile (XML, 1 byte to 1020 KiB); fix: create it, or correct the path");
    std::error_code ignored;
    const std::lock_guard lock(profiles_mutex_);
    profiles_.at(services ? 1 : 0) = {file, std::filesystem::last_write_time(file, ignored), text->size(),
                                      std::move(*text), true};
    data_wake_.wake();
}

void Communicator::sendProfiles(Link& link, bool all) {
    const std::lock_guard lock(profiles_mutex_);
    for (std::size_t i = 0; i < profiles_.size(); ++i) {
        auto& profile = profiles_.at(i);
        if (profile.file.empty() || (!all && !profile.send)) continue;
        profile.send = false;
        proto::EiToEm message;
        auto& upload = *message.mutable_profile();
        upload.set_services(i == 1);
        upload.set_file_name(validUtf8(profile.file.string()));
        upload.set_xml(profile.xml);
        if (i == 1) {
            upload.set_folder(validUtf8(absolutePath(profile.file).parent_path().string()));
            for (const auto& folder : options_.resource_folders)
                upload.add_resource_folders(validUtf8(absolutePath(folder).string()));
        }
        link.sendData(message, Link::Kind::Control);
    }
}

void Communicator::watchProfiles() {
    if (!options_.watch_profiles || std::chrono::steady_clock::now() < next_profile_look_) return;
    next_profile_look_ = std::chrono::steady_clock::now() + kProfileLook;
    for (std::size_t i = 0; i < profiles_.size(); ++i) {
        std::filesystem::path file;
        std::filesystem::file_time_type changed;
        std::uintmax_t size = 0;
        {
            const std::lock_guard lock(profiles_mutex_);
            file = profiles_.at(i).file;
            changed = profiles_.at(i).changed;
            size = profiles_.at(i).size;
        }
        if (file.empty()) continue;
        std::error_code gone;
        const auto time = std::filesystem::last_write_time(file, gone);
        const auto length = gone ? 0 : std::filesystem::file_size(file, gone);
        if (gone || length == 0 || (time == changed && length == size))
            continue;  // an editor may be replacing it
        auto text = readFile(file);
        if (!text || text->empty()) continue;
        const bool fits = text->size() <= kProfileMax;
        {
            const std::lock_guard lock(profiles_mutex_);
            auto& profile = profiles_.at(i);
            if (profile.file != file) continue;
            profile.changed = time;
            profile.size = length;
            if (fits) profile.xml = std::move(*text);
            profile.send = fits;
        }
        if (fits)
            log(LogLevel::Info, file.string() + " has changed and is uploaded again");
        else
            log(LogLevel::Error, file.string() + ": expected at most 1020 KiB; fix: shorten it");
    }
}

template <class Call>
std::optional<std::string> Communicator::thrownBy(Call call) {
    try {
        call();
        return std::nullopt;
    } catch (const std::exception& error) {
        return " (" + std::string(cutUtf8(validUtf8(error.what()), kThrownMax)) + ")";
    } catch (...) {
        return std::string();
    }
}

template <class Call>
bool Communicator::guarded(const char* what, Call call, const std::function<void()>& last_words) {
    const auto thrown = thrownBy(call);
    if (thrown) fault(std::string("an exception left ") + what + *thrown, last_words);
    return !thrown;
}

bool Communicator::overtaken(const Link& link, std::uint32_t generation) const {
    return link.lost() || !level_.settled() || level_.stopped() > generation || level_.epoch() != link.epoch;
}

template <class Call>
void Communicator::unlessOvertaken(const Link& link, std::uint32_t generation, Call call) {
    if (!level_.enter([&] { return !overtaken(link, generation); })) return;
    call();
    level_.leave();
    if (!level_.settled()) stop_wake_.wake();
}

void Communicator::dataThread() {
    this_thread_of = this;
    std::shared_ptr<Link> link;
    const auto drop = [&] {
        if (!link) return;
        publish(nullptr);
        log(LogLevel::Warning, "link lost: " + link->reason());
        if (callbacks_.link_down) guarded("onLinkDown", [&] { callbacks_.link_down(link->reason()); });
        link.reset();
    };
    while (!end_data_thread_) {
        std::array<pollfd, 2> wait{pollfd{data_wake_.fd(), POLLIN, 0},
                                   pollfd{link ? link->dataFd() : -1, POLLIN, 0}};
        if (link && link->pending()) wait[1].events |= POLLOUT;
        ::poll(wait.data(), wait.size(), 1000);
        if (wait[0].revents != 0) data_wake_.drain();
        logNotes();
        if (link && (wait[1].revents & POLLOUT) != 0) link->flush();
        if (link && (wait[1].revents & ~POLLOUT) != 0) readData(link);
        if (link && link->lost()) drop();
        std::shared_ptr<Link> next;
        {
            const std::lock_guard lock(data_handover_mutex_);
            next = std::move(data_handover_);
        }
        if (next) {
            drop();
            link = next;
            adoptDataLink(link);
        }
        watchProfiles();
        if (link) sendProfiles(*link, false);
        tasks_.reap();
    }
    drop();
    logNotes();
    this_thread_of = nullptr;
}

void Communicator::adoptDataLink(const std::shared_ptr<Link>& link) {
    may_move_ = false;
    sendProfiles(*link, true);
    channels_.linkBegins();
    statements_.repeat([&](const proto::EiToEm& said) { link->sendData(said, Link::Kind::Control); },
                       [&] { publish(link); });
    log(LogLevel::Info, "linked with Entity Manager " + link->manager);
    if (callbacks_.link_up) guarded("onLinkUp", [&] { callbacks_.link_up(); });
}

void Communicator::readData(const std::shared_ptr<Link>& link) {
    const auto room = link->data_reader.room();
    const auto got = ::recv(link->dataFd(), room.data(), room.size(), MSG_DONTWAIT);
    if (got == 0) link->cut("the Entity Manager has closed the link");
    if (got < 0 && errno != EAGAIN && errno != EINTR)
        link->cut(std::string("data connection: ") + std::strerror(errno));
    if (got <= 0) return stop_wake_.wake();
    link->data_reader.filled(static_cast<std::size_t>(got));
    proto::EmToEi message;
    while (!link->lost()) {
        const auto payload = link->data_reader.nextView();
        if (!payload) break;
        if (!message.ParseFromArray(payload->data(), static_cast<int>(payload->size())))
            link->cut("malformed message on the data connection");
        else
            onData(link, message);
    }
    if (link->data_reader.failed()) link->cut("data connection: " + link->data_reader.error());
}

/// The handler first: what it reads from then on is what the application is told of.
void Communicator::onConfiguration(const std::shared_ptr<Link>& link,
                                   const proto::Configuration& configuration) {
    const auto task = tasks_.find(configuration.task_id());
    for (const auto& one : configuration.params()) {
        const auto parameter = fromProto(one.param());
        if (task) task->configure(parameter);
        if (!callbacks_.config) continue;
        const auto thrown = thrownBy([&] { callbacks_.config(one.service(), parameter); });
        const auto which = "parameter '" + parameter.name + "'";
        // The next link tells the value again, before anything can move.
        if (thrown && may_move_)
            return fault("an exception left onConfig for " + which + " of '" + one.service() + "'" + *thrown,
                         {});
        std::optional<std::string> why_not;
        if (thrown)
            why_not = "the value of " + which + " was not accepted: onConfig threw" + *thrown +
                      "; fix: set another value";
        statements_.valueTaken(one.service(), parameter.name, why_not,
                               [&](const proto::EiToEm& said) { link->sendData(said, Link::Kind::Control); });
        if (thrown) log(LogLevel::Error, "'" + one.service() + "' is inactive: " + *why_not);
    }
}

/// A stream of refusals is one line.
void Communicator::onNotSent(const proto::NotSent& refused) {
    const auto what = refused.to() + ": " + refused.reason().message();
    if (what != last_not_sent_ || now() >= tell_not_sent_) {
        log(LogLevel::Warning, "raw data was not sent to " + what);
        last_not_sent_ = what;
        tell_not_sent_ = now() + kNotSentAgain;
    }
    if (callbacks_.not_sent)
        guarded("onNotSent", [&] { callbacks_.not_sent(refused.to(), refused.reason().message()); });
}

void Communicator::onData(const std::shared_ptr<Link>& link, const proto::EmToEi& message) {
    const auto respond = [&](std::uint64_t request, RefusalCode code, const std::string& reason) {
        proto::EiToEm reply;
        auto& body = *reply.mutable_answer();
        body.set_request(request);
        body.mutable_refusal()->set_code(static_cast<proto::RefusalCode>(code));
        body.mutable_refusal()->set_message(validUtf8(reason));
        link->sendData(reply, Link::Kind::Control);
    };
    const auto answer = [&](std::uint64_t request, const char* what, const std::function<Decision()>& ask) {
        auto decision =
            Decision::deny(std::string(what) + " threw an exception: the robot application has stopped");
        const auto reply = [&] { respond(request, codeOf(decision), decision.reason()); };
        if (guarded(
                what, [&] { decision = ask(); }, reply))
            reply();
    };
    may_move_ = may_move_ || message.has_task() || message.has_raw() || message.has_pause();
    switch (message.body_case()) {
        case proto::EmToEi::kParam:
            if (overtaken(*link, message.param().stop_generation()))
                return respond(message.param().request(), RefusalCode::OldGeneration,
                               "a stop has come since this parameter was sent; fix: send it again");
            return answer(message.param().request(), "onParameter", [&] {
                return decideParameter(message.param().service(), fromProto(message.param().param()));
            });
        case proto::EmToEi::kConfiguration:
            return onConfiguration(link, message.configuration());
        case proto::EmToEi::kResource:
            return answer(message.resource().request(), "onResource", [&] {
                const auto& request = message.resource();
                return callbacks_.resource
                           ? callbacks_.resource(request.service(), request.resource(), request.path())
                           : Decision::grant();
            });
        case proto::EmToEi::kTask:
            return onTask(link, message.task());
        case proto::EmToEi::kCancel:
            if (const auto task = tasks_.find(message.cancel().task_id())) task->cancel();
            return;
        case proto::EmToEi::kPause:
            if (const auto task = tasks_.find(message.pause().task_id())) {
                const bool resume = message.pause().resume();
                if (!resume) {
                    task->setPaused(true);
                    if (callbacks_.pause) guarded("onPause", [&] { callbacks_.pause(Task(task)); });
                    return;
                }
                unlessOvertaken(*link, message.pause().stop_generation(), [&] {
                    if (task->stopRequested()) return;
                    task->setPaused(false);
                    if (callbacks_.resume) guarded("onResume", [&] { callbacks_.resume(Task(task)); });
                });
            }
            return;
        case proto::EmToEi::kText:
            if (callbacks_.text)
                guarded("onText", [&] { callbacks_.text(message.text().text(), message.text().from()); });
            return;
        case proto::EmToEi::kRaw:
            if (!callbacks_.raw) return;
            return unlessOvertaken(*link, message.raw().stop_generation(), [&] {
                guarded("onRaw", [&] {
                    const auto& blocks = message.raw().data();
                    callbacks_.raw({blocks.begin(), blocks.end()}, message.raw().from());
                });
            });
        case proto::EmToEi::kStream:
            return channels_.switchTo(message.stream().on(), message.stream().stream());
        case proto::EmToEi::kNotSent:
            return onNotSent(message.not_sent());
        case proto::EmToEi::kProfileError: {
            const auto& said = message.profile_error();
            if (said.code() == proto::OK) return log(LogLevel::Info, said.message());
            const bool later = said.code() == proto::WRONG_STATE;
            return log(later ? LogLevel::Warning : LogLevel::Error,
                       std::string("the Entity Manager cannot use the profiles") + (later ? " now: " : ": ") +
                           said.message());
        }
        case proto::EmToEi::kHello:
        case proto::EmToEi::kBeat:
        case proto::EmToEi::kStop:
            return link->cut("a signal on the data connection");
        case proto::EmToEi::BODY_NOT_SET:
            return;  // of a later protocol: fields may be added
    }
}

Decision Communicator::decideParameter(const std::string& service, const Parameter& parameter) const {
    return callbacks_.parameter ? callbacks_.parameter(service, parameter) : Decision::grant();
}

void Communicator::onTask(const std::shared_ptr<Link>& link, const proto::TaskDispatch& dispatch) {
    const auto task = std::make_shared<Task::Running>(dispatch, link, level_);
    const auto refuse = [&](RefusalCode code, const std::string& message) {
        task->answer({code, message, {}});
    };
    if (task->id.empty()) return refuse(RefusalCode::Malformed, "task id: expected 16 bytes");
    if (tasks_.wasStarted(task->id))
        return refuse(RefusalCode::Duplicate, "a task with this id has been dispatched before");
    if (level_.stopped() > task->generation)
        return refuse(RefusalCode::OldGeneration,
                      "a stop has come since this task was requested; fix: request it again");
    // Its Entity Manager may not have heard of it yet.
    if (const auto why = statements_.whyNotTaken(task->service))
        return refuse(RefusalCode::InactiveService, *why);
    const auto own = callbacks_.tasks.find(task->service);
    const auto* handler = own != callbacks_.tasks.end() ? &own->second : &callbacks_.any_task;
    if (!*handler)
        return refuse(RefusalCode::UnknownService,
                      "the robot application has no handler for '" + task->service + "'; fix: add onTask(\"" +
                          task->service + "\", …) to it, or remove the service from its profile");
    for (const auto& given : dispatch.given()) {
        const auto of_task =
            given.param().values_size() > 0 ? std::nullopt : task->find(given.param().name());
        const auto parameter = of_task ? *of_task : fromProto(given.param());
        const auto which = "parameter '" + parameter.name + "' of '" + given.service() + "': ";
        auto decision = Decision::deny("onParameter threw an exception: the robot application has stopped");
        const auto deny = [&] { refuse(codeOf(decision), which + decision.reason()); };
        if (!guarded(
                "onParameter", [&] { decision = decideParameter(given.service(), parameter); }, deny))
            return;
        if (!decision.granted()) return deny();
    }
    if (callbacks_.task_request) {
        auto decision = Decision::deny("onTaskRequest threw an exception: the robot application has stopped");
        if (!guarded(
                "onTaskRequest", [&] { decision = callbacks_.task_request(Task(task)); },
                [&] { refuse(codeOf(decision), decision.reason()); }))
            return;
        if (!decision.granted()) return refuse(codeOf(decision), decision.reason());
    }
    tasks_.reap();
    const auto refusal = tasks_.start(task, [this, task, handler] { runTask(task, *handler); });
    if (!refusal.ok()) task->answer(refusal);
}

void Communicator::runTask(const std::shared_ptr<Task::Running>& running,
                           const EntityInterfacer::TaskHandler& handler) {
    this_thread_of = this;
    if (const auto refusal = running->waitForStart()) return running->answer(*refusal);
    running->answer({});
    Task task(running);
    try {
        handler(task);
        running->handlerReturned();
    } catch (const std::exception& error) {
        const std::string what = error.what();
        fault("an exception left the handler of '" + running->service + "' (" + what + ")",
              [&] { running->handlerThrew("an exception left the handler: " + what); });
    } catch (...) {
        fault("an exception left the handler of '" + running->service + "'",
              [&] { running->handlerThrew("an exception left the handler"); });
    }
}

}  // namespace axon
