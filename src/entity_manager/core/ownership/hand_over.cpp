// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/ownership/hand_over.hpp"

#include <utility>

namespace axon::entity_manager {

bool HandOver::isOpenFor(const Sender& client, const std::string& request_id) const {
    return open_ && open_->claim.client.id == client.id && open_->claim.request_id == request_id;
}

bool HandOver::wasClosedFor(const Sender& client, const std::string& request_id) const {
    return !request_id.empty() && closed_client_ == client.id && closed_request_ == request_id;
}

Refusal HandOver::mayAsk(const std::string& holder) const {
    if (!open_) return {};
    return {RefusalCode::Reserved,
            named(open_->claim.client) + " asks " + holder + " for it already. Try again after the answer.",
            holder};
}

const HandOver::Question& HandOver::ask(Claim claim, bool waits, std::string reason,
                                        const HandOverPolicy& policy, TimePoint now) {
    open_ = Question{std::move(claim), waits, std::move(reason), now + policy.answer_within, policy.yield};
    return *open_;
}

std::optional<HandOver::Question> HandOver::take() {
    if (open_) {
        closed_client_ = open_->claim.client.id;
        closed_request_ = open_->claim.request_id;
    }
    return std::exchange(open_, std::nullopt);
}

std::optional<HandOver::Question> HandOver::expire(TimePoint now) {
    if (!open_ || now < open_->until) return std::nullopt;
    return take();
}

}  // namespace axon::entity_manager
