// SPDX-License-Identifier: GPL-2.0-or-later
#include "axon/testing/laboratory.hpp"

#include <spdlog/spdlog.h>

#include <asio/thread_pool.hpp>
#include <list>
#include <mutex>
#include <utility>
#include <vector>

#include "client/core/content.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "messages/profile_reader.hpp"
#include "messages/profile_writer.hpp"
#include "server/server.hpp"
#include "testing/client/actor.hpp"
#include "testing/client/agenda.hpp"
#include "transport/ice/endpoint.hpp"

namespace axon::testing {

namespace {

using namespace std::chrono_literals;
using entity_manager::EntityManager;
using entity_manager::ServerCommunicators;
using Kind = Failure::Kind;

/// What a busy machine does not reach, and a program that hangs does.
constexpr Duration kWatchdog = 2s;

server::ServerSettings settings() {
    server::ServerSettings settings;
    for (auto* endpoint : {&settings.client_endpoint, &settings.client_signal_endpoint,
                           &settings.entity_endpoint, &settings.entity_signal_endpoint})
        *endpoint = "127.0.0.1:0";
    settings.front_end.watchdog_busy = kWatchdog;
    return settings;
}

/// Drops what Axon's servers log, and lets it through again at the end.
class Quiet {
  public:
    explicit Quiet(bool log) : logger_(log ? nullptr : spdlog::default_logger()) {
        if (!logger_) return;
        before_ = logger_->level();
        logger_->set_level(spdlog::level::off);
    }
    ~Quiet() {
        if (logger_) logger_->set_level(before_);
    }

  private:
    const std::shared_ptr<spdlog::logger> logger_;
    spdlog::level::level_enum before_ = spdlog::level::info;
};

template <class Message>
Message checked(const Reading<Message>& reading) {
    std::string errors;
    for (const auto& finding : reading.findings)
        if (finding.severity == Finding::Severity::Error) errors += "\n" + finding.toString();
    if (!errors.empty()) throw Failure(Kind::Misuse, "profiles without errors", "they have:" + errors);
    return reading.message;
}

std::string contentOf(const std::filesystem::path& file) {
    auto text = readProfileText(file, file.string());
    if (text.unreadable) throw Failure(Kind::Misuse, "a profile", text.unreadable->toString());
    return std::move(text.xml);
}

proto::CtrlParam declared(const client::Parameter& parameter) {
    proto::CtrlParam out;
    out.set_name(parameter.name);
    out.set_type(static_cast<proto::ParamType>(parameter.kind));
    out.set_data_type(static_cast<proto::DataType>(parameter.data_type));
    out.set_units(parameter.units);
    out.set_descr(parameter.descr);
    out.set_required(parameter.required);
    out.set_savable(parameter.savable);
    out.set_multiple(parameter.multiple);
    out.set_ready(!parameter.values.empty());
    for (const auto& value : parameter.values) *out.add_initial() = client::toProto(value);
    for (const auto& choice : parameter.choices) *out.add_choices() = client::toProto(choice);
    if (parameter.minimum) out.set_minimum(*parameter.minimum);
    if (parameter.maximum) out.set_maximum(*parameter.maximum);
    return out;
}
static_assert(static_cast<int>(client::ParameterKind::Feedback) == proto::FEEDBACK);
static_assert(static_cast<int>(client::DataType::Boolean) == proto::BOOL);

proto::ServicesProfile declared(const std::vector<client::Service>& services) {
    proto::ServicesProfile profile;
    for (const auto& service : services) {
        auto& out = *profile.add_services();
        out.set_name(service.name);
        out.set_global_id(service.global_id);
        out.set_type(service.kind == client::ServiceKind::Composite ? proto::CMPLX : proto::SMPL);
        out.set_descr(service.descr);
        out.set_notes(service.notes);
        out.set_is_active(service.active);
        out.set_is_blocking(service.blocking);
        out.set_is_pausable(service.pausable);
        for (const auto& part : service.parts) out.add_service_list(part);
        for (const auto& parameter : service.parameters) *out.add_params() = declared(parameter);
        for (const auto& resource : service.resources) {
            auto& one = *out.add_resources();
            one.set_name(resource.name);
            one.set_descr(resource.descr);
            one.set_required(resource.required);
            one.set_savable(resource.savable);
            one.set_url(resource.name);
        }
    }
    return profile;
}

/// One Entity Manager of an entity, with the threads and connections that are its alone, so that it can go
/// as a machine goes that is switched off.
class Life {
  public:
    Life(Actor& actor, const entity_manager::ServerAddress& server, const Clock& clock, RandomSource& random)
        : actor_(actor), ice_(std::make_shared<ServerCommunicators>(1, 1)) {
        entity_manager::EntityManagerCoreSettings core;
        core.application = actor.name();
        core.server_watchdog_busy = kWatchdog;
        manager_ = EntityManager::create(executor_.get_executor(), ice_, std::move(core), server,
                                         actor.backEnd(), clock, random, actor.store(), actor.store());
        manager_->start();
    }
    ~Life() {
        manager_->stop();
        actor_.unwire();
        ice_->destroy();  // its threads post to the executor
        executor_.join();
        manager_.reset();
    }
    void loseServer() { ice_->destroy(); }

  private:
    Actor& actor_;
    asio::thread_pool executor_{1};
    const std::shared_ptr<ServerCommunicators> ice_;
    std::shared_ptr<EntityManager> manager_;
};

}  // namespace

/// What a Laboratory consists of.
class Stage {
  public:
    explicit Stage(Laboratory::Options options)
        : options_(options), quiet_(options.log), server_(settings()) {
        const auto at = transport::parseEndpoint(server_.entityAddress(Lane::Data));
        entities_at_ = {at.host, at.port, "", ""};
        address_ = server_.clientAddress(Lane::Data);
        client::Options own;
        own.server = address_;
        own.direct = false;
        auto connected = client::Client::connect(std::move(own));
        if (!connected)
            throw Failure(Kind::Misuse, "a laboratory in this process", connected.refusal().message);
        observer_ = std::move(connected).value();
    }
    ~Stage() {
        agenda_->end();
        for (auto& [actor, life] : lives_) {
            actor->go = {};
            actor->come = {};
        }
        lives_.clear();
    }

    std::shared_ptr<Actor> add(ActorProfiles profiles) {
        for (const auto& [actor, life] : lives_)
            if (actor->name() == profiles.basic_read.name())
                throw Failure(Kind::Misuse, "a name that no other entity has",
                              "there is a '" + actor->name() + "' already");
        auto actor = std::make_shared<Actor>(std::move(profiles), agenda_, options_.patience);
        auto& place = [&]() -> auto& {
            const std::lock_guard lock(mutex_);
            return lives_.emplace_back(actor, nullptr);
        }
        ();
        actor->go = [this, &place](Actor::Going how) {
            if (place.second && how == Actor::Going::WithoutAWord) place.second->loseServer();
            place.second.reset();
        };
        actor->come = [this, &place] {
            if (!place.second)
                place.second = std::make_unique<Life>(*place.first, entities_at_, clock_, random_);
            await(place.first->name());
        };
        actor->come();
        return actor;
    }
    void await(const std::string& name) const {
        const auto found = observer_->waitFor(name, client::Seconds(options_.patience));
        if (!found)
            throw Failure(Kind::NotInTime,
                          "'" + name + "' in the laboratory within " +
                              std::to_string(options_.patience.count()) + " ms",
                          found.refusal().message);
    }
    Agenda& agenda() { return *agenda_; }
    const std::string& address() const { return address_; }

  private:
    void settle() {
        std::vector<std::shared_ptr<Actor>> actors;
        {
            const std::lock_guard lock(mutex_);
            for (const auto& [actor, life] : lives_) actors.push_back(actor);
        }
        for (const auto& actor : actors) actor->settle();
    }

    const Laboratory::Options options_;
    const Quiet quiet_;
    const SteadyClock clock_;
    SystemRandom random_;
    server::Server server_;
    entity_manager::ServerAddress entities_at_;
    std::string address_;
    std::unique_ptr<client::Client> observer_;
    std::mutex mutex_;  // of the list, not of what is in it; its places stay where they are
    std::list<std::pair<std::shared_ptr<Actor>, std::unique_ptr<Life>>> lives_;
    const std::shared_ptr<Agenda> agenda_ = std::make_shared<Agenda>(options_.passing, [this] { settle(); });
};

Laboratory::Laboratory() : Laboratory(Options{}) {}
Laboratory::Laboratory(Options options) try : stage_(std::make_shared<Stage>(options)) {
} catch (const Failure&) {
    throw;
} catch (const std::exception& error) {
    throw Failure(Kind::Misuse, "a laboratory in this process", error.what());
}
Laboratory::~Laboratory() = default;

const std::string& Laboratory::server() const {
    return stage_->address();
}
client::Options Laboratory::clientOptions() const {
    client::Options options;
    options.server = server();
    return options;
}

ScriptedEntity Laboratory::add(const std::filesystem::path& basic_profile,
                               const std::filesystem::path& services_profile) {
    ActorProfiles profiles;
    profiles.basic = contentOf(basic_profile);
    profiles.services = contentOf(services_profile);
    profiles.basic_name = basic_profile.string();
    profiles.services_name = services_profile.string();
    profiles.basic_read = checked(readBasicProfile(profiles.basic, profiles.basic_name));
    profiles.services_read = checked(readServicesProfile(profiles.services, profiles.services_name));
    return ScriptedEntity(stage_->add(std::move(profiles)));
}

ScriptedEntity Laboratory::add(std::string_view name, const std::vector<client::Service>& services,
                               std::string_view category, std::string_view type) {
    proto::Category is{};
    proto::Mobility moves{};
    if (!proto::Category_Parse(std::string(category), &is) ||
        !proto::Mobility_Parse(std::string(type), &moves))
        throw Failure(Kind::Misuse, "ROBOT or MACHINE, and MOBILE or STATIONARY",
                      "'" + std::string(name) + "' is " + std::string(category) + "/" + std::string(type));
    proto::BasicProfile basic;
    basic.set_name(std::string(name));
    basic.set_category(is);
    basic.set_type(moves);
    ActorProfiles profiles;
    profiles.basic = writeBasicProfile(basic);
    profiles.services = writeServicesProfile(declared(services));
    profiles.basic_name = std::string(name) + ", as the test describes it";
    profiles.services_name = profiles.basic_name;
    profiles.basic_read = checked(readBasicProfile(profiles.basic, profiles.basic_name));
    profiles.services_read = checked(readServicesProfile(profiles.services, profiles.services_name));
    return ScriptedEntity(stage_->add(std::move(profiles)));
}

void Laboratory::advance(client::Seconds time) {
    stage_->agenda().advance(std::chrono::duration_cast<Duration>(time));
}
client::Seconds Laboratory::elapsed() const {
    return stage_->agenda().now();
}

const std::string& ScriptedEntity::name() const {
    return actor_->name();
}
void ScriptedEntity::on(std::string_view service, Script script) {
    actor_->on(service, [script = std::move(script)](const Request&) { return script; });
}
void ScriptedEntity::on(std::string_view service, std::function<Script(const Request&)> script) {
    actor_->on(service, std::move(script));
}
void ScriptedEntity::denyParameter(std::string_view service, std::string_view parameter, std::string reason) {
    actor_->denyParameter(service, parameter, std::move(reason));
}
void ScriptedEntity::reportStandstill(client::Seconds after) {
    actor_->reportStandstill(after);
}
void ScriptedEntity::confirmStops(bool confirm) {
    actor_->confirmStops(confirm);
}
void ScriptedEntity::setServiceActive(std::string_view service, bool active, std::string reason) {
    proto::EiToEm message;
    message.mutable_active()->set_service(actor_->service(service).name());
    message.mutable_active()->set_active(active);
    message.mutable_active()->set_reason(std::move(reason));
    actor_->say(std::move(message));
}
void ScriptedEntity::setPosition(double x_mm, double y_mm, double z_mm) {
    proto::EiToEm message;
    message.mutable_position()->set_xpos(x_mm);
    message.mutable_position()->set_ypos(y_mm);
    message.mutable_position()->set_zpos(z_mm);
    actor_->say(std::move(message));
}
void ScriptedEntity::sendText(std::string text) {
    proto::EiToEm message;
    message.mutable_text()->set_text(std::move(text));
    actor_->say(std::move(message));
}
void ScriptedEntity::sendRaw(std::string bytes) {
    proto::EiToEm message;
    message.mutable_raw()->add_data(std::move(bytes));
    actor_->say(std::move(message));
}
void ScriptedEntity::sendSample(std::string stream, std::vector<double> numbers, std::string units) {
    actor_->sample(std::move(stream), std::move(numbers), std::move(units));
}
void ScriptedEntity::loseApplication(std::string reason) {
    actor_->loseLink(reason);
}
void ScriptedEntity::restoreApplication() {
    actor_->link();
}
void ScriptedEntity::leave() {
    if (actor_->go) actor_->go(Actor::Going::InOrder);
}
void ScriptedEntity::lose() {
    if (actor_->go) actor_->go(Actor::Going::WithoutAWord);
}
void ScriptedEntity::join() {
    if (actor_->come) actor_->come();
}
Request ScriptedEntity::expectTask(std::string_view service) {
    return actor_->expectTask(service);
}
std::string ScriptedEntity::expectStop() {
    return actor_->expectStop();
}
std::string ScriptedEntity::expectText() {
    return actor_->expectText();
}
std::string ScriptedEntity::expectRaw() {
    return actor_->expectRaw();
}
std::string ScriptedEntity::uploaded(std::string_view service, std::string_view resource) const {
    const auto& its = actor_->service(service);
    auto content = actor_->store().content(its.name(), resource);
    if (!content)
        throw Failure(
            Kind::Otherwise,
            "an upload of '" + std::string(resource) + "' for '" + its.name() + "' of '" + name() + "'",
            "there was none");
    return std::move(*content);
}

}  // namespace axon::testing
