// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <string>
#include <string_view>

#include "transport/convert.hpp"
#include "transport/outbox.hpp"

namespace axon::transport {

/// A oneway proxy and the Outbox in front of it: what each callback adapter sends with. Threads: any.
template <class Prx>
class CallbackSender {
  public:
    CallbackSender(std::shared_ptr<Prx> proxy, OutboxLimits limits, Outbox::Disconnect disconnect)
        : proxy_(std::move(proxy)), outbox_(std::make_shared<Outbox>(limits, std::move(disconnect))) {}

    /// `call(prx, head, bytes, failed, sent)` makes the asynchronous call. It is copied when the message must
    /// wait, so it captures by value.
    template <class Call>
    void send(Traffic traffic, const Header& head, std::string_view bytes, Call call) const {
        outbox_->post(
            traffic, kOverhead + stringBytes(head) + bytes.size(),
            [&](SendCallbacks&& back) {
                call(*proxy_, toIce(head), toRange(bytes), std::move(back.failed), std::move(back.sent));
            },
            [&] {
                return Outbox::Parcel([proxy = proxy_, call, its_head = toIce(head),
                                       its_bytes = std::string(bytes)](SendCallbacks&& back) {
                    call(*proxy, its_head, toRange(its_bytes), std::move(back.failed), std::move(back.sent));
                });
            });
    }

    /// `call(prx, failed, sent)`, for operations without a header.
    template <class Call>
    void send(Traffic traffic, std::size_t bytes, Call call) const {
        outbox_->post(
            traffic, kOverhead + bytes,
            [&](SendCallbacks&& back) { call(*proxy_, std::move(back.failed), std::move(back.sent)); },
            [&] {
                return Outbox::Parcel([proxy = proxy_, call](SendCallbacks&& back) {
                    call(*proxy, std::move(back.failed), std::move(back.sent));
                });
            });
    }

    void close() const { outbox_->close(); }
    OutboxCounts counts() const { return outbox_->counts(); }

  private:
    static constexpr std::size_t kOverhead = 256;  // Ice's header and ours, about

    const std::shared_ptr<Prx> proxy_;
    const std::shared_ptr<Outbox> outbox_;
};

}  // namespace axon::transport
