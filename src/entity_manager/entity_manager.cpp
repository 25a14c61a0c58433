// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/entity_manager.hpp"

#include <axon/link.pb.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <asio/dispatch.hpp>
#include <asio/post.hpp>
#include <future>
#include <utility>

#include "entity_manager/identity.hpp"
#include "entity_manager/strand/caller_first.hpp"

namespace axon::entity_manager {

namespace {
constexpr int kEventsPerTurn = 128;  // then other strands of the executor get a turn
constexpr int kOpenings = 8;         // of direct paths that wait for the strand

/// For the log, which has no line ends within a message.
std::string inOneLine(std::string_view text) {
    std::string line;
    for (const char c : text) c == '\n' ? line += "; " : line += c;
    return line;
}
}  // namespace

EntityManager::EntityManager(asio::any_io_executor executor, std::string name, const Clock& clock,
                             std::shared_ptr<ServerCommunicators> ice, WayToServer way)
    : strand_(CallerFirst::over(std::move(executor))),
      name_(std::move(name)),
      clock_(clock),
      ice_(std::move(ice)),
      way_(way),
      timer_(strand_, clock_),
      turn_timer_(strand_, steady_) {}

std::shared_ptr<EntityManager> EntityManager::create(asio::any_io_executor executor,
                                                     std::shared_ptr<ServerCommunicators> ice,
                                                     EntityManagerCoreSettings settings, ServerAddress server,
                                                     const BackEndFactory& back_end, const Clock& clock,
                                                     RandomSource& random, Storage& storage,
                                                     ResourceStore& resources, Journal* journal) {
    const std::shared_ptr<EntityManager> self(new EntityManager(std::move(executor), settings.application,
                                                                clock, ice,
                                                                !server.router.empty() ? WayToServer::Router
                                                                : server.tls           ? WayToServer::Tls
                                                                                       : WayToServer::Plain));
    self->back_end_ = back_end(self->strand_, self->stop_generations_, clock, *self);
    auto identity = identityIn(storage, random);
    server.secret = std::move(identity.secret);
    settings.uuid = std::move(identity.uuid);
    self->server_ =
        std::make_unique<EntityCommunicator>(self->strand_, std::move(ice), std::move(server), clock, self);
    self->direct_desk_ =
        std::make_unique<DirectDesk>(clock, *self->server_, [](bool warning, const std::string& line) {
            spdlog::log(warning ? spdlog::level::warn : spdlog::level::info, "{}", line);
        });
    self->core_ = std::make_unique<EntityManagerCore>(std::move(settings), clock, random,
                                                      *self->back_end_.port, *self->direct_desk_, storage,
                                                      resources, self->stop_generations_, journal);
    self->direct_desk_->setEntity(self->core_->uuid());
    self->resources_ = &resources;
    self->journal_ = journal;
    // The thread of a store must not be the one that drops the last reference.
    const auto come = [strand = self->strand_, weak = self->weak_from_this(),
                       told = std::make_shared<std::atomic<bool>>(false)] {
        if (told->exchange(true)) return;
        asio::post(strand, [weak, told] {
            told->store(false);
            const auto manager = weak.lock();
            if (!manager || manager->stopped_) return;
            manager->core_->onStored();
            manager->afterEvents();
        });
    };
    resources.onAnswer(come);
    if (journal != nullptr) journal->onAnswer(come);
    return self;
}

EntityManager::~EntityManager() = default;

EntityManager::BackEndFactory EntityManager::overTcp(BackEndSettings settings, RandomSource& random) {
    return [settings = std::move(settings), &random](const Strand& strand,
                                                     const StopGenerations& stop_generations,
                                                     const Clock& clock, BackEndEvents& events) {
        auto link =
            std::make_unique<BackEndInterface>(strand, settings, stop_generations, clock, random, events);
        auto* const at = link.get();
        return BackEnd{std::move(link), [at] { at->start(); }, [at] { at->close(); }};
    };
}

void EntityManager::receiveDatagrams(const DatagramSettings& settings, const Clock& clock) {
    datagrams_ = std::make_unique<DatagramDesk>(
        settings, clock, stop_generations_, uuid(),
        [this](Header head, StopCause cause) { stopSignal(std::move(head), cause); });
}

void EntityManager::offerDirect(const DirectSettings& settings) {
    // What is TLS to the server is TLS to a client, and who comes through a router reaches no endpoint behind
    // it.
    if (way_ != WayToServer::Router && settings.offered)
        doors_ = std::make_unique<DirectDoors>(strand_, settings, ice_, uuid(), clock_, weak_from_this(),
                                               way_ == WayToServer::Tls);
}

void EntityManager::watchedBy(transport::ServiceWatchdog::Worker turned) {
    turned_ = std::move(turned);
}

void EntityManager::start() {
    asio::post(strand_, [self = shared_from_this()] {
        self->core_->start();
        self->back_end_.start();
        self->afterEvents();
        if (self->turned_) self->turn();
    });
}

void EntityManager::turn() {
    if (stopped_) return;
    turn_timer_.at(steady_.now() + turned_(), [weak = weak_from_this()] {
        if (const auto self = weak.lock()) self->turn();
    });
}

void EntityManager::stop() {
    resources_->onAnswer({});
    if (journal_ != nullptr) journal_->onAnswer({});
    std::promise<void> done;
    asio::post(strand_, [this, &done] {
        if (!std::exchange(stopped_, true)) {
            core_->shutDown();
            server_->wantConnection(false);
            if (datagrams_) datagrams_->close();
            direct_desk_->close();
            if (doors_) doors_->shut();
            back_end_.close();
            timer_.cancel();
            turn_timer_.cancel();
        }
        done.set_value();
    });
    done.get_future().wait();
    doors_.reset();  // joins its threads
}

void EntityManager::stopSignal(Header head, StopCause cause) {
    if (cause == StopCause::ClientLost && stop_generations_.sparesClientLoss()) {
        clientUpdate(std::move(head), ClientChange::Lost);  // what that means now, the strand decides
        return;
    }
    wake(passStop(std::move(head), cause));
}

Inbox::Verdict EntityManager::passSignal(Inbox::Signal kind, Inbox::Event event, SenderKey from) {
    const std::lock_guard in_order(signal_mutex_);
    return inbox_.pushSignal(kind, std::move(event), from);
}

Inbox::Verdict EntityManager::passStop(Header head, StopCause cause) {
    const std::lock_guard in_order(signal_mutex_);
    const auto from = senderKey(head.sender.id);
    if (cause == StopCause::Drill) {
        if (inbox_.wouldDrop(from)) return Inbox::Verdict::Dropped;  // nobody would hear of the answer
        const auto number = stop_generations_.drill(head.sender.id, head.sequence);
        if (!number) return Inbox::Verdict::Dropped;  // by the other path
        back_end_.port->stop(*number, cause);
        return inbox_.pushSignal(
            Inbox::Signal::Passing,
            [this, head = std::move(head), number = *number] { core_->onDrill(head, number); }, from);
    }
    const auto generation = stop_generations_.raise(head.sender.id, head.sequence,
                                                    static_cast<std::uint32_t>(head.stop_generation));
    if (!generation) {  // the same stop by another path, or repeated because its receipt did not arrive
        const auto known = stop_generations_.raisedBy(head.sender.id, head.sequence);
        if (!known) return Inbox::Verdict::Dropped;
        return inbox_.pushSignal(
            Inbox::Signal::Passing,
            [this, head = std::move(head), cause, generation = *known] {
                core_->onStopRepeated(head, cause, generation);
            },
            from);
    }
    back_end_.port->stop(*generation, cause);
    return inbox_.pushSignal(Inbox::Signal::Stop,
                             [this, head = std::move(head), cause, generation = *generation] {
                                 core_->onStopSignal(head, cause, generation);
                             });
}

void EntityManager::resetSignal(Header head) {
    const auto from = senderKey(head.sender.id);
    wake(passSignal(
        Inbox::Signal::Passing, [this, head = std::move(head)] { core_->onResetSignal(head); }, from));
}

void EntityManager::clearSignal(Header head) {
    const auto from = senderKey(head.sender.id);
    wake(passSignal(
        Inbox::Signal::Passing, [this, head = std::move(head)] { core_->onClearSignal(head); }, from));
}

void EntityManager::clientUpdate(Header head, ClientChange change) {
    wake(passSignal(Inbox::Signal::Client,
                    [this, head = std::move(head), change] { core_->onClientUpdate(head, change); }));
}

void EntityManager::serverHeartbeat() {
    core_->onServerHeartbeat();  // the strand sees it when its timer rings
}

void EntityManager::clientMsg(Lane lane, Header head, std::string bytes) {
    const auto size = bytes.size();
    if (lane == Lane::Signal)
        return wake(passSignal(Inbox::Signal::Peer, [this, head = std::move(head), bytes = std::move(bytes)] {
            core_->onClientMsg(head, bytes);
        }));
    auto event = [this, head = std::move(head), bytes = std::move(bytes)] {
        handleRelayed(direct::Keeping::Kept, head, bytes);
    };
    wake(inbox_.pushControl(std::move(event), size), RunOn::Here);
}

void EntityManager::clientMsgDataSeq(Header head, std::string bytes) {
    const auto size = bytes.size();
    wake(inbox_.pushData(
             [this, head = std::move(head), bytes = std::move(bytes)] {
                 handleRelayed(direct::Keeping::Droppable, head, bytes);
             },
             size),
         RunOn::Here);
}

void EntityManager::handleRelayed(direct::Keeping keeping, const Header& head, const std::string& bytes) {
    const auto deliver = [this](const Header& its_head, const std::string& its) {
        core_->onClientMsg(its_head, its);
    };
    if (direct_desk_->relayed(keeping, head, bytes, deliver) && !core_->onClientMsg(head, bytes))
        ++passed_on_;
}

bool EntityManager::handleDirect(const Id128& path, direct::Keeping keeping, Header& head,
                                 std::string& bytes) {
    return direct_desk_->arrived(path, keeping, head, bytes) && !core_->onClientMsg(head, bytes);
}

void EntityManager::undeliverable(Lane lane, Header head, const Refusal& refusal) {
    if (head.entity.empty() || head.entity == uuid()) {  // it was for no peer
        spdlog::warn("{}: {} could not be delivered: {} ({})", name_, head.msg_type, refusal.message,
                     refusalName(refusal.code));
        return;
    }
    auto event = [this, head = std::move(head), refusal] { core_->onPeerRefusal(head, refusal); };
    if (lane == Lane::Signal) return wake(passSignal(Inbox::Signal::Peer, std::move(event)));
    wake(inbox_.pushControl(std::move(event)), RunOn::Here);
}

void EntityManager::serverUp() {
    if (datagrams_) core_->offerDatagrams(datagrams_->open(server_->localAddress()));
    auto [data, signal] =
        doors_ ? doors_->listen(server_->localAddress()) : std::pair<std::string, std::string>{};
    core_->offerDirect(std::move(data), std::move(signal));
    core_->onServerUp();
    afterEvents();
}

void EntityManager::serverDown(const std::string& reason) {
    direct_desk_->serverDown();
    core_->onServerDown(reason);
    afterEvents();
}

template <class Use>
void EntityManager::onStrand(Use use) {
    asio::post(strand_, [weak = weak_from_this(), use = std::move(use)]() mutable {
        const auto self = weak.lock();
        if (!self) return;
        use(*self);
        self->afterEvents();
    });
}

void EntityManager::directOpening(DirectOpening opening) {
    // Strangers come here, so little of it waits.
    if (openings_.fetch_add(1) >= kOpenings) {
        --openings_;
        return opening.refuse(
            {RefusalCode::Overloaded, "Others open direct paths at the moment. Try again.", {}});
    }
    onStrand([opening = std::move(opening)](EntityManager& self) {
        --self.openings_;
        self.direct_desk_->onOpening(opening, self.stopped_ ? nullptr : self.core_->held());
    });
}

bool EntityManager::directMsg(const Id128& path, direct::Keeping keeping, Header& head, std::string& bytes) {
    if (stopped_) return true;
    if (!inbox_.scheduled()) {
        // Nothing waits, so it need not.
        if (!handleDirect(path, keeping, head, bytes)) direct_changed_ = true;
        return true;
    }
    const auto size = bytes.size();
    Inbox::Event event = [this, path, keeping, its_head = head, its_bytes = bytes]() mutable {
        if (handleDirect(path, keeping, its_head, its_bytes)) ++passed_on_;
    };
    const auto verdict = keeping == direct::Keeping::Droppable
                             ? inbox_.pushData(std::move(event), size)
                             : inbox_.pushControl(std::move(event), size, Inbox::Share::Half);
    if (verdict == Inbox::Verdict::Overflow) {
        // The holder waits; of the servers' way, where all have a share, the session would end.
        direct_waits_ = size;
        return false;
    }
    wake(verdict);
    return true;
}

void EntityManager::directTurnEnded() {
    if (std::exchange(direct_changed_, false)) afterEvents();
}

void EntityManager::letDirectGoOn() {
    if (stopped_ || !direct_waits_ || !inbox_.hasRoom(*direct_waits_)) return;
    direct_waits_.reset();
    if (doors_) doors_->roomAgain();
}

void EntityManager::directStop(Header head, StopCause cause) {
    stopSignal(std::move(head), cause);
}

void EntityManager::directReset(Header head) {
    resetSignal(std::move(head));
}

void EntityManager::directClear(Header head) {
    clearSignal(std::move(head));
}

void EntityManager::directPace() {
    onStrand([](EntityManager&) {});  // the timer is set anew
}

void EntityManager::directClosed(const Id128& path, const std::string& why) {
    onStrand([path, why](EntityManager& self) { self.direct_desk_->onClosed(path, why); });
}

void EntityManager::onLinkUp() {
    core_->onLinkUp();
    afterEvents();
}

void EntityManager::onLinkDown(const std::string& reason, LinkEnd end) {
    spdlog::warn("{}: the link to the robot application is down: {}", name_, inOneLine(reason));
    core_->onLinkDown(reason, end);
    afterEvents();
}

void EntityManager::onLinkRefused(const Refusal& refusal) {
    spdlog::warn("{}: no link to the robot application: {} ({})", name_, refusal.message,
                 refusalName(refusal.code));
}

void EntityManager::onLinkSought(const SearchReport& report) {
    spdlog::warn("{}: {}{}{}", name_, inOneLine(report.finding),
                 report.fix.empty() ? "" : "; fix: ", report.fix);
    core_->onApplicationSought(report.finding);
    afterEvents();
}

void EntityManager::onLinkSlow(const std::string& what) {
    spdlog::warn("{}: the robot application: {}; above that the link is given up. This machine is overloaded",
                 name_, what);
}

void EntityManager::onLinkRelease(const std::string& note) {
    spdlog::info("{}: {}", name_, note);
}

void EntityManager::onLinkMessage(const proto::EiToEm& message) {
    if (core_->onLinkMessage(message)) afterEvents();
}

void EntityManager::wake(Inbox::Verdict verdict, RunOn where) {
    const auto come = [weak = weak_from_this()] {
        if (const auto self = weak.lock()) self->drain();
    };
    switch (verdict) {
        case Inbox::Verdict::AlreadyScheduled:
        case Inbox::Verdict::Dropped:
            return;
        case Inbox::Verdict::Scheduled:
            if (where == RunOn::Here) {
                asio::dispatch(strand_, come);
            } else {
                asio::post(strand_, come);
            }
            return;
        case Inbox::Verdict::Overflow:
            // Control may not be lost, so the peer that sends faster than it is handled is dropped; the loss
            // of the session stops the robot. Once for each session, and then the core wants a new one.
            if (leaving_.exchange(true)) return;
            asio::post(strand_, [weak = weak_from_this()] {
                const auto self = weak.lock();
                if (!self) return;
                self->leaving_ = false;
                // The core may have given the session up by itself, and be seeking a new one already.
                if (self->stopped_ || !self->core_->serverUp()) return;
                spdlog::error("{}: more than the bounded number of control messages wait; leaving the server",
                              self->name_);
                self->server_->wantConnection(false);
                self->serverDown("control messages arrived faster than they could be handled");
            });
            return;
    }
}

void EntityManager::drain() noexcept {
    bool left = true;
    int handled = 0;
    passed_on_ = 0;
    while (left && handled < kEventsPerTurn) {
        const auto event = inbox_.take();
        left = static_cast<bool>(event);
        if (!left) break;
        ++handled;
        if (!stopped_) event();
    }
    if (passed_on_ < handled) afterEvents();
    letDirectGoOn();
    if (!left) return;
    asio::post(strand_, [weak = weak_from_this()] {
        if (const auto self = weak.lock()) self->drain();
    });
}

void EntityManager::afterEvents() {
    // First: who sees the state below may rely on it.
    if (datagrams_) datagrams_->hold(core_->held());
    direct_desk_->hold(core_->held());
    direct_ = direct_desk_->direct();
    const auto state = core_->state();
    if (const auto before = state_.exchange(state); before != state) {
        const auto reason = core_->status().reason;
        spdlog::info("{}: {} -> {}{}{}", name_, toString(before), toString(state), reason.empty() ? "" : ": ",
                     inOneLine(reason));
    }
    if (const bool latched = core_->latched(); std::exchange(latched_, latched) != latched)
        spdlog::info("{}: {}", name_, latched ? "stopped and latched" : "rearmed");
    if (const auto warning = core_->takeWarning(); !warning.empty())
        spdlog::warn("{}: {}", name_, inOneLine(warning));
    if (const auto news = core_->takeNews(); !news.empty()) spdlog::info("{}: {}", name_, inOneLine(news));
    armTimer();
}

void EntityManager::armTimer() {
    if (stopped_) return;
    const auto deadline = std::min(core_->nextDeadline(), direct_desk_->nextDeadline());
    // What has become later is asked for again when the timer rings: each sign of life moves a watchdog, and
    // setting a timer wakes the executor.
    if (deadline >= timer_.due()) return;
    timer_.at(deadline, [weak = weak_from_this()] {
        const auto self = weak.lock();
        if (!self || self->stopped_) return;
        self->core_->onTimer();
        self->direct_desk_->onTimer();
        self->afterEvents();
    });
}

}  // namespace axon::entity_manager
