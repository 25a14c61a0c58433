// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/broken_protocol.hpp"

#include <Ice/Instrumentation.h>
#include <IceSSL/IceSSL.h>

#include <mutex>
#include <utility>

#include "common/refused_connection.hpp"
#include "transport/ice/ip_layer.hpp"

namespace axon::transport {
namespace {

namespace watched = Ice::Instrumentation;
using Told = std::function<void(const std::string&, const std::string&, const std::string&)>;

struct Where {
    std::string peer, adapter;
    bool in_handshake = false;  // of TLS, which is told elsewhere
};

Where whereOf(const std::shared_ptr<Ice::ConnectionInfo>& info) {
    Where its;
    its.peer = "an unknown address";
    for (auto layer = info; layer; layer = layer->underlying) {
        if (!layer->adapterName.empty()) its.adapter = layer->adapterName;
        if (const auto tls = std::dynamic_pointer_cast<IceSSL::ConnectionInfo>(layer))
            its.in_handshake = tls->cipher.empty();
        if (const auto ip = std::dynamic_pointer_cast<Ice::IPConnectionInfo>(layer))
            its.peer = remoteEnd(*ip);
    }
    return its;
}

class Strangers;

/// Of one incoming connection.
class Watch final : public watched::ConnectionObserver {
  public:
    Watch(std::shared_ptr<const Strangers> of, Where where) : of_(std::move(of)), where_(std::move(where)) {}
    void attach() override {}
    void detach() override {}
    void sentBytes(int) override {}
    void receivedBytes(int) override {}
    void failed(const std::string& exception) override;

  private:
    const std::shared_ptr<const Strangers> of_;
    const Where where_;
};

/// Ice asks it for an observer of everything; only incoming connections have one, so that calls cost nothing.
class Strangers final : public watched::CommunicatorObserver, public std::enable_shared_from_this<Strangers> {
  public:
    std::shared_ptr<watched::Observer> getConnectionEstablishmentObserver(
        const std::shared_ptr<Ice::Endpoint>&, const std::string&) override {
        return nullptr;
    }
    std::shared_ptr<watched::Observer> getEndpointLookupObserver(
        const std::shared_ptr<Ice::Endpoint>&) override {
        return nullptr;
    }
    std::shared_ptr<watched::ConnectionObserver> getConnectionObserver(
        const std::shared_ptr<Ice::ConnectionInfo>& info, const std::shared_ptr<Ice::Endpoint>&,
        watched::ConnectionState, const std::shared_ptr<watched::ConnectionObserver>&) override {
        if (!info || !info->incoming) return nullptr;
        return std::make_shared<Watch>(shared_from_this(), whereOf(info));
    }
    std::shared_ptr<watched::ThreadObserver> getThreadObserver(
        const std::string&, const std::string&, watched::ThreadState,
        const std::shared_ptr<watched::ThreadObserver>&) override {
        return nullptr;
    }
    std::shared_ptr<watched::InvocationObserver> getInvocationObserver(const std::shared_ptr<Ice::ObjectPrx>&,
                                                                       const std::string&,
                                                                       const Ice::Context&) override {
        return nullptr;
    }
    std::shared_ptr<watched::DispatchObserver> getDispatchObserver(const Ice::Current&, int) override {
        return nullptr;
    }
    void setObserverUpdater(const std::shared_ptr<watched::ObserverUpdater>&) override {}

    void tell(Told told) {
        const std::lock_guard lock(mutex_);
        told_ = std::move(told);
    }
    void failed(const Where& where, const std::string& exception) const {
        if (where.in_handshake) return;
        const auto* const means = meaningOfProtocolError(exception);
        if (means == nullptr) return;
        Told told;
        {
            const std::lock_guard lock(mutex_);
            told = told_;
        }
        if (told) told(where.peer, where.adapter, means);
    }

  private:
    mutable std::mutex mutex_;
    Told told_;  // guarded by mutex_
};

void Watch::failed(const std::string& exception) {
    of_->failed(where_, exception);
}

}  // namespace

void prepareBrokenProtocol(Ice::InitializationData& init) {
    init.observer = std::make_shared<Strangers>();
}

void onBrokenProtocol(const std::shared_ptr<Ice::Communicator>& communicator, Told told) {
    if (const auto its = std::dynamic_pointer_cast<Strangers>(communicator->getObserver()))
        its->tell(std::move(told));
}

}  // namespace axon::transport
