// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/direct/direct_desk.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "common/planted_bug.hpp"
#include "direct/always_relayed.hpp"

namespace axon::entity_manager {

namespace {

using direct::Keeping;
using direct::Verdict;

constexpr std::size_t kHeadBytes = 200;  // that a message costs here besides its own
constexpr auto kWarnAgain = std::chrono::minutes{1};
/// Clients whose numbers are known. What is sent again comes within seconds of the end of a path, and each of
/// these has checked out since.
constexpr std::size_t kRows = 8;

}  // namespace

DirectDesk::DirectDesk(const Clock& clock, RelayedWay& server, Log log)
    : clock_(clock), server_(server), log_(std::move(log)) {}

DirectDesk::~DirectDesk() = default;

void DirectDesk::onOpening(const DirectOpening& opening, const LeaseBook::Held* held) {
    const auto& claim = opening.claim;
    // One answer for all of it: a stranger learns nothing of the lease.
    if (held == nullptr || held->grace_until || held->number != claim.lease ||
        Id128::parse(uuidOf(held->holder.id)) != claim.client ||
        (!direct::proves(opening.proof, claim, direct::Prover::Client, held->key.bytes()) &&
         !AXON_PLANTED(PathUnproved))) {
        if (const auto now = clock_.now(); now >= warn_from_) {
            warn_from_ = now + kWarnAgain;
            log_(true,
                 "a direct path was refused: expected the proof of the present lease's holder (told once a "
                 "minute)");
        }
        return opening.refuse({RefusalCode::PermissionDenied,
                               "A direct path is opened by the present holder, with the key of its lease. "
                               "Check the entity out first.",
                               {}});
    }
    const bool first = claim.lane == Lane::Data;
    if (!first && (!path_ || path_->number != claim.path || path_->signal))
        return opening.refuse({RefusalCode::WrongState,
                               "The signal lane of a direct path is opened after its data lane, once.",
                               {}});
    if (first) {
        end("the holder opens another one", Rest::SendAgain);
        auto& row = rowOf(held->holder.id);
        path_ = std::make_unique<Path>();
        path_->number = claim.path;
        path_->lease = held->number;
        path_->holder = held->holder;
        path_->signs = std::make_shared<DirectSigns>(clock_.now());
        path_->in = &row.in;
        path_->signs->passed = row.in.passed();
        row.in.open(claim.path);
    }
    auto& lane = first ? path_->data : path_->signal;
    lane = opening.admit(path_->holder, path_->signs,
                         direct::proofOf(claim, direct::Prover::EntityManager, held->key.bytes()));
    if (!first) begin();
}

/// Made where there is none; the last from now on.
DirectDesk::Row& DirectDesk::rowOf(const std::string& client) {
    const auto found =
        std::find_if(rows_.begin(), rows_.end(), [&](const Row& row) { return row.client == client; });
    if (found != rows_.end()) {
        rows_.splice(rows_.end(), rows_, found);
    } else {
        if (rows_.size() >= kRows) rows_.pop_front();
        rows_.push_back({client, {}});
    }
    return rows_.back();
}

void DirectDesk::begin() {
    proto::ToClient mark;
    mark.mutable_way()->set_path(path_->number.bytes());
    Header head;
    head.sender = path_->holder;
    head.entity = entity_;
    head.msg_type = kMsgWay;
    head.held = path_->lease;
    head.sent_at_us = toMicroseconds(clock_.now());
    server_.sendToClient(Lane::Data, head, mark);
    out_.begin();
    log_(false, "direct path to " + named(path_->holder) + " (" + path_->data->peer() + ")");
}

void DirectDesk::end(const std::string& why, Rest rest) {
    if (!path_) return;
    const auto ended = std::move(path_);
    for (const auto& lane : {ended->data, ended->signal})
        if (lane) lane->close(why);
    ended->in->close(ended->number);
    if (out_.direct()) log_(false, "the direct path to " + named(ended->holder) + " has ended: " + why);
    out_.acknowledged(ended->signs->acknowledged.load(std::memory_order_relaxed));
    auto left = out_.end();
    if (rest == Rest::Forget) return;
    for (const auto& kept : left)
        server_.sendToClientBytes(Lane::Data, kept.message.head, *kept.message.message);
}

void DirectDesk::hold(const LeaseBook::Held* held) {
    if (!path_) return;
    if (held != nullptr && held->number == path_->lease && held->holder.id == path_->holder.id) {
        // Its session has ended, and with it what the servers had under way to it.
        if (held->grace_until) end("the servers have lost the holder", Rest::Forget);
        return;
    }
    end("the lease has ended", Rest::SendAgain);
}

void DirectDesk::serverDown() {
    end("the session with the server is lost", Rest::Forget);
}

void DirectDesk::close() {
    end("the Entity Manager ends", Rest::Forget);
}

void DirectDesk::onClosed(const Id128& path, const std::string& why) {
    if (path_ && path_->number == path) end(why, Rest::SendAgain);
}

TimePoint DirectDesk::nextDeadline() const {
    if (!path_) return TimePoint::max();
    return std::min({path_->signs->liveness.deadline(), path_->mark_due, path_->answer_due});
}

void DirectDesk::onTimer() {
    if (!path_) return;
    const auto now = clock_.now();
    if (now >= path_->signs->liveness.deadline())
        return end("nothing was heard of the client", Rest::SendAgain);
    if (now >= path_->mark_due) {
        if (path_->in->holdsBack())
            return end("the servers have not brought its beginning in time", Rest::SendAgain);
        path_->mark_due = TimePoint::max();
    }
    if (now >= path_->answer_due) {
        if (path_->signs->liveness.last() < path_->asked_at)
            return end("the client does not answer", Rest::SendAgain);
        path_->answer_due = TimePoint::max();
        out_.acknowledged(path_->signs->acknowledged.load(std::memory_order_relaxed));
        if (out_.keptMessages() > 0) ask();
    }
}

bool DirectDesk::relayed(Keeping keeping, const Header& head, const std::string& bytes,
                         const Deliver& deliver) {
    if (rows_.empty() || direct::alwaysRelayed(head.msg_type)) return true;
    const auto row = std::find_if(rows_.begin(), rows_.end(), [&](const Row& one) {
        return one.client == head.sender.id || AXON_PLANTED(AnybodysNumbersCount);
    });
    if (row == rows_.end()) return true;
    if (head.msg_type == kMsgWay) {
        proto::ToEntity mark;
        const auto path = mark.ParseFromString(bytes) ? Id128::fromBytes(mark.way().path()) : std::nullopt;
        if (path) row->in.mark(*path, [&](Came came) { deliver(came.head, came.bytes); });
        acknowledge();
        return false;
    }
    const bool pass = row->in.relayed(keeping, head.sequence) == Verdict::Pass;
    acknowledge();
    return pass;
}

bool DirectDesk::arrived(const Id128& path, Keeping keeping, Header& head, std::string& bytes) {
    if (!path_ || path_->number != path) return false;  // what counts of it comes by the servers
    if (direct::alwaysRelayed(head.msg_type)) {
        end("a " + head.msg_type + " came by it, which goes by the servers", Rest::SendAgain);
        return false;
    }
    const auto size = bytes.size() + kHeadBytes;
    // Only what is held back is needed as one.
    Came came;
    const auto sequence = head.sequence;
    if (path_->in->waits()) came = {std::move(head), std::move(bytes)};
    switch (path_->in->direct(path, keeping, sequence, size, came)) {
        case Verdict::Pass:
            acknowledge();
            if (keeping == Keeping::Kept && unacknowledged_.add(size) && path_->signal)
                path_->signal->beat(path_->in->passed(), false);
            return true;
        case Verdict::HeldBack:
            if (path_->mark_due == TimePoint::max()) path_->mark_due = clock_.now() + direct::kMarkWithin;
            return false;
        case Verdict::Overflow:
            end("too much came before its beginning by the servers", Rest::SendAgain);
            return false;
        case Verdict::LeftOut:
            return false;
    }
    return false;
}

void DirectDesk::acknowledge() {
    if (path_) path_->signs->passed.store(path_->in->passed(), std::memory_order_release);
}

void DirectDesk::sendToClient(Lane lane, const Header& head, const proto::ToClient& message) {
    if (!path_ || head.sender.id != path_->holder.id || !out_.direct() ||
        direct::alwaysRelayed(head.msg_type))
        return server_.sendToClient(lane, head, message);
    auto bytes = std::make_shared<const std::string>(message.SerializeAsString());
    if (lane == Lane::Signal) {
        // Receipts go by all ways; whoever waits for them takes the first. All else of this lane is an
        // answer, and comes once.
        if (head.msg_type == kMsgReceipt) path_->signal->send(Keeping::Kept, head, bytes);
        return server_.sendToClientBytes(lane, head, *bytes);
    }
    const auto size = bytes->size() + kHeadBytes;
    out_.acknowledged(path_->signs->acknowledged.load(std::memory_order_relaxed));
    if (!out_.hasRoom(size)) {
        end("the client acknowledges too little", Rest::SendAgain);
        return server_.sendToClientBytes(lane, head, *bytes);
    }
    path_->data->send(Keeping::Kept, head, bytes);
    out_.keep(head.sequence, size, {head, std::move(bytes)});
    if (path_->answer_due == TimePoint::max()) ask();
}

/// A break is not to be found out by the idle beat only when something has gone into it.
void DirectDesk::ask() {
    path_->asked_at = clock_.now();
    path_->answer_due = path_->asked_at + direct::kAsks;
    path_->signal->beat(path_->in->passed(), true);
}

void DirectDesk::sendToClientDataSeq(const Header& head, const proto::ToClient& message) {
    if (!path_ || head.sender.id != path_->holder.id || !out_.direct())
        return server_.sendToClientDataSeq(head, message);
    path_->data->send(Keeping::Droppable, head,
                      std::make_shared<const std::string>(message.SerializeAsString()));
}

}  // namespace axon::entity_manager
