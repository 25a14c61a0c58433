// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "axon/testing/laboratory.hpp"
#include "entity_manager/entity_manager.hpp"
#include "testing/client/agenda.hpp"
#include "testing/client/memory_store.hpp"

namespace axon::testing {

/// What the Entity Managers that an entity has one after the other reach through a port each: where its
/// application is linked.
struct Wire {
    Wire(const entity_manager::EntityManager::Strand& its, entity_manager::BackEndEvents& whom)
        : strand(its), events(whom) {}
    entity_manager::EntityManager::Strand strand;
    entity_manager::BackEndEvents& events;  // of the Entity Manager, used on its strand
    std::atomic<bool> open{false};          // written on the strand
};

/// The two profiles of an entity, as its application uploads them.
struct ActorProfiles {
    std::string basic, services;            ///< XML
    std::string basic_name, services_name;  ///< of the files
    proto::BasicProfile basic_read;
    proto::ServicesProfile services_read;
};

/// A robot application that does what its scripts say: the other end of an Entity Manager's back end, in
/// memory. It outlives the Entity Managers of its entity.
///
/// Threads: any. Its mutex is held neither while a script's function runs nor while the Entity Manager is
/// told something, so stop() waits for nobody.
class Actor : public std::enable_shared_from_this<Actor> {
  public:
    Actor(ActorProfiles profiles, std::shared_ptr<Agenda> agenda, std::chrono::milliseconds patience);

    const std::string& name() const { return name_; }
    MemoryStore& store() { return store_; }

    /// The back end of its next Entity Manager.
    entity_manager::EntityManager::BackEndFactory backEnd();
    /// That Entity Manager ends: nothing more is said to it. Before its executor is joined.
    void unwire();
    /// What has been said so far has been handled, and what follows from it has been asked for.
    void settle();

    // What ScriptedEntity says.
    void on(std::string_view service, std::function<Script(const Request&)> script);
    void denyParameter(std::string_view service, std::string_view parameter, std::string reason);
    void reportStandstill(client::Seconds after);
    void confirmStops(bool confirm);
    void say(proto::EiToEm message);
    void sample(std::string stream, std::vector<double> numbers, std::string units);
    void loseLink(const std::string& reason);
    void link();
    Request expectTask(std::string_view service);
    std::string expectStop();
    std::string expectText();
    std::string expectRaw();
    const proto::Service& service(std::string_view name) const;

    // What its Entity Manager says.
    void heard(const proto::EmToEi& message);
    void stopped(std::uint32_t generation, StopCause cause);

    /// Of its entity: how it leaves, is lost and comes back. Set once by the laboratory, which may be gone.
    enum class Going : std::uint8_t { InOrder, WithoutAWord };
    std::function<void(Going)> go;
    std::function<void()> come;

  private:
    struct Running {
        Request request;
        std::vector<Script::Step> steps;
        std::size_t next = 0;
        std::uint64_t planned = 0;       // in the agenda; 0 = nothing
        Duration due{};                  // of the next step, in the agenda's time
        std::optional<Duration> paused;  // what was left until then
    };
    using Outbox = std::vector<proto::EiToEm>;

    void dispatched(const proto::TaskDispatch& task);
    void happen(const std::string& id);
    // Under the mutex. What is to be said is put into the outbox; the agenda is held until it has been said,
    // so that nothing that is planned here overtakes it.
    void play(const std::string& id, Running& task, Outbox& out);
    void plan(const std::string& id, Running& task, Duration in);
    void end(const std::string& id, proto::TaskState state, const Refusal& reason, Outbox& out);
    void acknowledge(std::uint32_t generation, Outbox& out);
    void pause(const proto::PauseTask& pause, Outbox& out);
    std::optional<std::string> denial(const std::string& service, const proto::Param& param) const;

    void sayAll(const Outbox& out);
    /// False if there is no Entity Manager.
    bool onStrand(std::function<void(Wire&)> use);
    template <class T>
    T next(std::vector<T>& all, std::size_t& at, const std::string& expected,
           const std::function<bool(const T&)>& wanted = {});

    const ActorProfiles profiles_;
    const std::string name_;
    const std::shared_ptr<Agenda> agenda_;
    const std::chrono::milliseconds patience_;
    MemoryStore store_;

    std::mutex wire_mutex_;  // held for a post
    std::shared_ptr<Wire> wire_;

    mutable std::mutex mutex_;
    std::condition_variable changed_;
    // Guarded by mutex_:
    std::map<std::string, std::function<Script(const Request&)>> scripts_;
    std::map<std::pair<std::string, std::string>, std::string> denied_;
    std::optional<Duration> standstill_after_;
    bool confirms_ = true;
    std::optional<std::uint32_t> owed_;  // the generation of a stop that is not confirmed yet
    std::uint32_t generation_ = 0;
    std::map<std::string, Running> running_;
    std::map<std::string, std::uint64_t> samples_;
    std::vector<Request> requests_;
    std::vector<std::string> stops_, texts_, raws_;
    std::map<std::string, std::size_t> requests_seen_;
    std::size_t stops_seen_ = 0, texts_seen_ = 0, raws_seen_ = 0;
};

}  // namespace axon::testing
