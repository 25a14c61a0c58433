// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <string>
#include <string_view>

#include "transport/ice/convert.hpp"
#include "transport/outbox/header_scratch.hpp"
#include "transport/outbox/outbox.hpp"

namespace axon::transport {

/// A proxy of a callback or session and the Outbox in front of it: what callback adapters, and Entity
/// Managers' sessions, send with. Oneway, but for messages that are to be answered (Until). Threads: any.
template <class Prx>
class ProxySender {
  public:
    ProxySender(const std::shared_ptr<Prx>& oneway, OutboxLimits limits, Until until,
                Outbox::Disconnect disconnect)
        : proxies_{oneway, oneway->ice_twoway()},
          outbox_(std::make_shared<Outbox>(limits, std::move(disconnect), until)) {}

    /// `call(prx, head, bytes, answered, failed, sent)` makes the asynchronous call. It is copied when the
    /// message must wait, so it captures by value. Returns false, and sends nothing, beyond the share of
    /// `from`.
    template <class Call>
    bool send(Traffic traffic, const Header& head, std::string_view bytes, Call call,
              SenderKey from = kServersOwn) const {
        return outbox_->post(
            traffic, kOverhead + stringBytes(head) + bytes.size(),
            [&](SendCallbacks&& back) {
                auto& prx = proxies_.of(back);  // before `answered` is moved from
                call(prx, HeaderScratch::ofThread().of(head), toRange(bytes), std::move(back.answered),
                     std::move(back.failed), std::move(back.sent));
            },
            [&] {
                return Outbox::Parcel([proxies = proxies_, call, its_head = toIce(head),
                                       its_bytes = std::string(bytes)](SendCallbacks&& back) {
                    auto& prx = proxies.of(back);
                    call(prx, its_head, toRange(its_bytes), std::move(back.answered), std::move(back.failed),
                         std::move(back.sent));
                });
            },
            from);
    }

    /// `call(prx, answered, failed, sent)`, for operations without a header.
    template <class Call>
    bool send(Traffic traffic, std::size_t bytes, Call call) const {
        return outbox_->post(
            traffic, kOverhead + bytes,
            [&](SendCallbacks&& back) {
                auto& prx = proxies_.of(back);  // before `answered` is moved from
                call(prx, std::move(back.answered), std::move(back.failed), std::move(back.sent));
            },
            [&] {
                return Outbox::Parcel([proxies = proxies_, call](SendCallbacks&& back) {
                    auto& prx = proxies.of(back);
                    call(prx, std::move(back.answered), std::move(back.failed), std::move(back.sent));
                });
            });
    }

    void sendAll() const { outbox_->sendAll(); }
    void close() const { outbox_->close(); }
    bool closed() const { return outbox_->closed(); }
    OutboxCounts counts() const { return outbox_->counts(); }

  private:
    static constexpr std::size_t kOverhead = 256;  // Ice's header and ours, about

    struct Proxies {
        std::shared_ptr<Prx> oneway, twoway;
        Prx& of(const SendCallbacks& back) const { return back.answered ? *twoway : *oneway; }
    };
    const Proxies proxies_;
    const std::shared_ptr<Outbox> outbox_;
};

}  // namespace axon::transport
