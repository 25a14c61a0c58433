// SPDX-License-Identifier: GPL-2.0-or-later
// Whatever is said at an Entity Manager's doors for direct paths, by strangers and by the holder itself:
// nobody gets in without the key, what passes has the holder as its sender and passes once and in order, and
// strangers do not end the holder's path. All goes over loopback, signals through Ice. The input is sayings
// of a byte for whom they are said to, a byte for the operation, two for the length, then what Ice calls the
// encapsulation's content, or what goes into a data lane: bytes as they are, or the content of a frame whose
// kind is the operation (to the servers' way and for openings: see below).
#include <Ice/Ice.h>
#include <axon/directcomm.h>
#include <axon/messages.pb.h>
#include <spdlog/spdlog.h>

#include <array>
#include <asio/any_io_executor.hpp>
#include <asio/post.hpp>
#include <asio/strand.hpp>
#include <asio/thread_pool.hpp>
#include <cstdint>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "claim.hpp"
#include "direct/always_relayed.hpp"
#include "direct/proof.hpp"
#include "entity_manager/links/direct/direct_desk.hpp"
#include "entity_manager/links/direct/direct_door.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "support/lane_stranger.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/convert.hpp"

namespace {

using namespace axon;
using namespace axon::entity_manager;
namespace slice = ::Axon::DirectComm;

const std::string kEntity = "00000000-0000-4000-8000-000000000001";
const Sender kHolder{"11111111-1111-4111-8111-111111111111", "honest@lab", Role::Operator};
const std::string kHolderUuid = "11111111-1111-4111-8111-111111111111";
// Two of them are of the edition before.
const std::vector<std::string> kOperations{"challenge",           "open",           "sendToEntity",
                                           "sendToEntityDataSeq", "sendStopSignal", "sendResetSignal",
                                           "sendClearSignal",     "keepAlive"};
const std::vector<const char*> kTypes{kMsgTask, kMsgWay, kMsgCheckOut, kMsgRearm, kMsgRelease, kMsgText};

std::map<std::string, std::string> quiet() {
    return {{"Ice.Warn.Dispatch", "0"}, {"Ice.Warn.Connections", "0"}, {"Ice.RetryIntervals", "-1"}};
}

struct Servers final : RelayedWay {
    void wantConnection(bool) override {}
    void sendBasicPrfl(const Registration&, const proto::BasicProfile&) override {}
    void sendStatus(const EntityStatus&) override {}
    void sendToClient(Lane, const Header&, const proto::ToClient&) override {}
    void sendToPeer(Lane, const Header&, const proto::ToEntity&) override {}
    void sendToClientDataSeq(const Header&, const proto::ToClient&) override {}
    void sendToClientBytes(Lane, const Header&, const std::string&) override {}
};

/// The desk of one run, and what the core has heard of. No time passes.
struct Manager {
    ManualClock clock;
    Servers servers;
    DirectDesk desk{clock, servers, [](bool, const std::string&) {}};
    LeaseBook::Held held{};
    std::int64_t last = 0;
};

/// As EntityManager's, with the desk on the strand. Outlives each run.
class Events final : public DirectEvents, public std::enable_shared_from_this<Events> {
  public:
    explicit Events(asio::any_io_executor strand) : strand_(std::move(strand)) {}

    void directOpening(DirectOpening opening) override {
        asio::post(strand_, [self = shared_from_this(), opening = std::move(opening)]() mutable {
            self->judge(std::move(opening));
        });
    }
    void judge(DirectOpening opening) {
        const std::lock_guard lock(mutex);
        if (manager == nullptr) return opening.refuse({RefusalCode::WrongState, "between two runs", {}});
        bool admitted = false;
        const auto admit = std::exchange(opening.admit, {});
        opening.admit = [&](const Sender& sender, std::shared_ptr<DirectSigns> signs, std::string proof) {
            require(sender.id == kHolder.id, "a path is its holder's");
            admitted = true;
            return admit(sender, std::move(signs), std::move(proof));
        };
        manager->desk.onOpening(opening, &manager->held);
        require(!admitted || direct::proves(opening.proof, opening.claim, direct::Prover::Client,
                                            manager->held.key.bytes()),
                "nobody is let in without the key");
        require(!admitted || honest, "a stranger is not let in");
    }
    bool directMsg(const Id128& path, direct::Keeping keeping, Header& head, std::string& bytes) override {
        const std::lock_guard lock(mutex);
        if (manager == nullptr) return true;
        require(head.sender.id == kHolder.id && head.entity == kEntity,
                "who sends is who the lane was opened for");
        const auto sequence = head.sequence;
        const auto msg_type = head.msg_type;
        if (manager->desk.arrived(path, keeping, head, bytes)) {
            require(!direct::alwaysRelayed(msg_type), "what the servers must see comes by them");
            passed(keeping, sequence);
        }
        return true;
    }
    void directTurnEnded() override {}
    void directStop(Header head, StopCause cause) override {
        require(head.sender.id == kHolder.id && head.entity == kEntity,
                "who stops is who the lane was opened for");
        require(cause == StopCause::Requested || cause == StopCause::Drill,
                "no client says what only servers may");
        require(head.sequence < kServerSequences, "no client takes the servers' numbers");
    }
    void directReset(Header head) override {
        require(head.sender.id == kHolder.id, "who resets is who the lane was opened for");
    }
    void directClear(Header head) override {
        require(head.sender.id == kHolder.id, "who clears is who the lane was opened for");
    }
    void directPace() override {}
    void directClosed(const Id128& path, const std::string& why) override {
        asio::post(strand_, [self = shared_from_this(), path, why] {
            const std::lock_guard lock(self->mutex);
            if (self->manager != nullptr) self->manager->desk.onClosed(path, why);
        });
    }
    /// On the strand, where the desk ends its lanes.
    void forget() {
        std::promise<void> done;
        asio::post(strand_, [&] {
            const std::lock_guard lock(mutex);
            manager->desk.close();
            manager = nullptr;
            done.set_value();
        });
        done.get_future().wait();
    }
    /// Under the mutex. Since the first mark.
    void passed(direct::Keeping keeping, std::int64_t sequence) {
        if (keeping != direct::Keeping::Kept) return;
        require(sequence > manager->last, "what may not be lost passes once and in order");
        manager->last = sequence;
    }

    std::mutex mutex;
    Manager* manager = nullptr;  // guarded by mutex, as what it points to
    bool honest = false;         // who knocks is the holder

  private:
    const asio::any_io_executor strand_;
};

class Deaf final : public slice::DirectCallback {
    void newEntityMsg(slice::Head, transport::ByteRange, const Ice::Current&) override {}
    void newHeartbeat(double, bool, const Ice::Current&) override {}
};

/// The signal lane at whoever knocks.
class Knocker {
  public:
    Knocker(Ice::Communicator& communicator, const std::string& endpoint) {
        adapter_ = communicator.createObjectAdapter("");
        adapter_->activate();
        callback_ =
            Ice::uncheckedCast<slice::DirectCallbackPrx>(adapter_->addWithUUID(std::make_shared<Deaf>()));
        gate_ = Ice::uncheckedCast<slice::DirectGatePrx>(
            communicator.stringToProxy("DirectGate:" + transport::tcpEndpoint(endpoint))
                ->ice_connectionId(Ice::generateUUID()));
    }
    /// Over a new connection from now on: that of the last run may be closed, or be about to.
    void renew() {
        if (const auto connection = gate_->ice_getCachedConnection())
            connection->close(Ice::ConnectionClose::Forcefully);
        gate_ = Ice::uncheckedCast<slice::DirectGatePrx>(gate_->ice_connectionId(Ice::generateUUID()));
    }
    /// With a right nonce, and all else as it is said. The session, or null.
    std::shared_ptr<Ice::ObjectPrx> open(direct::Claim claim, const std::string& key,
                                         std::uint8_t spoilt = 255) {
        const auto nonce = gate_->challenge();
        claim.lane = Lane::Signal;
        claim.nonce = Id128::fromBytes({reinterpret_cast<const char*>(nonce.data()), nonce.size()}).value();
        auto proof = direct::proofOf(claim, direct::Prover::Client, key);
        if (spoilt < proof.size()) proof[spoilt] = static_cast<char>(proof[spoilt] ^ 1);
        const auto connection = gate_->ice_getCachedConnection();
        connection->setAdapter(adapter_);
        slice::Opening opening;
        opening.lane = transport::toIce(claim.lane);
        opening.held = {claim.lease.epoch, claim.lease.number};
        opening.client = claim.client.toString();
        const auto path = claim.path.bytes();
        opening.path.assign(path.begin(), path.end());
        opening.proof.assign(proof.begin(), proof.end());
        const auto opened = gate_->open(opening, callback_);
        return connection->createProxy(opened.session->ice_getIdentity());
    }
    const std::shared_ptr<slice::DirectGatePrx>& gate() const { return gate_; }

  private:
    std::shared_ptr<Ice::ObjectAdapter> adapter_;
    std::shared_ptr<slice::DirectCallbackPrx> callback_;
    std::shared_ptr<slice::DirectGatePrx> gate_;
};

/// A data lane of the holder's, or whoever tries to open one; `spoilt`: a byte of the proof.
std::unique_ptr<test::LaneStranger> knock(const std::string& endpoint, const direct::Claim& claim,
                                          const std::string& key, RefusalCode& answer,
                                          std::uint8_t spoilt = 255) {
    auto lane = std::make_unique<test::LaneStranger>(endpoint);
    lane->claim = claim;
    lane->awaitNonce();
    auto proof = direct::proofOf(lane->claim, direct::Prover::Client, key);
    if (spoilt < proof.size()) proof[spoilt] = static_cast<char>(proof[spoilt] ^ 1);
    lane->say(lane->claimFrame(proof));
    answer = lane->awaitAnswer();
    return lane;
}

/// What all runs share: doors that are open, and the connections of signal lanes.
struct Place {
    Place() {
        spdlog::set_level(spdlog::level::off);
        door = std::make_unique<DirectDoor>(strand, *ice, "127.0.0.1", DirectSettings{}, kEntity, clock,
                                            events, nullptr);
        communicator = transport::makeCommunicator({"axon-fuzz", Lane::Data, 1, 1, quiet()});
        for (auto& knocker : signal)
            knocker = std::make_unique<Knocker>(*communicator.communicator(), door->signalEndpoint());
    }
    ~Place() {
        communicator->destroy();
        ice->destroy();
        executor.stop();
        executor.join();
    }
    SteadyClock clock;
    SeededRandom random{1};
    asio::thread_pool executor{1};
    const asio::strand<asio::any_io_executor> strand{executor.get_executor()};
    const std::shared_ptr<ServerCommunicators> ice = std::make_shared<ServerCommunicators>(1, 1, quiet());
    const std::shared_ptr<Events> events = std::make_shared<Events>(strand);
    std::unique_ptr<DirectDoor> door;
    Ice::CommunicatorHolder communicator;
    std::array<std::unique_ptr<Knocker>, 2> signal;  // of the holder, and of a stranger
};

void call(const std::shared_ptr<Ice::ObjectPrx>& whom, const std::string& operation,
          const std::string& content) {
    const auto whole = static_cast<std::uint32_t>(content.size() + 6);
    std::vector<Ice::Byte> in;
    for (unsigned shift = 0; shift < 32; shift += 8) in.push_back(static_cast<Ice::Byte>(whole >> shift));
    in.insert(in.end(), {1, 1});
    in.insert(in.end(), content.begin(), content.end());
    std::vector<Ice::Byte> answer;
    try {
        whom->ice_invoke(operation, Ice::OperationMode::Normal, in, answer);
    } catch (const Ice::Exception&) {  // it cannot be read, is refused, or ends the connection
    }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    // Destroyed before anything static: until then, Ice's threads use statics of Ice that the first input
    // made.
    thread_local Place place;
    auto& events = *place.events;
    for (const auto& knocker : place.signal) knocker->renew();
    Manager manager;
    manager.held.number = {3, 7};
    manager.held.key = Id128::random(place.random);
    manager.held.holder = kHolder;
    {
        const std::lock_guard lock(events.mutex);
        events.manager = &manager;
        events.honest = true;
    }
    direct::Claim claim{
        Lane::Data, manager.held.number, Id128::parse(kHolderUuid).value(), Id128::random(place.random), {}};
    const std::string key = manager.held.key.bytes();
    auto answer = RefusalCode::Internal;
    const auto by_data = knock(place.door->dataEndpoint(), claim, key, answer);
    require(answer == RefusalCode::Ok, "the holder is let in");
    const auto by_signal = place.signal[0]->open(claim, key);
    std::unique_ptr<test::LaneStranger> stranger;
    const auto say = [](test::LaneStranger& to, std::uint8_t kind, const std::string& content) {
        to.say(kind >= 128 ? content : direct::lane::frameOf(static_cast<direct::lane::Kind>(kind), content));
    };
    const auto deliver = [&](const Header& head, const std::string&) {
        events.passed(direct::Keeping::Kept, head.sequence);
    };
    const auto byServers = [&](const Sender& sender, const char* msg_type, std::int64_t sequence,
                               const std::string& message) {
        Header head;
        head.sender = sender;
        head.entity = kEntity;
        head.msg_type = msg_type;
        head.sequence = sequence;
        const std::lock_guard lock(events.mutex);
        const bool passes = manager.desk.relayed(direct::Keeping::Kept, head, message, deliver);
        require(passes || sender.id == kHolder.id, "what others send by the servers is the core's to judge");
        require(!passes || sender.id != kHolder.id || std::string_view(msg_type) != kMsgWay,
                "marks are the desk's");
        if (passes && sender.id == kHolder.id && !direct::alwaysRelayed(msg_type))
            events.passed(direct::Keeping::Kept, sequence);
    };
    proto::ToEntity mark;
    mark.mutable_way()->set_path(claim.path.bytes());
    byServers(kHolder, kMsgWay, 1, mark.SerializeAsString());
    {
        const std::lock_guard lock(events.mutex);
        events.honest = false;
        require(manager.desk.direct(), "the holder has its path");
    }

    bool holder_is_odd = false;
    for (std::size_t at = 0; at + 4 <= size && at < 16 * 1024U;) {
        const auto door = bytes[at] % 7;
        const auto kind = bytes[at + 1];
        const auto length = std::min<std::size_t>(bytes[at + 2] + 256U * bytes[at + 3], size - at - 4);
        const std::string content(reinterpret_cast<const char*>(bytes + at + 4), length);
        at += 4 + length;
        const auto& operation = kOperations[kind % kOperations.size()];
        switch (door) {
            case 0:
                if (!stranger) stranger = std::make_unique<test::LaneStranger>(place.door->dataEndpoint());
                say(*stranger, kind, content);
                break;
            case 1:
                call(place.signal[1]->gate(), operation, content);
                break;
            case 2:
                holder_is_odd = true;
                say(*by_data, kind, content);
                break;
            case 3:
                holder_is_odd = true;
                call(by_signal, operation, content);
                break;
            case 4: {  // the servers' way: kind says who and under what name, the first eight bytes are the
                       // number
                std::int64_t sequence = 0;
                for (std::size_t i = 0; i < 8 && i < length; ++i)
                    sequence = sequence << 8 | bytes[at - length + i];
                const bool other = kind % 2 == 1;
                const Sender somebody{"22222222-2222-4222-8222-222222222222", "stranger", Role::Operator};
                holder_is_odd = holder_is_odd || !other;
                byServers(other ? somebody : kHolder, kTypes[kind / 2U % kTypes.size()], sequence,
                          content.substr(std::min<std::size_t>(8, length)));
                break;
            }
            default: {  // a proof of its own with one thing wrong, which kind chooses
                auto wrong = claim;
                wrong.path = Id128::random(place.random);
                auto its_key = key;
                std::uint8_t spoilt = 255;
                switch (kind % 5) {
                    case 0:
                        wrong.lease.number += 1 + kind / 5;
                        break;
                    case 1:
                        wrong.lease.epoch -= 1 + kind / 5;
                        break;
                    case 2:
                        wrong.client = Id128::random(place.random);
                        break;
                    case 3:
                        its_key = Id128::random(place.random).bytes();
                        break;
                    default:
                        spoilt = static_cast<std::uint8_t>(kind % 32);
                        break;
                }
                if (door == 5) {
                    knock(place.door->dataEndpoint(), wrong, its_key, answer, spoilt);
                    require(answer != RefusalCode::Ok, "whoever gets something wrong is refused");
                    break;
                }
                try {
                    place.signal[1]->open(wrong, its_key, spoilt);
                    require(false, "whoever gets something wrong is refused");
                } catch (const Ice::UserException&) {
                } catch (const Ice::LocalException&) {  // its connection was closed
                }
            }
        }
    }
    const auto awaitEnd = [](test::LaneStranger& lane) {
        lane.finish();
        require(lane.awaitClosed(), "what was said is read, and the connection closed");
    };
    if (stranger) awaitEnd(*stranger);
    {
        const std::lock_guard lock(events.mutex);
        require(holder_is_odd || manager.desk.direct(), "strangers do not end the holder's path");
    }
    awaitEnd(*by_data);
    events.forget();
    return 0;
}
