// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_manager/core/entity_manager_core.hpp"

namespace axon::test {

/// The profiles of the entity that the core's tests use.
extern const char* const kRigBasicProfile;
extern const char* const kRigServicesProfile;

/// Storage in memory; outlives a core, so that a restart can be played.
class MemoryStorage final : public entity_manager::Storage {
  public:
    std::optional<std::string> load(std::string_view key) override;
    void save(std::string_view key, std::string_view value) override;
    void keep(std::string_view key, std::string_view value) override;
    void forget(std::string_view key) override;
    std::map<std::string, std::string, std::less<>> values;
    bool full = false;  ///< what is to be kept does not come to the disk
    struct Write {
        std::string key;
        std::optional<std::string> value;  ///< none: deleted
        bool waited = false;               ///< it was on the disk when save() returned
    };
    std::vector<Write> writes;  ///< all that was wanted, in its order
};

/// What a store in memory answers: at once, or, as a slow disk, when the test lets it (answerAll()).
class Answers {
  public:
    bool slow = false;
    /// And says so to nobody: the test calls EntityManagerCore::onStored().
    void answerAll() {
        for (const auto& answer : std::exchange(waiting_, {})) answer();
    }

  protected:
    template <class T>
    entity_manager::Later<T> answer(std::function<T()> work) {
        if (!slow) return work();
        const auto later = entity_manager::Later<T>::pending();
        waiting_.push_back([later, work = std::move(work)] { later.set(work()); });
        return later;
    }

  private:
    std::vector<std::function<void()>> waiting_;
};

/// A journal in memory; outlives a core too.
class MemoryJournal final : public entity_manager::Journal, public Answers {
  public:
    bool append(const entity_manager::JournalRecord& record) override;
    entity_manager::Later<bool> appendDispatch(const entity_manager::JournalRecord& record) override;
    void mention(const entity_manager::JournalRecord& record) override { mentioned.push_back(record); }
    void replay(const std::function<void(const entity_manager::JournalRecord&)>& each) override;
    std::vector<entity_manager::JournalRecord> records, mentioned;
    bool full = false;  ///< takes nothing more
};

/// Resources in memory. Its "SHA-256" is fakeHash().
class MemoryResources final : public entity_manager::ResourceStore, public Answers {
  public:
    static std::string fakeHash(std::string_view content);
    entity_manager::Later<Result<std::uint64_t>> begin(const proto::ResourceOffer& offer,
                                                       const std::string& owner) override;
    Result<void> write(std::string_view transfer_id, std::uint64_t offset, std::string_view content) override;
    Result<std::uint64_t> waiting(std::string_view transfer_id) const override;
    entity_manager::Later<Result<std::string>> check(std::string_view transfer_id) override;
    entity_manager::Later<Result<std::string>> place(std::string_view transfer_id) override;
    void suspend(std::string_view transfer_id) override;
    void drop(std::string_view transfer_id) override;
    void remove(std::string_view service, std::string_view resource) override;
    std::optional<std::string> find(std::string_view service, std::string_view resource) override;
    entity_manager::Later<std::vector<entity_manager::ResourcePlace>> locate(
        const entity_manager::ResourceRoots& roots,
        std::vector<entity_manager::ResourceQuery> queries) override;
    entity_manager::Later<std::vector<std::string>> absent(std::vector<std::string> files) override;

    std::map<std::string, std::uint64_t> files;   ///< beside the store, where urls lead: path → size
    entity_manager::ResourceRoots roots;          ///< as locate() was told
    std::map<std::string, std::string> partial;   ///< hash → content so far
    std::map<std::string, std::string> owners;    ///< hash → of the content so far
    std::map<std::string, std::string> complete;  ///< service/resource → content
    std::map<std::string, proto::ResourceOffer, std::less<>> open;
    std::uint64_t behind = 0;  ///< bytes that a slow disk has not taken yet, of each
    Refusal failure;           ///< why it never will
};

/// An EntityManagerCore between fake ports that write every effect down, as a line of text and as it is. The
/// parts of composites, whose ids are random, are called part1, part2 and so on as they are dispatched.
/// Clients are known by their names: "admin…" is an administrator, "observer…" an observer. A client sends
/// what it would in truth: the lease it was given and the newest stop generation it was told, unless `lease`
/// or `generation` say otherwise.
class CoreRig final : public entity_manager::BackEndPort, public entity_manager::ServerPort {
  public:
    explicit CoreRig(std::uint64_t seed = 1,
                     entity_manager::EntityManagerCoreSettings settings = {.application = "rig"});

    // The robot application's side.
    void linkUp();
    void uploadProfiles();
    void upload(bool services, const std::string& xml);
    void fromApplication(proto::EiToEm message);
    void grant(const std::string& task);
    void deny(const std::string& task, const std::string& reason);
    void update(const std::string& task, proto::TaskState state, double progress = -1);
    void stopDone(std::uint32_t stopped,
                  proto::StopReceipt::Stage stage = proto::StopReceipt::CALLBACK_RETURNED,
                  bool standstill_follows = false);
    void drillDone(std::uint32_t number);

    // The clients' side.
    Header headOf(const std::string& client);
    Header headOf(const std::string& client, const proto::ToEntity& message);
    void send(const std::string& client, const proto::ToEntity& message);
    void take(const std::string& client, const std::string& request, const std::string& root = {});
    /// RESUME_LEASE of the lease that `of` was given.
    void resumeLease(const std::string& client, const std::string& request, const std::string& of);
    void task(const std::string& client, const std::string& id, const std::string& service,
              const std::vector<std::string>& params = {}, double not_after_s = 0);
    void setParam(const std::string& client, const std::string& request, const std::string& service,
                  const std::string& param);
    /// As the signal thread does it: the counter, the link, then the strand. A sequence of its own unless
    /// given.
    void stop(const std::string& client, StopCause cause = StopCause::Requested, std::int64_t sequence = 0);
    void reset(const std::string& client);
    void clear(const std::string& client);
    void rearm(const std::string& client, const std::string& request);

    /// Link up, good profiles, server up: IDLE.
    void makeIdle();
    /// In small steps, so that everything due is done at its time. The server lives.
    void advance(Duration by, bool server_beats = true);

    std::vector<std::string> takeLines();
    entity_manager::EntityManagerCore& core() { return *core_; }
    /// A new core over the same storage, counter of stops and ports; what the old one knew is gone.
    void restart();
    /// From the next restart() on.
    entity_manager::EntityManagerCoreSettings& settings() { return settings_; }

    // BackEndPort and ServerPort.
    bool send(const proto::EmToEi& message) override;
    void stop(std::uint32_t generation, StopCause cause) override;
    void setBusy(bool busy) override;
    void wantConnection(bool wanted) override;
    void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) override;
    void sendStatus(const EntityStatus& status) override;
    void sendToClient(Lane lane, const Header& head, const proto::ToClient& message) override;
    void sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) override;
    void sendToClientDataSeq(const Header& head, const proto::ToClient& message) override;

    ManualClock clock;
    MemoryStorage storage;
    MemoryResources resources;
    MemoryJournal journal;
    entity_manager::StopGenerations stop_generations;
    std::size_t frame_max = 1U << 20U;  ///< what the link takes at once

    struct ToClientRecord {
        Lane lane;
        Header head;
        proto::ToClient message;
        bool droppable;
    };
    /// Called as it happens, with the core in the middle of an event.
    std::function<void(const proto::EmToEi&)> on_application;
    std::function<void(const ToClientRecord&)> on_client;
    std::function<void(Lane, const Header&, const proto::ToEntity&)> on_peer;

    std::vector<proto::EmToEi> to_application;
    /// Of a task that the application has been given: "part2", or what its client called it.
    std::string nameOfSent(const std::string& id) const;
    /// And back.
    std::string idOfSent(const std::string& name) const;

    std::vector<std::pair<std::uint32_t, StopCause>> stops;
    std::vector<ToClientRecord> to_clients;
    std::vector<EntityStatus> statuses;
    bool busy = false;
    bool wanted = false;

    /// What each client believes.
    struct Belief {
        LeaseNumber lease;
        std::string key;
        std::int32_t generation = 0;
        std::int64_t sequence = 0;
    };
    std::map<std::string, Belief> clients;
    std::optional<LeaseNumber> lease;        ///< for the next message only
    std::optional<std::int32_t> generation;  ///< for the next message only

  private:
    void note(std::string line) { lines_.push_back(std::move(line)); }

    entity_manager::EntityManagerCoreSettings settings_;
    SeededRandom random_;
    TimePoint beat_{};  ///< of the server, the next
    std::vector<std::string> lines_;
    std::vector<std::string> parts_;  ///< ids
    std::unique_ptr<entity_manager::EntityManagerCore> core_;
};

/// 16 bytes that begin with the name, and back.
std::string idOf(const std::string& name);
std::string nameOf(const std::string& id);
/// "Name=value": an integer, a number, true/false or a text.
proto::Param paramOf(const std::string& text);

/// Runs a scenario (docs in tests/scenarios/README.md): the text with what really came out under each event.
std::string playScenario(const std::string& scenario);

}  // namespace axon::test
