// SPDX-License-Identifier: MIT
#include "testing/entity/axon/testing/scripted_manager.hpp"

#include <arpa/inet.h>
#include <axon/link.pb.h>

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <set>
#include <thread>
#include <utility>

#include "common/axon/refusal.hpp"
#include "common/ids.hpp"
#include "common/utf8.hpp"
#include "messages/profile_reader.hpp"
#include "messages/values.hpp"
#include "testing/entity/link_connection.hpp"
#include "testing/entity/step_clock.hpp"

namespace axon::testing {

namespace {

using namespace std::chrono_literals;
using Kind = Failure::Kind;
constexpr std::size_t kKept = 16384;   // messages of the application; then the oldest are forgotten
constexpr auto kSoon = 20ms;           // what needs no time of the clock comes within this
constexpr Duration kStepMost = 100ms;  // of the clock, while an expectation waits
constexpr auto kDrill = 200ms;         // an application that does not answer runs its stop callback
constexpr std::size_t kToldOfTask = 6;

std::string named(std::string_view text) {
    return "'" + std::string(text) + "'";
}

proto::Param toProto(const Parameter& parameter) {
    proto::Param out;
    out.set_name(parameter.name);
    out.set_units(parameter.units);
    for (const auto& value : parameter.values) {
        auto& one = *out.add_values();
        if (const auto* whole = std::get_if<std::int64_t>(&value)) one.set_int_(*whole);
        if (const auto* number = std::get_if<double>(&value)) one.set_dbl(*number);
        if (const auto* text = std::get_if<std::string>(&value)) one.set_str(*text);
        if (const auto* flag = std::get_if<bool>(&value)) one.set_bool_(*flag);
    }
    return out;
}

std::vector<Value> valuesOf(const proto::Param& param) {
    std::vector<Value> values;
    for (const auto& value : param.values()) {
        switch (value.kind_case()) {
            case proto::Value::kInt:
                values.emplace_back(std::int64_t{value.int_()});
                break;
            case proto::Value::kDbl:
                values.emplace_back(value.dbl());
                break;
            case proto::Value::kStr:
                values.emplace_back(value.str());
                break;
            case proto::Value::kBool:
                values.emplace_back(value.bool_());
                break;
            case proto::Value::KIND_NOT_SET:
                break;
        }
    }
    return values;
}

std::string stateOf(const proto::TaskEvent& event) {
    const auto& name = proto::TaskState_Name(event.state());
    return name.substr(name.find('_') + 1);
}

bool isEnd(const proto::TaskEvent& event) {
    return event.state() >= proto::TASK_SUCCEEDED;
}

std::string codeOf(const proto::Refusal& refusal) {
    return std::string(refusalName(static_cast<RefusalCode>(refusal.code())));
}

Answer answerOf(const proto::Refusal& refusal) {
    if (refusal.code() == proto::OK) return {true, {}, {}};
    return {false, codeOf(refusal), refusal.message()};
}

std::string describe(const proto::TaskEvent& event) {
    std::string text = isEnd(event) ? "it ended " + stateOf(event) : std::string();
    const auto add = [&](const std::string& more) { text += (text.empty() ? "" : ", ") + more; };
    if (event.has_reason() && !event.reason().message().empty()) add(event.reason().message());
    if (!isEnd(event) && event.progress() >= 0) add("progress " + std::to_string(event.progress()));
    if (!event.feedback().empty()) add("feedback " + named(event.feedback()));
    for (const auto& result : event.results())
        add("result " + named(result.name()) +
            (result.values_size() > 0 ? " = " + toText(result.values(0)) : std::string()));
    return text.empty() ? "a report without content" : text;
}

template <class Message>
void noteErrors(std::string& errors, const std::optional<Reading<Message>>& reading) {
    if (!reading) return;
    for (const auto& finding : reading->findings)
        if (finding.severity == Finding::Severity::Error)
            errors += (errors.empty() ? "" : "\n") + finding.toString();
}

}  // namespace

/// What is behind a ScriptedManager and its tasks: the link, and all that the application has said.
class ScriptedManager::Desk : public std::enable_shared_from_this<Desk> {
  public:
    explicit Desk(Options options) : options_(std::move(options)) {
        in_addr address{};
        const bool ports = options_.port != 0 || options_.first_port <= options_.last_port;
        if (options_.application.empty()) misuse("an application's name", "Options::application is empty");
        if (!ports) misuse("a range of ports", "Options::first_port is above last_port");
        if (inet_pton(AF_INET, options_.address.c_str(), &address) != 1)
            misuse("an IPv4 address", "Options::address is " + named(options_.address));
        if (options_.watchdog < 20ms || options_.watchdog > 10s)
            misuse("a watchdog of 20 ms to 10 s",
                   "Options::watchdog is " + std::to_string(options_.watchdog.count()) + " ms");
        if (options_.clock) clock_ = options_.clock->clock_;
    }
    ~Desk() { close(); }

    [[noreturn]] static void misuse(const std::string& expected, const std::string& happened) {
        throw Failure(Kind::Misuse, expected, happened);
    }

    Registration connect() {
        close();
        {
            const std::lock_guard lock(mutex_);
            basic_.reset();
            services_.reset();
            inactive_.clear();
            closed_.reset();
        }
        LinkTarget target{options_.application, options_.instance,  options_.address,
                          options_.first_port,  options_.last_port, options_.watchdog};
        if (options_.port != 0) target.first_port = target.last_port = options_.port;
        link_ = std::make_unique<LinkConnection>(
            target, generation_,
            LinkConnection::Events{[this](const proto::EiToEm& message) { arrived(message); },
                                   [this](const std::string& why) { closed(why); }},
            options_.patience);
        if (clock_)
            follows_ = clock_->follow([desk = weak_from_this()] {
                if (const auto self = desk.lock()) self->keepUp();
            });
        await<bool>("profiles", "both profiles of " + named(options_.application), [](const auto& message) {
            return message.has_profile() ? std::optional(true) : std::nullopt;
        });
        waitUntil([this] { return basic_ && services_; },
                  [this] {
                      return "both profiles of " + named(options_.application) + "; " +
                             (services_ ? "uploadBasicProfile()" : "uploadServiceProfile()") +
                             " has not been called";
                  });
        const std::lock_guard lock(mutex_);
        std::string errors;
        noteErrors(errors, basic_);
        noteErrors(errors, services_);
        if (!errors.empty())
            throw Failure(Kind::Otherwise, "profiles without errors", "they have:\n" + errors);
        configure(nullptr, nullptr);
        return registration();
    }
    void close() {
        follows_.reset();
        link_.reset();
        const std::lock_guard lock(mutex_);
        if (!closed_) closed_ = LinkEnding{"the test has disconnected", false};
    }
    void silence() {
        follows_.reset();
        link().setBeating(false);
    }
    bool linked() const {
        const std::lock_guard lock(mutex_);
        return link_ && !closed_;
    }
    LinkConnection& link() {
        if (!link_) misuse("a link", "connect() has not been called since");
        return *link_;
    }
    void sendData(const proto::EmToEi& message) { link().sendData(message); }
    std::uint32_t generation() const { return generation_; }
    std::uint64_t nextRequest() { return ++requests_; }

    /// The next message of which `take` makes something, counted for each `key`. `hopeless`, under the mutex:
    /// why it cannot come any more.
    template <class T>
    T await(const std::string& key, const std::string& expected,
            const std::function<std::optional<T>(const proto::EiToEm&)>& take,
            const std::function<std::optional<std::string>()>& hopeless = {}) {
        std::optional<T> taken;
        const auto look = [&] {
            auto& at = cursors_[key];
            at = std::max(at, first_);
            while (!taken && at < first_ + messages_.size()) taken = take(messages_[at++ - first_]);
            return taken.has_value();
        };
        waitUntil(
            look, [&] { return expected; }, hopeless);
        return std::move(*taken);
    }

    /// Until it holds, which is looked at under the mutex.
    void waitUntil(const std::function<bool()>& holds, const std::function<std::string()>& expected,
                   const std::function<std::optional<std::string>()>& hopeless = {}) {
        const auto real_end = std::chrono::steady_clock::now() + options_.patience;
        const auto clock_end = clock_ ? clock_->now() + options_.patience : TimePoint{};
        const auto soon = std::chrono::steady_clock::now() + kSoon;
        std::unique_lock lock(mutex_);
        while (!holds()) {
            if (const auto why = hopeless ? hopeless() : std::nullopt)
                throw Failure(Kind::Otherwise, expected(), *why);
            if (closed_) throw Failure(Kind::LinkLost, expected(), "the link has ended: " + closed_->reason);
            const auto now = std::chrono::steady_clock::now();
            const bool late = clock_ ? now >= soon && clock_->now() >= clock_end : now >= real_end;
            if (late)
                throw Failure(Kind::NotInTime,
                              expected() + " within " + std::to_string(options_.patience.count()) + " ms",
                              "it did not come");
            if (clock_ && now >= soon) {
                lock.unlock();
                clock_->step(kStepMost);
                lock.lock();
            } else {
                changed_.wait_until(lock, clock_ ? soon : real_end);
            }
        }
    }

    proto::EmToEi dispatch(const std::string& id, std::string_view name,
                           const std::vector<Parameter>& parameters) {
        const std::lock_guard lock(mutex_);
        const auto& service = this->service(name);
        if (service.type() == proto::CMPLX)
            misuse("a simple service", named(name) + " is composite: run its parts");
        const auto inactive = inactive_.find(service.name());
        if (!service.is_active() || inactive != inactive_.end())
            throw Failure(Kind::Refused, named(name) + " to be active",
                          "it is switched off" +
                              (inactive == inactive_.end() ? std::string() : ": " + inactive->second));
        proto::EmToEi message;
        auto& task = *message.mutable_task();
        task.set_task_id(id);
        task.set_service(service.name());
        task.set_stop_generation(generation_);
        std::set<std::string> given;
        for (const auto& parameter : parameters) {
            const auto accepted = accept(service, parameter);
            if (!given.insert(accepted.name()).second)
                misuse("each parameter once", named(accepted.name()) + " is given twice");
            auto& one = *task.add_given();
            one.set_service(service.name());
            one.mutable_param()->set_name(accepted.name());
            *task.add_params() = accepted;
        }
        std::string lacks;
        for (const auto& meta : service.params()) {
            if (!settable(meta) || given.contains(meta.name())) continue;
            if (const auto param = standing(service, meta))
                *task.add_params() = *param;
            else if (meta.required())
                lacks += (lacks.empty() ? "" : ", ") + named(meta.name());
        }
        for (const auto& meta : service.resources()) {
            auto path = standingFile(service, meta);
            if (!path.empty()) {
                auto& one = *task.add_resources();
                one = meta;
                one.set_url(path);
                one.set_ready(true);
            } else if (meta.required()) {
                lacks += (lacks.empty() ? "" : ", ") + named(meta.name());
            }
        }
        if (!lacks.empty())
            throw Failure(Kind::Refused, "all that " + named(name) + " requires",
                          "it still needs " + lacks + " (MISSING_DEPENDENCY)");
        return message;
    }

    Answer setParameter(std::string_view name, const Parameter& parameter) {
        proto::EmToEi message;
        auto& asked = *message.mutable_param();
        asked.set_request(nextRequest());
        asked.set_stop_generation(generation_);
        {
            const std::lock_guard lock(mutex_);
            const auto& service = this->service(name);
            asked.set_service(service.name());
            *asked.mutable_param() = accept(service, parameter);
        }
        const auto answer = ask(message, asked.request(), "an answer to parameter " + named(parameter.name));
        if (!answer.granted) return answer;
        const std::lock_guard lock(mutex_);
        const auto& service = this->service(name);
        const auto& meta = service.params(findParamIndex(service, asked.param().name()).value());
        values_[{service.name(), meta.name()}] = asked.param();
        if (meta.type() == proto::CONFIG) configure(&service, &meta);
        return answer;
    }

    Answer upload(std::string_view name, std::string_view resource, const std::filesystem::path& file) {
        std::error_code missing;
        const auto size = std::filesystem::file_size(file, missing);
        if (missing) misuse("a file to upload", file.string() + ": " + missing.message());
        proto::EmToEi message;
        auto& asked = *message.mutable_resource();
        asked.set_request(nextRequest());
        asked.set_path(std::filesystem::absolute(file).string());
        asked.set_size(size);
        {
            const std::lock_guard lock(mutex_);
            const auto& service = this->service(name);
            const auto at = findResourceIndex(service, resource);
            if (!at) throw Failure(Kind::Refused, "a resource of " + named(name), at.refusal().message);
            asked.set_service(service.name());
            asked.set_resource(service.resources(at.value()).name());
        }
        const auto answer = ask(message, asked.request(), "an answer to resource " + named(resource));
        const std::lock_guard lock(mutex_);
        if (answer.granted) files_[{asked.service(), asked.resource()}] = asked.path();
        return answer;
    }

    StopDone stop(StopSignal::Cause cause) {
        proto::EmToEi message;
        const auto generation = ++generation_;
        message.mutable_stop()->set_stop_generation(generation);
        message.mutable_stop()->set_cause(static_cast<proto::StopCause>(cause));
        link().setGeneration(generation);
        link().sendSignal(message);
        return await<StopDone>(
            "stop", "the stop callback to return", [&](const proto::EiToEm& said) -> std::optional<StopDone> {
                if (!said.has_stop_done() || said.stop_done().stop_generation() != generation) return {};
                if (!said.stop_done().fault().empty())
                    throw Failure(Kind::Otherwise, "the stop callback to return",
                                  "it threw: " + said.stop_done().fault());
                if (said.stop_done().stage() != proto::StopReceipt::CALLBACK_RETURNED) return {};
                return StopDone{generation, said.stop_done().standstill_follows()};
            });
    }

    LinkEnding expectLinkEnded() {
        std::optional<LinkEnding> ended;
        const auto real_end = std::chrono::steady_clock::now() + options_.patience;
        const auto clock_end = clock_ ? clock_->now() + options_.patience : TimePoint{};
        std::unique_lock lock(mutex_);
        while (!closed_) {
            if (clock_ ? clock_->now() >= clock_end : std::chrono::steady_clock::now() >= real_end)
                throw Failure(Kind::NotInTime,
                              "the application to end the link within " +
                                  std::to_string(options_.patience.count()) + " ms",
                              "it is still linked");
            changed_.wait_for(lock, clock_ ? kSoon / 4 : kSoon);
            if (!clock_ || closed_) continue;
            lock.unlock();
            clock_->step(kStepMost);
            lock.lock();
        }
        return *closed_;
    }

    std::string taskStory(const std::string& id) const {
        std::string story;
        const auto found = stories_.find(id);
        if (found != stories_.end())
            for (const auto& line : found->second) story += (story.empty() ? "" : "; ") + line;
        return story.empty() ? "nothing" : story;
    }
    /// Under the mutex: why nothing more can come of the task.
    std::optional<std::string> taskOver(const std::string& id) const {
        if (!over_.contains(id)) return std::nullopt;
        return "what came was: " + taskStory(id);
    }
    std::map<std::string, std::vector<Value>> resultsOf(const std::string& id) const {
        const std::lock_guard lock(mutex_);
        const auto found = results_.find(id);
        return found == results_.end() ? std::map<std::string, std::vector<Value>>() : found->second;
    }
    std::string newTaskId() { return Id128::random(random_).bytes(); }

  private:
    static bool settable(const proto::CtrlParam& meta) {
        return meta.type() == proto::INPUT || meta.type() == proto::CONFIG;
    }
    // The rest of this part: under the mutex.
    const proto::Service& service(std::string_view name) const {
        if (!services_) misuse("a link", "connect() has not been called");
        const auto at = findServiceIndex(services_->message, name);
        if (!at)
            throw Failure(Kind::Refused, "a service of " + named(options_.application), at.refusal().message);
        return services_->message.services(at.value());
    }
    static proto::Param accept(const proto::Service& service, const Parameter& parameter) {
        const auto expected = "a value for " + named(parameter.name) + " of " + named(service.name());
        const auto at = findParamIndex(service, parameter.name);
        if (!at) throw Failure(Kind::Refused, expected, at.refusal().message);
        const auto& meta = service.params(at.value());
        if (!settable(meta)) throw Failure(Kind::Refused, expected, "it is reported by the application");
        auto accepted = acceptParam(meta, toProto(parameter));
        if (!accepted) throw Failure(Kind::Refused, expected, accepted.refusal().message);
        accepted.value().set_name(meta.name());
        accepted.value().set_units(meta.units());
        return accepted.value();
    }
    std::optional<proto::Param> standing(const proto::Service& service, const proto::CtrlParam& meta) const {
        const auto set = values_.find({service.name(), meta.name()});
        if (set != values_.end()) return set->second;
        if (!meta.ready()) return std::nullopt;
        proto::Param param;
        param.set_name(meta.name());
        param.set_units(meta.units());
        *param.mutable_values() = meta.initial();
        return param;
    }
    std::string standingFile(const proto::Service& service, const proto::Resource& meta) const {
        const auto uploaded = files_.find({service.name(), meta.name()});
        if (uploaded != files_.end()) return uploaded->second;
        const auto path = std::filesystem::path(folder_) / meta.url();
        std::error_code ignored;
        return !meta.url().empty() && std::filesystem::is_regular_file(path, ignored) ? path.string()
                                                                                      : std::string();
    }
    /// Tells one CONFIG value, or all.
    void configure(const proto::Service* only, const proto::CtrlParam* which) {
        proto::EmToEi message;
        auto& configuration = *message.mutable_configuration();
        for (const auto& service : services_->message.services())
            for (const auto& meta : service.params()) {
                if (meta.type() != proto::CONFIG || (only != nullptr && (only != &service || which != &meta)))
                    continue;
                const auto param = standing(service, meta);
                if (!param) continue;
                auto& one = *configuration.add_params();
                one.set_service(service.name());
                *one.mutable_param() = *param;
                for (const auto& [id, running] : running_)
                    if (only != nullptr && running == service.name()) configuration.set_task_id(id);
            }
        if (configuration.params_size() > 0) sendData(message);
    }
    Registration registration() const {
        const auto& basic = basic_->message;
        Registration out{basic.name(),
                         proto::Category_Name(basic.category()),
                         proto::Mobility_Name(basic.type()),
                         basic.descr(),
                         {}};
        for (const auto& service : services_->message.services()) out.services.push_back(service.name());
        return out;
    }

    Answer ask(const proto::EmToEi& message, std::uint64_t request, const std::string& expected) {
        sendData(message);
        return await<Answer>("answer", expected, [request](const proto::EiToEm& said) {
            return said.has_answer() && said.answer().request() == request
                       ? std::optional(answerOf(said.answer().refusal()))
                       : std::nullopt;
        });
    }

    // On the thread of the link.
    void arrived(const proto::EiToEm& message) {
        const std::lock_guard lock(mutex_);
        if (message.has_profile()) {
            const auto& upload = message.profile();
            if (upload.services()) {
                services_ = readServicesProfile(upload.xml(), upload.file_name());
                folder_ = upload.folder();
            } else {
                basic_ = readBasicProfile(upload.xml(), upload.file_name());
            }
        }
        if (message.has_active()) {
            if (message.active().active())
                inactive_.erase(message.active().service());
            else
                inactive_[message.active().service()] = message.active().reason();
        }
        if (message.has_task_answer()) {
            const auto answer = answerOf(message.task_answer().refusal());
            const auto& id = message.task_answer().task_id();
            if (!answer.granted) end(id);
            tell(id, answer.granted ? "granted" : "denied, " + answer.code + ": " + answer.reason);
        }
        if (message.has_task()) {
            const auto& event = message.task().event();
            for (const auto& result : event.results()) {
                auto& values = results_[event.task_id()];
                values[result.name()] = valuesOf(result);
            }
            if (isEnd(event)) end(event.task_id());
            tell(event.task_id(), describe(event));
        }
        if (message.has_end()) ended_stopped_ = message.end().stopped();
        messages_.push_back(message);
        if (messages_.size() > kKept) {
            messages_.pop_front();
            ++first_;
        }
        changed_.notify_all();
    }
    void closed(const std::string& why) {
        const std::lock_guard lock(mutex_);
        closed_ = LinkEnding{why, std::exchange(ended_stopped_, false)};
        running_.clear();
        changed_.notify_all();
    }
    void tell(const std::string& id, const std::string& line) {
        auto& story = stories_[id];
        story.push_back(line);
        if (story.size() > kToldOfTask) story.pop_front();
    }
    void end(const std::string& id) {
        over_.insert(id);
        running_.erase(id);
    }

    /// Before the clock goes on: the application has heard a beat at the present time, as it answers a drill
    /// on the thread that hears beats.
    void keepUp() {
        if (!linked() || (clock_->now() - kept_up_) < options_.watchdog / 5) return;
        kept_up_ = clock_->now();
        proto::EmToEi message;
        const auto drill = ++drills_;
        message.mutable_stop()->set_cause(proto::STOP_DRILL);
        message.mutable_stop()->set_drill(drill);
        link().sendSignal(message);
        std::unique_lock lock(mutex_);
        changed_.wait_for(lock, kDrill, [&] {
            return closed_ || std::any_of(messages_.rbegin(), messages_.rend(), [&](const auto& said) {
                       return said.has_stop_done() && said.stop_done().drill() == drill;
                   });
        });
    }

  public:
    /// A task has been sent, and a CONFIG value of its service is its, too.
    void begun(const std::string& id, const std::string& service) {
        const std::lock_guard lock(mutex_);
        running_[id] = service;
    }
    mutable std::mutex mutex_;

  private:
    const Options options_;
    std::shared_ptr<StepClock> clock_;
    std::shared_ptr<void> follows_;
    TimePoint kept_up_{};
    SystemRandom random_;
    std::uint32_t generation_ = 0, drills_ = 0;
    std::uint64_t requests_ = 0;

    std::condition_variable changed_;
    // Guarded by mutex_:
    std::deque<proto::EiToEm> messages_;
    std::uint64_t first_ = 0;  // the number of messages_.front()
    std::map<std::string, std::uint64_t> cursors_;
    std::optional<Reading<proto::BasicProfile>> basic_;
    std::optional<Reading<proto::ServicesProfile>> services_;
    std::string folder_;
    std::map<std::string, std::string> inactive_;
    std::map<std::pair<std::string, std::string>, proto::Param> values_;
    std::map<std::pair<std::string, std::string>, std::string> files_;
    std::map<std::string, std::deque<std::string>> stories_;
    std::map<std::string, std::map<std::string, std::vector<Value>>> results_;
    std::map<std::string, std::string> running_;
    std::set<std::string> over_;
    std::optional<LinkEnding> closed_ = LinkEnding{"connect() has not been called", false};
    bool ended_stopped_ = false;

    std::unique_ptr<LinkConnection> link_;  // last: its thread uses all that is above
};

struct ScriptedTask::Shared {
    std::shared_ptr<ScriptedManager::Desk> desk;
    std::string id, text, service;

    template <class T>
    T await(const char* kind, const std::string& expected,
            const std::function<std::optional<T>(const proto::TaskEvent&)>& take) const {
        return desk->await<T>(
            id + kind, expected + " of " + named(service),
            [&](const proto::EiToEm& said) {
                return said.has_task() && said.task().event().task_id() == id ? take(said.task().event())
                                                                              : std::nullopt;
            },
            [&] { return desk->taskOver(id); });
    }
    Answer answer(const char* expected) const {
        return desk->await<Answer>(id + "answer", std::string(expected) + " of " + named(service),
                                   [&](const proto::EiToEm& said) {
                                       return said.has_task_answer() && said.task_answer().task_id() == id
                                                  ? std::optional(answerOf(said.task_answer().refusal()))
                                                  : std::nullopt;
                                   });
    }
};

const std::string& ScriptedTask::id() const {
    return shared_->text;
}
const std::string& ScriptedTask::service() const {
    return shared_->service;
}

void ScriptedTask::expectGranted() {
    const auto answer = shared_->answer("the application's consent to a task");
    if (!answer.granted)
        throw Failure(Kind::Otherwise, "a granted task of " + named(service()),
                      "it was denied, " + answer.code + ": " + answer.reason);
}

Answer ScriptedTask::expectDenied() {
    auto answer = shared_->answer("the application's denial of a task");
    if (answer.granted)
        throw Failure(Kind::Otherwise, "a denied task of " + named(service()), "it was granted");
    return answer;
}

std::string ScriptedTask::expectFeedback(std::string_view containing) {
    return shared_->await<std::string>(
        "feedback", "feedback" + (containing.empty() ? "" : " with " + named(containing)),
        [&](const proto::TaskEvent& event) {
            return !event.feedback().empty() && event.feedback().find(containing) != std::string::npos
                       ? std::optional(event.feedback())
                       : std::nullopt;
        });
}

double ScriptedTask::expectProgress(double at_least) {
    return shared_->await<double>(
        "progress", "progress of at least " + std::to_string(at_least), [&](const proto::TaskEvent& event) {
            return event.progress() >= at_least ? std::optional(event.progress()) : std::nullopt;
        });
}

std::vector<Value> ScriptedTask::expectResult(std::string_view name) {
    return shared_->await<std::vector<Value>>(
        ("result" + std::string(name)).c_str(), "result " + named(name),
        [&](const proto::TaskEvent& event) -> std::optional<std::vector<Value>> {
            for (const auto& result : event.results())
                if (result.name() == name) return valuesOf(result);
            return std::nullopt;
        });
}

Ending ScriptedTask::expectEnd(const char* state) {
    const auto expected = std::string("the end ") + state;
    auto ending = shared_->await<Ending>("end", expected, [](const proto::TaskEvent& event) {
        return isEnd(event) ? std::optional(Ending{stateOf(event), event.reason().message(), {}})
                            : std::nullopt;
    });
    if (ending.state != state)
        throw Failure(Kind::Otherwise, expected + " of " + named(service()),
                      "it ended " + ending.state + (ending.reason.empty() ? "" : ": " + ending.reason));
    ending.results = shared_->desk->resultsOf(shared_->id);
    return ending;
}

Ending ScriptedTask::expectSucceeded() {
    return expectEnd("SUCCEEDED");
}
Ending ScriptedTask::expectFailed() {
    return expectEnd("FAILED");
}
Ending ScriptedTask::expectStopped() {
    return expectEnd("STOPPED");
}
Ending ScriptedTask::expectCancelled() {
    return expectEnd("CANCELLED");
}

void ScriptedTask::pause() {
    proto::EmToEi message;
    message.mutable_pause()->set_task_id(shared_->id);
    message.mutable_pause()->set_stop_generation(shared_->desk->generation());
    shared_->desk->sendData(message);
}
void ScriptedTask::resume() {
    proto::EmToEi message;
    message.mutable_pause()->set_task_id(shared_->id);
    message.mutable_pause()->set_resume(true);
    message.mutable_pause()->set_stop_generation(shared_->desk->generation());
    shared_->desk->sendData(message);
}
void ScriptedTask::cancel() {
    proto::EmToEi message;
    message.mutable_cancel()->set_task_id(shared_->id);
    shared_->desk->sendData(message);
}

ScriptedManager::ScriptedManager(Options options) : desk_(std::make_shared<Desk>(std::move(options))) {}
ScriptedManager::~ScriptedManager() {
    desk_->close();
}

Registration ScriptedManager::connect() {
    return desk_->connect();
}
void ScriptedManager::disconnect() {
    desk_->close();
}
void ScriptedManager::silence() {
    desk_->silence();
}
bool ScriptedManager::linked() const {
    return desk_->linked();
}

ScriptedTask ScriptedManager::run(std::string_view service, const std::vector<Parameter>& parameters) {
    const auto id = desk_->newTaskId();
    const auto message = desk_->dispatch(id, service, parameters);
    const auto text = Id128::fromBytes(id)->toString();
    desk_->begun(id, message.task().service());
    desk_->sendData(message);
    return ScriptedTask(std::make_shared<ScriptedTask::Shared>(
        ScriptedTask::Shared{desk_, id, text, message.task().service()}));
}

Answer ScriptedManager::setParameter(std::string_view service, const Parameter& parameter) {
    return desk_->setParameter(service, parameter);
}
Answer ScriptedManager::upload(std::string_view service, std::string_view resource,
                               const std::filesystem::path& file) {
    return desk_->upload(service, resource, file);
}

void ScriptedManager::sendText(std::string_view text, std::string_view from) {
    proto::EmToEi message;
    message.mutable_text()->set_text(validUtf8(text));
    message.mutable_text()->set_from(validUtf8(from));
    desk_->sendData(message);
}
void ScriptedManager::sendRaw(const std::vector<std::string>& blocks, std::string_view from) {
    proto::EmToEi message;
    for (const auto& block : blocks) message.mutable_raw()->add_data(block);
    message.mutable_raw()->set_from(validUtf8(from));
    message.mutable_raw()->set_stop_generation(desk_->generation());
    desk_->sendData(message);
}
void ScriptedManager::wantStream(std::string_view stream, bool wanted) {
    proto::EmToEi message;
    auto& control = *message.mutable_stream();
    control.set_on(false);  // of all, which are on until somebody says otherwise
    desk_->sendData(message);
    control.set_stream(std::string(stream));
    control.set_on(wanted);
    desk_->sendData(message);
}

StopDone ScriptedManager::stop(StopSignal::Cause cause) {
    return desk_->stop(cause);
}
void ScriptedManager::expectStandstill() {
    desk_->await<bool>(
        "standstill", "a report that the robot stands still", [this](const proto::EiToEm& said) {
            return said.has_stop_done() && said.stop_done().stage() == proto::StopReceipt::STANDSTILL &&
                           said.stop_done().stop_generation() == desk_->generation()
                       ? std::optional(true)
                       : std::nullopt;
        });
}

std::string ScriptedManager::expectText(std::string_view containing) {
    return desk_->await<std::string>(
        "text", "a text" + (containing.empty() ? "" : " with " + named(containing)),
        [&](const proto::EiToEm& said) {
            return said.has_text() && said.text().text().find(containing) != std::string::npos
                       ? std::optional(said.text().text())
                       : std::nullopt;
        });
}
std::vector<std::string> ScriptedManager::expectRaw() {
    return desk_->await<std::vector<std::string>>(
        "raw", "raw data", [](const proto::EiToEm& said) -> std::optional<std::vector<std::string>> {
            if (!said.has_raw()) return std::nullopt;
            return std::vector<std::string>(said.raw().data().begin(), said.raw().data().end());
        });
}
StreamSample ScriptedManager::expectSample(std::string_view stream) {
    return desk_->await<StreamSample>(
        "sample" + std::string(stream), "a sample of " + named(stream),
        [&](const proto::EiToEm& said) -> std::optional<StreamSample> {
            const auto& sample = said.sample();
            if (!said.has_sample() || sample.stream() != stream) return std::nullopt;
            StreamSample out{sample.sequence(), {}, {}, {}};
            if (sample.has_scalar()) {
                out.numbers = {sample.scalar().value()};
                out.units = sample.scalar().units();
            } else if (sample.has_vector()) {
                out.numbers.assign(sample.vector().values().begin(), sample.vector().values().end());
                out.units = sample.vector().units();
            } else if (sample.has_pose()) {
                const auto& pose = sample.pose();
                out.numbers = {pose.x(), pose.y(), pose.z(), pose.roll(), pose.pitch(), pose.yaw()};
            } else if (sample.has_scan()) {
                out.numbers.assign(sample.scan().ranges().begin(), sample.scan().ranges().end());
                out.units = "m";
            } else if (sample.has_image()) {
                out.bytes = sample.image().pixels();
            } else {
                out.bytes = sample.raw();
            }
            return out;
        });
}
std::vector<double> ScriptedManager::expectPosition() {
    return desk_->await<std::vector<double>>(
        "position", "a position", [](const proto::EiToEm& said) -> std::optional<std::vector<double>> {
            if (!said.has_position()) return std::nullopt;
            return std::vector<double>{said.position().xpos(), said.position().ypos(),
                                       said.position().zpos()};
        });
}
std::string ScriptedManager::expectInactive(std::string_view service) {
    return desk_->await<std::string>("inactive" + std::string(service),
                                     named(service) + " to be switched off", [&](const proto::EiToEm& said) {
                                         return said.has_active() && !said.active().active() &&
                                                        said.active().service() == service
                                                    ? std::optional(said.active().reason())
                                                    : std::nullopt;
                                     });
}
void ScriptedManager::expectActive(std::string_view service) {
    desk_->await<bool>("active" + std::string(service), named(service) + " to be switched on",
                       [&](const proto::EiToEm& said) {
                           return said.has_active() && said.active().active() &&
                                          said.active().service() == service
                                      ? std::optional(true)
                                      : std::nullopt;
                       });
}
LinkEnding ScriptedManager::expectLinkEnded() {
    return desk_->expectLinkEnded();
}

}  // namespace axon::testing
