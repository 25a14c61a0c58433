// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/topics/storm_topics.hpp"

#include <Ice/Ice.h>
#include <IceStorm/IceStorm.h>

#include <algorithm>
#include <set>
#include <stdexcept>

#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/link_trust.hpp"
#include "transport/ice/timer_thread.hpp"

namespace axon::transport {
namespace {

constexpr std::chrono::seconds kLook{1};
constexpr std::chrono::milliseconds kTryAgain{250};
constexpr std::chrono::seconds kLookForOthers{10};
constexpr int kPatienceMs = 2000;

/// As `manager` is written by a person, or null.
std::shared_ptr<Ice::ObjectPrx> parse(Ice::Communicator& communicator, const std::string& text) {
    try {
        return communicator.stringToProxy(text);
    } catch (const Ice::Exception&) {
        return nullptr;
    }
}

/// Who answers is somebody else.
class NoStorm : public std::runtime_error {
    using runtime_error::runtime_error;
};

template <class Prx>
std::shared_ptr<Prx> patient(const std::shared_ptr<Prx>& proxy) {
    return proxy->ice_timeout(kPatienceMs)->ice_invocationTimeout(kPatienceMs);
}

}  // namespace

class StormTopics::Search {
  public:
    Search(StormSettings settings, std::shared_ptr<Ice::Communicator> communicator, const Clock& clock,
           Changed changed, Note note)
        : settings_(std::move(settings)),
          communicator_(std::move(communicator)),
          clock_(clock),
          changed_(std::move(changed)),
          note_(std::move(note)) {
        const auto manager = parse(*communicator_, settings_.manager);
        if (!manager || manager->ice_getEndpoints().empty()) {
            throw std::runtime_error(
                "Server.TopicManager: '" + settings_.manager +
                "' is not a proxy with an address; expected IceStorm/TopicManager:tcp -h HOST -p PORT, with "
                "the endpoint of icebox's IceStorm.TopicManager.Endpoints");
        }
        manager_ = patient(Ice::uncheckedCast<IceStorm::TopicManagerPrx>(manager));
        subscriber_ = communicator_->stringToProxy(settings_.subscriber);
        thread_ = std::make_unique<TimerThread>("axon-storm", Lane::Data, Duration{}, clock_,
                                                [this] { return look(); });
    }

    ~Search() {
        thread_.reset();
        try {
            if (topic_) topic_->unsubscribe(subscriber_);
        } catch (const Ice::Exception&) {  // it is not there, and neither is the subscription
        }
    }

  private:
    TimePoint look() {
        try {
            if (!stands()) {
                auto publishers = join();
                complained_ = Complaint::None;
                note_("IceStorm was found; the topics to the other servers are ready");
                changed_(publishers);
            }
            lookForOthers();
            return clock_.now() + kLook;
        } catch (const NoStorm& other) {
            const auto before = std::exchange(complained_, Complaint::Impostor);
            lost();
            if (before != Complaint::Impostor)
                settings_.links->noteWrongServer(settings_.manager, other.what());
            return clock_.now() + kLook;
        } catch (const Ice::Exception& error) {
            lost();
            if (std::exchange(complained_, Complaint::OutOfReach) != Complaint::OutOfReach) {
                note_("IceStorm is out of reach (" + settings_.manager + ": " +
                      translate(std::current_exception(), settings_.links != nullptr).message +
                      "): only signals reach the other servers; fix: start icebox");
            }
            return clock_.now() + kTryAgain;
        }
    }

    void lost() {
        const bool stood = topic_ != nullptr;
        topic_ = nullptr;
        if (stood) changed_({});
    }

    /// As it is, or over the connection to who has shown that it is IceStorm.
    template <class Prx>
    std::shared_ptr<Prx> reached(const std::shared_ptr<Prx>& proxy) const {
        if (!over_) return patient(proxy);
        return Ice::uncheckedCast<Prx>(over_->createProxy(proxy->ice_getIdentity()))
            ->ice_invocationTimeout(kPatienceMs);
    }
    std::shared_ptr<IceStorm::TopicManagerPrx> manager() const { return reached(manager_); }

    void connect() {
        if (settings_.links == nullptr) return;
        over_ = manager_->ice_secure(true)->ice_connectionCached(false)->ice_getConnection();
        if (const auto why = notServer(*over_, certificates::Kind::Storm, {})) {
            over_->close(Ice::ConnectionClose::Forcefully);
            throw NoStorm(*why);
        }
    }

    /// Whether all is as it was left: IceStorm may have been started anew in between and know nothing of it.
    bool stands() {
        if (!topic_) return false;
        try {
            for (const auto& topic : published_) topic->ice_ping();
            const auto subscribers = topic_->getSubscribers();
            return std::find(subscribers.begin(), subscribers.end(), subscriber_->ice_getIdentity()) !=
                   subscribers.end();
        } catch (const Ice::ObjectNotExistException&) {
            return false;
        }
    }

    /// Servers of other editions hear nothing of this one, and it of them. What they do with their topics
    /// meanwhile is no failure of ours.
    void lookForOthers() {
        if (clock_.now() < look_for_others_) return;
        look_for_others_ = clock_.now() + kLookForOthers;
        try {
            for (const auto& [name, topic] : manager()->retrieveAll()) {
                const auto contract = contractOfOther(settings_.subscribe_to, name);
                if (!contract || others_.contains(*contract) || reached(topic)->getSubscribers().empty())
                    continue;
                others_.insert(*contract);
                note_("there are subscriptions of servers of contract " + std::to_string(*contract) +
                      " at this IceStorm; this server has contract " +
                      contractContext().at(kContextContract) +
                      ", so they and this server do not see each other; fix: upgrade the servers with the "
                      "smaller number, or restart icebox if they no longer run");
            }
        } catch (const Ice::Exception&) {
        }
    }

    std::vector<std::string> join() {
        topic_ = nullptr;
        published_.clear();
        connect();
        const auto topic = find(settings_.subscribe_to);
        topic->unsubscribe(subscriber_);  // what an earlier start has left behind leads to another port
        try {
            topic->subscribeAndGetPublisher({{"reliability", "ordered"}, {"retryCount", "-1"}}, subscriber_);
        } catch (
            const IceStorm::AlreadySubscribed&) {  // by another thread of IceStorm, a moment ago: it stands
        }
        std::vector<std::string> publishers;
        for (const auto& name : settings_.publish_to) {
            published_.push_back(find(name));
            publishers.push_back(published_.back()->getPublisher()->ice_toString());
        }
        topic_ = topic;
        return publishers;
    }

    std::shared_ptr<IceStorm::TopicPrx> find(const std::string& topic) {
        const auto name = ofContract(topic);
        while (true) {
            try {
                return reached(manager()->retrieve(name));
            } catch (const IceStorm::NoSuchTopic&) {
            }
            try {
                return reached(manager()->create(name));
            } catch (const IceStorm::TopicExists&) {  // another server was faster
            }
        }
    }

    const StormSettings settings_;
    const std::shared_ptr<Ice::Communicator> communicator_;
    const Clock& clock_;
    const Changed changed_;
    const Note note_;
    std::shared_ptr<IceStorm::TopicManagerPrx> manager_;
    std::shared_ptr<Ice::ObjectPrx> subscriber_;
    // Of its thread:
    std::shared_ptr<Ice::Connection> over_;      // null: the links are plain
    std::shared_ptr<IceStorm::TopicPrx> topic_;  // null: searching
    std::vector<std::shared_ptr<IceStorm::TopicPrx>> published_;
    enum class Complaint : std::uint8_t { None, OutOfReach, Impostor } complained_ = Complaint::None;
    std::set<int> others_;  // of which it was told
    TimePoint look_for_others_;
    std::unique_ptr<TimerThread> thread_;
};

StormTopics::StormTopics(StormSettings settings, std::shared_ptr<Ice::Communicator> communicator,
                         const Clock& clock, Changed changed, Note note)
    : search_(std::make_unique<Search>(std::move(settings), std::move(communicator), clock,
                                       std::move(changed), std::move(note))) {}

StormTopics::~StormTopics() = default;

}  // namespace axon::transport
