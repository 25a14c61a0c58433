// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <asio/dispatch.hpp>
#include <asio/post.hpp>
#include <asio/strand.hpp>
#include <asio/thread_pool.hpp>
#include <future>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "common/clock.hpp"
#include "entity_manager/links/direct/data_door.hpp"
#include "entity_manager/links/direct/direct_desk.hpp"
#include "entity_manager/strand/caller_first.hpp"
#include "entity_manager/strand/inbox.hpp"
#include "lane_schedules/between.hpp"
#include "lane_schedules/book.hpp"
#include "support/loopback.hpp"

namespace axon::schedules {

inline const std::string kEntity = "eeeeeeee-eeee-4eee-8eee-eeeeeeeeeeee";

/// An Entity Manager as far as the direct path is concerned: its port of data lanes, its desk and its inbox
/// on its strand, as EntityManager has them; instead of the core, a book. Threads: any, unless it says
/// otherwise. What comes may ask for an answer of so many bytes (Header::stop_generation).
class ManagerEnd final : public entity_manager::DirectEvents,
                         public std::enable_shared_from_this<ManagerEnd>,
                         private entity_manager::RelayedWay {
  public:
    ManagerEnd(const Clock& clock, Activity& activity, Relay& relay, Claims& claims, Book& hears, Book& sends,
               entity_manager::Inbox::Bounds bounds, Duration spin)
        : clock_(clock),
          activity_(activity),
          relay_(relay),
          claims_(claims),
          hears_(hears),
          sends_(sends),
          spin_(spin),
          inbox_(bounds) {
        desk_.setEntity(kEntity);
    }

    /// Once.
    void start() {
        door_ = std::make_unique<entity_manager::DataDoor>(strand_, test::loopbackAddress(), 0, kEntity,
                                                           spin_, clock_, weak_from_this());
        endpoint = test::loopbackAddress() + ":" + std::to_string(door_->port());
    }
    /// As EntityManager::stop(), with whatever is under way.
    void stop() {
        onStrand([this] {
            stopped_ = true;
            desk_.close();
            door_->shut();
        });
        door_.reset();
        executor_.join();
        for (const auto& [path, times] : ends_)
            claims_.hold(times == (admitted_.count(path) != 0 ? 1 : 0),
                         "the Entity Manager is told once that a data lane is over");
        for (const auto& [path, number] : admitted_)
            claims_.hold(ends_.count(path) != 0, "the Entity Manager is told that a data lane is over");
    }
    /// Runs it on the strand and waits.
    template <class Use>
    void onStrand(Use use) {
        std::promise<void> done;
        asio::post(strand_, [&] {
            use();
            done.set_value();
        });
        done.get_future().wait();
    }

    // What the driver does.
    void send(Keeping keeping, std::size_t size, std::int32_t answer, int times) {
        asio::post(strand_, [self = shared_from_this(), keeping, size, answer, times] {
            for (int i = 0; i < times; ++i) self->sendNow(keeping, size, answer);
        });
    }
    void timer() {
        onStrand([this] {
            desk_.onTimer();
            afterEvents();
        });
    }
    /// A message that the servers bring. Not when it finds no room.
    bool relayed(const Relay::Item& item) {
        const auto event = [this, item] { handleRelayed(item); };
        const auto verdict = item.keeping == Keeping::Droppable
                                 ? inbox_.pushData(event, item.bytes.size())
                                 : inbox_.pushControl(event, item.bytes.size());
        if (verdict == entity_manager::Inbox::Verdict::Overflow) return false;
        if (verdict == entity_manager::Inbox::Verdict::Scheduled)
            asio::dispatch(strand_, [self = shared_from_this()] { self->drain(); });
        return true;
    }
    /// While it is shut, nothing is handled, so that the inbox fills.
    void shut(bool is_shut) {
        onStrand([this, is_shut] {
            if (shut_ == is_shut) return;
            shut_ = is_shut;
            if (shut_) {
                inbox_.wake();  // what comes now waits
            } else {
                drain();
            }
        });
    }
    /// Another lease for this client. The present one ends.
    entity_manager::LeaseBook::Held grant(const std::string& client) {
        entity_manager::LeaseBook::Held next;
        onStrand([&] {
            next.number = {1, ++last_number_};
            next.key = Id128::random(random_);
            next.holder = {client, "a client", Role::Operator};
            held_ = next;
            afterEvents();
        });
        return next;
    }
    void endLease() {
        onStrand([this] {
            held_.reset();
            afterEvents();
        });
    }
    /// The servers have lost the client, and with it what they had under way.
    void loseHolder() {
        onStrand([this] {
            if (held_) held_->grace_until = clock_.now() + std::chrono::hours{1};
            afterEvents();
        });
    }
    /// It is back, under another name.
    entity_manager::LeaseBook::Held resume(const std::string& client) {
        std::optional<entity_manager::LeaseBook::Held> kept;
        onStrand([&] {
            sends_.newSession();
            unacknowledged_.clear();
            if (!held_) return;
            held_->holder.id = client;
            held_->grace_until.reset();
            kept = held_;
            afterEvents();
        });
        return kept ? *kept : grant(client);
    }
    void breakLane() {
        onStrand([this] {
            if (const auto lane = lane_.lock()) lane->close("this end is killed");
        });
    }
    bool direct() {
        bool is = false;
        onStrand([&] { is = desk_.direct(); });
        return is;
    }
    std::string endpoint;  // constant after start()
    std::atomic<int> stalls{0}, by_path{0}, left_out{0}, again{0};

    // Of the signal lane's stub.
    void signalClosed(const Id128& path) {
        asio::post(strand_, [self = shared_from_this(), path] {
            self->desk_.onClosed(path, "its holder's end is closed");
            self->afterEvents();
        });
    }

    // DirectEvents, as EntityManager.
    void directOpening(entity_manager::DirectOpening opening) override {
        if (opening.claim.lane == Lane::Data) {
            const auto path = opening.claim.path;
            opening.admit = [this, path, admit = std::move(opening.admit)](
                                const Sender& sender, std::shared_ptr<entity_manager::DirectSigns> signs,
                                std::string proof) {
                ++admitted_[path];
                signs_ = signs;
                auto lane = admit(sender, std::move(signs), std::move(proof));
                lane_ = lane;
                return lane;
            };
        }
        asio::post(strand_, [self = shared_from_this(), opening = std::move(opening)] {
            self->desk_.onOpening(opening, !self->stopped_ && self->held_ ? &*self->held_ : nullptr);
            self->afterEvents();
        });
    }
    bool directMsg(const Id128& path, Keeping keeping, Header& head, std::string& bytes) override {
        if (stopped_) return true;
        if (!inbox_.scheduled()) {
            arrived(path, keeping, head, bytes);
            return true;
        }
        const auto size = bytes.size();
        auto event =
            entity_manager::Inbox::Event([this, path, keeping, its_head = head, its_bytes = bytes]() mutable {
                arrived(path, keeping, its_head, its_bytes);
            });
        const auto verdict =
            keeping == Keeping::Droppable
                ? inbox_.pushData(std::move(event), size)
                : inbox_.pushControl(std::move(event), size, entity_manager::Inbox::Share::Half);
        if (verdict == entity_manager::Inbox::Verdict::Overflow) {
            ++stalls;
            direct_waits_ = size;
            return false;
        }
        if (verdict == entity_manager::Inbox::Verdict::Scheduled)
            asio::post(strand_, [self = shared_from_this()] { self->drain(); });
        return true;
    }
    void directTurnEnded() override { afterEvents(); }
    void directStop(Header, StopCause) override {}
    void directReset(Header) override {}
    void directClear(Header) override {}
    void directPace() override {}
    void directClosed(const Id128& path, const std::string& why) override {
        ++ends_[path];
        asio::post(strand_, [self = shared_from_this(), path, why] {
            self->desk_.onClosed(path, why);
            self->afterEvents();
        });
    }

  private:
    // RelayedWay.
    void wantConnection(bool) override {}
    void sendBasicPrfl(const Registration&, const proto::BasicProfile&) override {}
    void sendStatus(const EntityStatus&) override {}
    void sendToPeer(Lane, const Header&, const proto::ToEntity&) override {}
    void sendToClient(Lane, const Header& head, const proto::ToClient& message) override {
        relay_.fromManager({Keeping::Kept, head, message.SerializeAsString()});
    }
    void sendToClientDataSeq(const Header& head, const proto::ToClient& message) override {
        relay_.fromManager({Keeping::Droppable, head, message.SerializeAsString()});
    }
    void sendToClientBytes(Lane, const Header& head, const std::string& message) override {
        ++again;
        relay_.fromManager({Keeping::Kept, head, message});
    }

    /// On the strand, as everything below.
    void sendNow(Keeping keeping, std::size_t size, std::int32_t answer) {
        if (stopped_ || !held_ || held_->grace_until) return;
        Header head;
        head.sender = held_->holder;
        head.entity = kEntity;
        head.msg_type = keeping == Keeping::Kept ? kMsgRaw : kMsgStream;
        head.held = held_->number;
        head.stop_generation = answer;
        head.sequence = ++sequence_;
        proto::ToClient message;
        message.mutable_raw()->add_data(Content::of(head.sequence, size));
        sends_.sent(keeping, head.sequence, size);
        if (keeping == Keeping::Droppable) return desk_.sendToClientDataSeq(head, message);
        desk_.sendToClient(Lane::Data, head, message);
        if (!desk_.direct()) return unacknowledged_.clear();
        unacknowledged_.add(head.sequence, message.ByteSizeLong() + kHeadBytes);
        unacknowledged_.acknowledged(signs_->acknowledged);
        const direct::KeptBounds bounds;
        claims_.hold(unacknowledged_.within(bounds.messages, bounds.bytes),
                     "the Entity Manager keeps no more than it may");
    }
    void arrived(const Id128& path, Keeping keeping, Header& head, std::string& bytes) {
        const bool pass = desk_.arrived(path, keeping, head, bytes);
        ++(pass ? by_path : left_out);
        if (pass) handle(keeping, head, bytes);
    }
    void handleRelayed(const Relay::Item& item) {
        const auto deliver = [this](const Header& head, const std::string& bytes) {
            // Of what was held back the head says whether it may be lost.
            handle(head.msg_type == kMsgStream ? Keeping::Droppable : Keeping::Kept, head, bytes);
        };
        const bool pass = desk_.relayed(item.keeping, item.head, item.bytes, deliver);
        if (pass) handle(item.keeping, item.head, item.bytes);
        if (!pass && item.head.msg_type != kMsgWay) ++left_out;
    }
    void handle(Keeping keeping, const Header& head, const std::string& bytes) {
        hears_.came(keeping, head.sequence, bytes);
        activity_.tell();
        if (head.stop_generation > 0) sendNow(keeping, static_cast<std::size_t>(head.stop_generation), 0);
        if (head.msg_type == kMsgRelease && held_ && held_->number == head.held) held_.reset();
    }
    void drain() {
        if (shut_) return;
        constexpr int kEventsPerTurn = 128;
        bool left = true;
        for (int handled = 0; left && handled < kEventsPerTurn; ++handled) {
            const auto event = inbox_.take();
            left = static_cast<bool>(event);
            if (left && !stopped_) event();
        }
        afterEvents();
        if (!stopped_ && direct_waits_ && inbox_.hasRoom(*direct_waits_)) {
            direct_waits_.reset();
            door_->roomAgain();
        }
        if (left) asio::post(strand_, [self = shared_from_this()] { self->drain(); });
    }
    void afterEvents() {
        desk_.hold(held_ ? &*held_ : nullptr);
        activity_.tell();
    }

    static constexpr std::size_t kHeadBytes = 200;  // DirectDesk's

    const Clock& clock_;
    Activity& activity_;
    Relay& relay_;
    Claims& claims_;
    Book &hears_, &sends_;
    const Duration spin_;
    entity_manager::Inbox inbox_;
    asio::thread_pool executor_{1};
    asio::strand<entity_manager::CallerFirst> strand_{
        entity_manager::CallerFirst::over(executor_.get_executor())};
    // Of the strand:
    entity_manager::DirectDesk desk_{clock_, *this, [](bool, const std::string&) {}};
    SystemRandom random_;
    std::optional<entity_manager::LeaseBook::Held> held_;
    std::int32_t last_number_ = 0;
    std::int64_t sequence_ = 0;
    Unacknowledged unacknowledged_;
    std::optional<std::size_t> direct_waits_;
    bool shut_ = false, stopped_ = false;
    std::weak_ptr<entity_manager::DirectLane> lane_;
    std::shared_ptr<entity_manager::DirectSigns> signs_;
    std::map<Id128, int> admitted_, ends_;  // by path
    std::unique_ptr<entity_manager::DataDoor> door_;
};

}  // namespace axon::schedules
