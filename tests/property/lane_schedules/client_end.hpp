// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <atomic>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "client/callback_queue.hpp"
#include "client/connection/backlog.hpp"
#include "client/direct/direct_links.hpp"
#include "client/direct/framed_lane.hpp"
#include "client/direct/lane_readers.hpp"
#include "client/sending/message_sender.hpp"
#include "lane_schedules/between.hpp"
#include "lane_schedules/book.hpp"
#include "lane_schedules/manager_end.hpp"

namespace axon::schedules {

/// Callbacks wait here while it is shut.
class Gate {
  public:
    void pass() {
        std::unique_lock lock(mutex_);
        if (shut_) ++waited_;
        changed_.wait(lock, [this] { return !shut_; });
    }
    void shut(bool is_shut) {
        const std::lock_guard lock(mutex_);
        shut_ = is_shut;
        changed_.notify_all();
    }
    int waited() const {
        const std::lock_guard lock(mutex_);
        return waited_;
    }

  private:
    mutable std::mutex mutex_;
    std::condition_variable changed_;
    bool shut_ = false;
    int waited_ = 0;
};

/// The Entity Manager's end of a signal lane that is no connection: what it sends the driver delivers.
class SignalLane final : public entity_manager::DirectLane {
  public:
    SignalLane(Signals& signals, std::shared_ptr<entity_manager::DirectSigns> signs,
               std::function<void(std::int64_t passed, bool asks)> beats, std::function<void()> closes)
        : signals_(signals), signs_(std::move(signs)), beats_(std::move(beats)), closes_(std::move(closes)) {}
    void send(Keeping, const Header&, std::shared_ptr<const std::string>) override {}  // receipts
    void beat(std::int64_t passed, bool asks) override {
        if (!closed_) signals_.toClient([beats = beats_, passed, asks] { beats(passed, asks); });
    }
    void close(const std::string&) override {
        if (!closed_.exchange(true)) signals_.toClient(closes_);
    }
    std::string peer() const override { return "the client"; }
    /// The client's beat.
    void heard(TimePoint now, std::int64_t received, bool busy) {
        if (closed_) return;
        signs_->heard(now, received, busy);
        beat(signs_->passed.load(std::memory_order_acquire), false);
    }

  private:
    Signals& signals_;
    const std::shared_ptr<entity_manager::DirectSigns> signs_;
    const std::function<void(std::int64_t, bool)> beats_;
    const std::function<void()> closes_;
    std::atomic<bool> closed_{false};
};

/// What the paths of one client share.
struct Surroundings {
    const Clock& clock;
    Signals& signals;
    Claims& claims;
    std::weak_ptr<ManagerEnd> manager;
    std::shared_ptr<client::LaneReaders> readers;
    transport::OutboxLimits limits;
    std::shared_ptr<client::Backlog> backlog = std::make_shared<client::Backlog>();
};

/// A direct path as NetworkPath: the real data lane, and Signals instead of Ice for the other one.
class LanePath final : public client::DirectPath,
                       private client::FramedLane::Owner,
                       public std::enable_shared_from_this<LanePath> {
  public:
    LanePath(Surroundings around, client::DirectOffer offer, Id128 number,
             std::weak_ptr<client::DirectPathEvents> events)
        : DirectPath(std::move(offer), number, around.clock),
          around_(std::move(around)),
          events_(std::move(events)) {}
    ~LanePath() override {
        if (data_) data_->end("it is no longer needed");
    }

    void open(Duration timeout) override {
        auto socket = direct::lane::LaneSocket::connectTo(offer_.data_endpoint);
        if (!socket.ok()) return close(socket.refusal().message);
        const auto bound = around_.limits.data_bytes + around_.limits.control_bytes +
                           around_.limits.window_bytes + 2 * direct::lane::kMessageFrameMax;
        auto lane = std::make_shared<client::FramedLane>(
            around_.readers, std::move(socket).value(),
            [](direct::lane::Wire& its) { return std::make_unique<direct::lane::PlainChannel>(its); },
            direct::lane::ClientOpening(
                claim(),
                [weak = weak_from_this()](const Id128& nonce) {
                    const auto self = weak.lock();
                    return self ? self->proofFor(Lane::Data, nonce) : std::string();
                },
                [weak = weak_from_this()](std::string_view proof) {
                    const auto self = weak.lock();
                    return self && self->trusts(proof);
                }),
            around_.limits,
            [backlog = around_.backlog, &claims = around_.claims, bound](std::size_t bytes) {
                backlog->add(bytes);
                claims.hold(backlog->bytes() <= bound, "no more waits for the data lane than may");
                return std::shared_ptr<void>(nullptr, [backlog, bytes](void*) { backlog->remove(bytes); });
            },
            clock_, std::shared_ptr<client::FramedLane::Owner>(shared_from_this(), this));
        bool late = false;
        {
            const std::lock_guard lock(mutex_);
            data_ = lane;
            late = ended_;
        }
        ++lanes;
        if (late) return lane->end("it has ended");
        lane->start(timeout);
    }
    std::string reason() const override {
        const std::lock_guard lock(mutex_);
        return reason_;
    }
    void close(const std::string& why) override {
        std::shared_ptr<client::FramedLane> data;
        {
            const std::lock_guard lock(mutex_);
            if (ended_) return;
            reason_ = why;
            ended_ = true;
            data = data_;
        }
        if (data) data->end(why);
        around_.signals.toManager([manager = around_.manager, number = number_] {
            if (const auto its = manager.lock()) its->signalClosed(number);
        });
        if (const auto events = events_.lock()) events->directChanged();
    }
    void send(Keeping keeping, const Header& head,
              std::shared_ptr<const std::string> message) const override {
        if (!isOpen()) return;
        if (keeping == Keeping::Kept) {  // under the lock of the sender
            unacknowledged_.add(head.sequence, message->size() + client::kMessageOverhead);
            unacknowledged_.acknowledged(acknowledged);
            around_.claims.hold(
                unacknowledged_.within(client::kKeptBounds.messages, client::kKeptBounds.bytes),
                "the client keeps no more than it may");
        }
        data_->send(keeping, head, message);
    }
    void sendStopSignal(const Header&, StopCause) const override {}
    void sendResetSignal(const Header&) const override {}
    void sendClearSignal(const Header&) const override {}
    void beat() const override {
        if (!isOpen()) return;
        around_.signals.toManager([signal = signal_, &clock = clock_,
                                   received = passed.load(std::memory_order_acquire),
                                   busy = liveness.busy()] { signal->heard(clock.now(), received, busy); });
    }
    /// The signal lane breaks at the other end.
    void breakSignals() {
        if (signal_) signal_->close("killed");
    }
    /// Data lanes that were begun, and how often one was over.
    static inline std::atomic<int> lanes{0}, overs{0};
    bool marked = false;  ///< of the client's lock: its beginning has come
    std::size_t held_messages = 0, held_bytes = 0;

  private:
    void laneOpen() override {
        entity_manager::DirectOpening its;
        const auto proof = proofFor(Lane::Signal, Id128::random(random_));
        its.claim = claim();
        its.proof = proof;
        auto* const signals = &around_.signals;
        its.admit = [weak = weak_from_this(), signals](
                        const Sender&, std::shared_ptr<entity_manager::DirectSigns> signs,
                        const std::string& answer) -> std::shared_ptr<entity_manager::DirectLane> {
            auto lane = std::make_shared<SignalLane>(
                *signals, std::move(signs),
                [weak](std::int64_t received, bool asks) {
                    if (const auto self = weak.lock(); self && !self->ended_) self->heard(received, asks);
                },
                [weak] {
                    if (const auto self = weak.lock()) self->close("its signal lane is closed");
                });
            signals->toClient([weak, lane, answer] {
                if (const auto self = weak.lock()) self->opened(lane, answer);
            });
            return lane;
        };
        its.refuse = [weak = weak_from_this(), signals](const Refusal& refusal) {
            signals->toClient([weak, why = refusal.message] {
                if (const auto self = weak.lock()) self->close(why);
            });
        };
        around_.signals.toManager([manager = around_.manager, its = std::move(its)] {
            if (const auto at = manager.lock()) at->directOpening(its);
        });
    }
    void opened(std::shared_ptr<SignalLane> lane, const std::string& proof) {
        if (ended_) return;
        if (!trusts(proof)) return close("a wrong proof");
        signal_ = std::move(lane);
        liveness.heard(clock_.now());
        open_ = true;
        if (const auto events = events_.lock()) events->directChanged();
    }
    void laneMessage(const direct::lane::MessageView& message) override {
        if (ended_) return;
        const auto events = events_.lock();
        if (!events) return;
        Header head;
        message.into(head);
        head.entity = entity();
        events->newDirectMsg(*this, message.keeping, std::move(head), message.content);
    }
    void laneRead() override {
        if (const auto events = events_.lock()) events->directRead();
    }
    void laneOver(const std::string& why) override {
        ++overs;
        around_.claims.hold(++over_ == 1, "the client is told once that a data lane is over");
        close(why);
    }

    const Surroundings around_;
    const std::weak_ptr<client::DirectPathEvents> events_;
    SystemRandom random_;
    std::shared_ptr<SignalLane> signal_;  // set before open_
    mutable Unacknowledged unacknowledged_;
    std::atomic<int> over_{0};
    mutable std::mutex mutex_;
    std::shared_ptr<client::FramedLane> data_;  // guarded by mutex_ until open_
    std::string reason_;                        // guarded by mutex_
};

/// A client as far as the direct path is concerned: DirectLinks and MessageSender under a lock, LaneReaders
/// and the queue of callbacks, as Client::Session has them. Threads: any, unless it says otherwise.
class ClientEnd final : public client::DirectPathEvents, public std::enable_shared_from_this<ClientEnd> {
  public:
    ClientEnd(const Clock& clock, Activity& activity, Relay& relay, Signals& signals, Claims& claims,
              Book& sends, Book& hears, std::shared_ptr<ManagerEnd> manager, transport::OutboxLimits limits,
              bool admits, Duration spin)
        : activity_(activity),
          relay_(relay),
          claims_(claims),
          sends_(sends),
          hears_(hears),
          admits_(admits),
          around_{
              clock, signals, claims, std::move(manager), std::make_shared<client::LaneReaders>(clock, spin),
              limits},
          links_(clock, 4,
                 [this](const client::DirectOffer& offer) {
                     return std::make_shared<LanePath>(around_, offer, Id128::random(random_),
                                                       weak_from_this());
                 }),
          messages_(
              clock, links_, [this] { sender_woken_ = true; }, [] {}) {}

    /// There is a session with the servers, under this name.
    void join(const std::string& name) {
        name_ = name;
        messages_.connect(std::make_shared<ServerLane>(relay_, name, around_.backlog));
        const std::lock_guard lock(mutex_);
        up_ = true;
    }
    /// Session::lost().
    void lose() {
        client::DirectLinks::Closing closing;
        {
            const std::lock_guard lock(mutex_);
            up_ = false;
            sends_.newSession();
            messages_.forget();
            closing = links_.clear();
        }
        for (const auto& path : closing) path->close("the session with the server is lost");
        messages_.connect(nullptr);
    }
    void offer(const entity_manager::LeaseBook::Held& its, const std::string& endpoint) {
        const std::lock_guard lock(mutex_);
        held_ = its.number;
        links_.offer({kEntity, its.number, its.key.bytes(), its.holder.id, endpoint, "none"});
    }
    void withdraw() {
        const std::lock_guard lock(mutex_);
        links_.withdraw({kEntity, held_});
    }
    /// Whether it was not refused.
    bool send(Keeping keeping, std::size_t size, std::int32_t answer, const char* type, bool here) {
        if (admits_ && messages_.admit(size).code != RefusalCode::Ok) return false;
        client::MessageSender::Leaving leaving;
        {
            const std::lock_guard lock(mutex_);
            if (!up_) return false;
            Header head;
            head.entity = kEntity;
            head.msg_type = type;
            head.held = held_;
            head.stop_generation = answer;
            head.sequence = ++sequence_;
            sends_.sent(keeping, head.sequence, size);
            auto content = Content::of(head.sequence, size);
            if (keeping == Keeping::Kept) {
                messages_.sendToEntity(head, std::move(content));
            } else {
                messages_.sendToEntityDataSeq(head, std::move(content));
            }
            leaving = messages_.collect(here);
        }
        messages_.depart(leaving);
        return true;
    }
    /// What the servers bring.
    void relayed(const Relay::Item& item) {
        {
            const std::lock_guard lock(mutex_);
            const auto deliver = [this](const Header& head, std::string_view bytes) {
                handle(head.msg_type == kMsgStream ? Keeping::Droppable : Keeping::Kept, head, bytes);
            };
            if (links_.relayed(item.keeping, item.head, item.bytes, deliver))
                handle(item.keeping, item.head, item.bytes);
            if (item.head.msg_type == kMsgWay && path_) path_->marked = true;
        }
        callbacks_.wake();
    }
    /// What the threads of a session do now and then: directTurn(), the sender's turn and beats.
    void turn(bool beats, bool moving) {
        while (true) {
            client::DirectLinks::Turn turn;
            {
                const std::lock_guard lock(mutex_);
                turn = links_.turn();
                for (const auto& [link, path] : turn.begun) {
                    proto::ToEntity mark;
                    mark.mutable_way()->set_path(path->number().bytes());
                    Header head;
                    head.entity = kEntity;
                    head.msg_type = kMsgWay;
                    head.sequence = ++sequence_;
                    messages_.sendMark(head, mark.SerializeAsString(), link, path);
                    ++begun;
                }
                for (const auto& path : turn.open) path_ = std::static_pointer_cast<LanePath>(path);
                messages_.depart(messages_.collect(false));
            }
            if (turn.ended) sender_woken_ = true;
            for (const auto& path : turn.begun) path.second->beat();
            for (const auto& path : turn.open) path->open(std::chrono::seconds{5});
            for (const auto& [path, why] : turn.close) path->close(why);
            if (turn.close.empty()) break;
        }
        if (sender_woken_.exchange(false)) messages_.sendAll();
        if (!beats) return;
        for (const auto& [entity, path] : *links_.paths()) path->beatIfDue(moving, true);
    }
    void refuseMark() {
        client::DirectLinks::Closing closing;
        {
            const std::lock_guard lock(mutex_);
            closing = links_.markRefused(kEntity);
        }
        for (const auto& path : closing) path->close("the servers refuse its beginning");
    }
    bool direct() const {
        const std::lock_guard lock(mutex_);
        return links_.direct(kEntity);
    }
    /// The last that was opened; null: none.
    std::shared_ptr<LanePath> path() const {
        const std::lock_guard lock(mutex_);
        return path_;
    }
    /// As Session::close(). Nobody may be in a callback for ever.
    void end() {
        lose();
        around_.readers->end();
        callbacks_.close();
        const std::lock_guard lock(mutex_);
        path_ = nullptr;
    }
    bool allCalledBack() const { return called_ == told_; }
    const std::string& name() const { return name_; }

    Gate gate;
    std::atomic<int> begun{0}, by_path{0}, held{0};

    // DirectPathEvents, as Session.
    void newDirectMsg(const client::DirectPath& path, Keeping keeping, Header head,
                      std::string_view message) override {
        client::DirectLinks::Arrival arrival;
        {
            const std::lock_guard lock(mutex_);
            messages_.breakBurst();
            arrival = links_.arrived(path, keeping, head, message);
            if (arrival.pass) {
                ++by_path;
                handle(keeping, head, message);
            } else if (path_.get() == &path && !path_->marked && !arrival.close && !path.ended()) {
                ++held;
                path_->held_bytes += message.size() + kHeadBytes;
                const direct::HeldBounds bounds;
                claims_.hold(++path_->held_messages <= bounds.messages && path_->held_bytes <= bounds.bytes,
                             "the client holds back no more than it may");
            }
        }
        if (arrival.close) arrival.close->close(arrival.why);
        if (arrival.acknowledge) path.beat();
    }
    void directRead() override { callbacks_.runHere(); }
    void newDirectReceipt(const client::DirectPath&, const Header&, std::string_view) override {}
    void directChanged() override {
        sender_woken_ = true;
        activity_.tell();
    }

  private:
    /// A session's data lane with the servers.
    class ServerLane final : public client::DataLane {
      public:
        ServerLane(Relay& relay, std::string name, std::shared_ptr<client::Backlog> backlog)
            : relay_(relay), name_(std::move(name)), backlog_(std::move(backlog)) {}
        void send(client::Operation kind, const Header& head, std::string bytes) const override {
            relay_.fromClient(
                name_, {kind == client::Operation::ToEntityDataSeq ? Keeping::Droppable : Keeping::Kept, head,
                        std::move(bytes)});
        }
        void add(client::Operation kind, const Header& head, std::string bytes) const override {
            send(kind, head, std::move(bytes));
        }
        void write() const override {}
        std::size_t waiting() const override { return backlog_->messages(); }
        std::size_t waitingBytes() const override { return backlog_->bytes(); }
        void awaitRoom(Duration) const override {}

      private:
        Relay& relay_;
        const std::string name_;
        const std::shared_ptr<client::Backlog> backlog_;
    };

    /// Under mutex_: what the core would hear, and a callback of the program's.
    void handle(Keeping keeping, const Header& head, std::string_view bytes) {
        proto::ToClient message;
        const bool good = message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size())) &&
                          message.raw().data_size() == 1;
        hears_.came(keeping, head.sequence, good ? std::string_view(message.raw().data(0)) : bytes);
        ++told_;
        const bool taken = callbacks_.post(
            [this, sequence = head.sequence, answer = head.stop_generation] {
                claims_.hold(inside_.exchange(true) == false, "one callback runs at a time");
                claims_.hold(sequence > std::exchange(last_called_, sequence), "callbacks run in order");
                gate.pass();
                if (answer > 0) send(Keeping::Kept, static_cast<std::size_t>(answer), 0, kMsgText, true);
                inside_ = false;
                ++called_;
                activity_.tell();
            },
            false);
        claims_.hold(taken, "the queue of callbacks has room");
        activity_.tell();
    }

    static constexpr std::size_t kHeadBytes = 200;  // DirectLinks's

    Activity& activity_;
    Relay& relay_;
    Claims& claims_;
    Book &sends_, &hears_;
    const bool admits_;
    SystemRandom random_;
    std::string name_;  // of the driver
    std::atomic<bool> sender_woken_{false};
    std::atomic<bool> inside_{false};
    std::int64_t last_called_ = 0;  // of whoever runs callbacks
    std::atomic<int> told_{0}, called_{0};

    mutable std::mutex mutex_;
    // Guarded by mutex_, as a session's core:
    Surroundings around_;
    client::DirectLinks links_;
    client::MessageSender messages_;
    client::CallbackQueue callbacks_;
    std::shared_ptr<LanePath> path_;
    LeaseNumber held_;
    std::int64_t sequence_ = 0;
    bool up_ = false;
};

}  // namespace axon::schedules
