// SPDX-License-Identifier: GPL-2.0-or-later
#include "crowd.hpp"

#include <axon/link.pb.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <asio/post.hpp>
#include <asio/thread_pool.hpp>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <thread>
#include <vector>

#include "board.hpp"
#include "client/axon/client.hpp"
#include "entity_manager/entity_manager.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "open_entity.hpp"
#include "robots.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/tls.hpp"
#include "transport/process/memory_lock.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::bench {

namespace {

using namespace axon::entity_manager;

constexpr std::int64_t kSpeakPeriod_ns = 500'000'000;

/// An Entity Interfacer without a socket: grants everything, notes arrivals.
class MemoryLink final : public BackEndPort {
  public:
    MemoryLink(const EntityManager::Strand& strand, BackEndEvents& sink, std::string name, Slot& slot)
        : strand_(strand), sink_(sink), name_(std::move(name)), slot_(slot) {}

    void start() {
        asio::post(strand_, [this] {
            sink_.onLinkUp();
            upload(false, basicProfile(name_));
            upload(true, servicesProfile());
        });
    }

    void stop(std::uint32_t generation, StopCause cause) override {
        // What a client asked for by its stop; a drill, a reset or a lost lease is nobody's measurement.
        if (cause == StopCause::Requested) slot_.stopped(generation, nowNs());
        asio::post(strand_, [this, generation, drill = cause == StopCause::Drill] {
            proto::EiToEm done;
            if (drill)
                done.mutable_stop_done()->set_drill(generation);
            else
                done.mutable_stop_done()->set_stop_generation(generation);
            done.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
            sink_.onLinkMessage(done);
        });
    }
    bool send(const proto::EmToEi& message) override {
        if (message.has_task()) {
            slot_.tasks.note(slot_.tasks.next, nowNs());
            asio::post(strand_, [this, id = message.task().task_id()] {
                proto::EiToEm answer;
                answer.mutable_task_answer()->set_task_id(id);
                sink_.onLinkMessage(answer);
                proto::EiToEm ended;
                ended.mutable_task()->mutable_event()->set_task_id(id);
                ended.mutable_task()->mutable_event()->set_state(proto::TASK_SUCCEEDED);
                sink_.onLinkMessage(ended);
            });
            return true;
        }
        if (message.has_text()) {  // an echo, for round trips
            asio::post(strand_, [this, text = message.text().text()] {
                proto::EiToEm back;
                back.mutable_text()->set_text(text);
                sink_.onLinkMessage(back);
            });
            return true;
        }
        if (!message.has_raw()) return true;
        const auto now = nowNs();  // before the content is checked, as with the others' receivers
        for (const auto& block : message.raw().data())
            slot_.arrived(Kind::Data, now, block.data(), block.size());
        return true;
    }
    void setBusy(bool) override {}

  private:
    void upload(bool services, const std::string& xml) {
        proto::EiToEm message;
        auto& profile = *message.mutable_profile();
        profile.set_services(services);
        profile.set_file_name(services ? "services.xml" : "basic.xml");
        profile.set_xml(xml);
        sink_.onLinkMessage(message);
    }

    const EntityManager::Strand strand_;
    BackEndEvents& sink_;
    const std::string name_;
    Slot& slot_;
};

/// The link to a robot application of robots.hpp, as the daemon has it; notes arrivals on the way.
class NotingLink final : public BackEndPort {
  public:
    NotingLink(std::unique_ptr<BackEndInterface> link, Slot& slot) : link_(std::move(link)), slot_(slot) {}

    void stop(std::uint32_t generation, StopCause cause) override {
        if (cause == StopCause::Requested) slot_.stopped(generation, nowNs());
        link_->stop(generation, cause);
    }
    bool send(const proto::EmToEi& message) override {
        const auto now = nowNs();
        const bool sent = link_->send(message);
        if (message.has_raw())  // checked when it is on its way, so that the second column does not wait for
                                // the first one's check
            for (const auto& block : message.raw().data())
                slot_.arrived(Kind::Data, now, block.data(), block.size());
        return sent;
    }
    void setBusy(bool busy) override { link_->setBusy(busy); }
    std::vector<HopMargin> margins() const override { return link_->margins(); }

  private:
    const std::unique_ptr<BackEndInterface> link_;
    Slot& slot_;
};

class MemoryStorage final : public Storage, public ResourceStore {
  public:
    std::optional<std::string> load(std::string_view key) override {
        const auto found = values_.find(std::string(key));
        if (found == values_.end()) return std::nullopt;
        return found->second;
    }
    void save(std::string_view key, std::string_view value) override { values_[std::string(key)] = value; }
    void forget(std::string_view key) override { values_.erase(std::string(key)); }

    Later<Result<std::uint64_t>> begin(const proto::ResourceOffer&, const std::string&) override {
        return Result<std::uint64_t>(refused());
    }
    Result<void> write(std::string_view, std::uint64_t, std::string_view) override { return refused(); }
    Later<Result<std::string>> check(std::string_view) override { return Result<std::string>(refused()); }
    Later<Result<std::string>> place(std::string_view) override { return Result<std::string>(refused()); }
    void suspend(std::string_view) override {}
    void drop(std::string_view) override {}
    void remove(std::string_view, std::string_view) override {}
    std::optional<std::string> find(std::string_view, std::string_view) override { return std::nullopt; }

  private:
    static Refusal refused() {
        return {RefusalCode::NotSupported, "a benchmark's entity keeps no files", {}};
    }
    std::map<std::string, std::string> values_;
};

}  // namespace

namespace {

// Children inherit it.
constexpr const char* kSpin = "AXON_BENCH_DIRECT_SPIN_US";

}  // namespace

void setDirectSpin(std::chrono::microseconds longest) {
    ::setenv(kSpin, std::to_string(longest.count()).c_str(), 1);
}

std::chrono::microseconds directSpin() {
    const char* const set = std::getenv(kSpin);
    return set == nullptr ? client::Options{}.direct_spin : std::chrono::microseconds(std::atoi(set));
}

int runCrowd(const CrowdWish& wish) {
    spdlog::set_level(spdlog::level::err);
    transport::lockMemory();  // as the daemon does
    Board board(wish.board_file, wish.slots, false);
    SteadyClock clock;
    asio::thread_pool executor(1);
    std::map<std::string, std::string> properties;  // of Ice
    ServerAddress server;
    std::string address = wish.server;
    if (std::filesystem::exists(wish.server)) {
        const auto configured = client::readConfiguration(wish.server);
        if (!configured) throw std::runtime_error(configured.refusal().message);
        address = configured->server;
        server.user = configured->user;
        server.password = configured->password;
        properties = configured->properties;
    }
    if (address.find('/') != std::string::npos) {
        server.router = transport::wayToRouter(address, transport::speaksTls(properties));
        server.tls = transport::isTlsRouter(server.router);
    } else {
        const auto called = transport::parseEndpoint(address);
        server.host = called.host;
        server.port = called.port;
        server.tls = called.tls;
    }
    const auto ice = std::make_shared<ServerCommunicators>(1, 1, properties);

    struct Member {
        SystemRandom random;
        MemoryStorage storage;
        std::shared_ptr<EntityManager> manager;
        std::shared_ptr<OpenEntity> open;  // instead of it
        bool ready() const { return open ? open->joined() : manager->state() == EntityState::IDLE; }
    };
    const auto startManager = [&](Member& member, std::size_t index, const std::string& name) {
        auto& slot = board[index];
        EntityManagerCoreSettings settings;
        settings.application = name;
        member.manager = EntityManager::create(
            executor.get_executor(), ice, settings, server,
            [&](const EntityManager::Strand& strand, const StopGenerations& stop_generations, const Clock&,
                BackEndEvents& events) {
                if (hasRobots(wish.variant)) {
                    BackEndSettings settings_of_link;
                    settings_of_link.application = name;
                    settings_of_link.manager = name;
                    const auto place = robotPlace(wish.board_file, index);
                    settings_of_link.where = {{place.port, place.port}, place.address};
                    auto tcp = std::make_unique<BackEndInterface>(
                        strand, std::move(settings_of_link), stop_generations, clock, member.random, events);
                    auto* const at = tcp.get();
                    return EntityManager::BackEnd{std::make_unique<NotingLink>(std::move(tcp), slot),
                                                  [at] { at->start(); }, [at] { at->close(); }};
                }
                auto link = std::make_unique<MemoryLink>(strand, events, name, slot);
                auto* const at = link.get();
                return EntityManager::BackEnd{std::move(link), [at] { at->start(); }, [] {}};
            },
            clock, member.random, member.storage, member.storage);
        if (isDirect(wish.variant)) {
            DirectSettings direct;
            direct.offered = true;
            direct.spin = directSpin();
            member.manager->offerDirect(direct);
        }
        member.manager->start();
    };
    std::vector<std::unique_ptr<Member>> members;
    for (std::size_t i = 0; i < wish.count; ++i) {
        auto member = std::make_unique<Member>();
        const auto name = wish.prefix + "-" + std::to_string(wish.first + i);
        if (wish.variant == Variant::Open) {
            member->open = OpenEntity::create(executor.get_executor(), ice, server, clock, member->random,
                                              name, board[wish.first + i]);
            member->open->start();
        } else {
            startManager(*member, wish.first + i, name);
        }
        members.push_back(std::move(member));
        // Logging in costs the server; 32 at a time keeps every handshake within its time-out.
        while (i >= 32 && !members[i - 32]->ready())
            std::this_thread::sleep_for(std::chrono::milliseconds{1});
    }
    for (const auto& member : members)
        while (!member->ready()) std::this_thread::sleep_for(std::chrono::milliseconds{1});
    ++board.ready();

    const auto parent = ::getppid();
    const auto bytes = content(kSmallBytes);
    for (std::int64_t due = 0; ::getppid() == parent;
         std::this_thread::sleep_for(std::chrono::milliseconds{20})) {
        if (board.go() == 0 || nowNs() < due) continue;
        due = (due == 0 ? nowNs() : due) + kSpeakPeriod_ns;
        for (const auto& member : members)
            if (member->open) member->open->speak(bytes);
    }
    return 0;
}

}  // namespace axon::bench
