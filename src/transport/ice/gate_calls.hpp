// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/DispatchInterceptor.h>
#include <Ice/Ice.h>

#include <functional>
#include <memory>
#include <string>

namespace axon::transport {

/// Hands the calls of strangers to a gate, and tells of those that it cannot read: the contracts have no
/// refusal for them, so Ice answers and nobody hears of it. Without a gate it stands for all objects that
/// are not there. Threads: any.
class GateCalls final : public Ice::DispatchInterceptor {
  public:
    /// By which connection it came, and why it was refused; as often as strangers cause it.
    using Told = std::function<void(const Ice::Connection& connection, const std::string& why)>;

    /// `gate`: null: none is there.
    GateCalls(std::shared_ptr<Ice::Object> gate, Told told);
    bool dispatch(Ice::Request& request) override;

  private:
    const std::shared_ptr<Ice::Object> gate_;
    const Told told_;
};

/// The gate of an adapter, and what answers for objects that are not there.
void addGate(Ice::ObjectAdapter& adapter, const std::shared_ptr<Ice::Object>& gate, const std::string& name,
             const GateCalls::Told& told);

}  // namespace axon::transport
