// SPDX-License-Identifier: GPL-2.0-or-later
#include "datagrams/stop_sentry.hpp"

#include <algorithm>

namespace axon::datagrams {

void StopSentry::hold(LeaseNumber lease, std::string_view key, const Sender& holder) {
    if (told_ && told_->lease == lease && told_->holders.front().sender.id == holder.id) return;
    const auto id = Id128::parse(uuidOf(holder.id));
    // Who has no session UUID sends no datagrams. Where it resumed a lease, that goes on without them.
    if (!id || key.size() != kLeaseKeyBytes) return end();
    auto next = std::make_shared<Authority>();
    next->lease = lease;
    next->key = key;
    next->holders.push_back({*id, holder});
    if (told_ && told_->lease == lease) {
        for (const auto& earlier : told_->holders)
            if (earlier.id != *id && next->holders.size() < kHoldersKept) next->holders.push_back(earlier);
    }
    told_ = next;
    authority_.store(std::move(next));
}

void StopSentry::end() {
    if (!told_) return;
    told_ = nullptr;
    authority_.store(nullptr);
}

StopSentry::Window& StopSentry::windowOf(const Authority& authority, const Id128& sender) {
    if (windows_of_ != authority.lease) {
        windows_.clear();
        windows_of_ = authority.lease;
    }
    const auto found =
        std::find_if(windows_.begin(), windows_.end(), [&](const Window& w) { return w.sender == sender; });
    if (found != windows_.end()) return *found;
    // Those whose senders are not accepted any more make room.
    std::erase_if(windows_, [&](const Window& window) {
        return std::none_of(authority.holders.begin(), authority.holders.end(),
                            [&](const Holder& holder) { return holder.id == window.sender; });
    });
    return windows_.emplace_back(Window{sender, 0, 0});
}

StopSentry::Judged StopSentry::judge(std::string_view bytes) {
    Judged judged;
    const auto lease = leaseOf(bytes);
    if (!lease) {
        ++unreadable_;
        return judged;
    }
    const auto authority = authority_.load();
    if (!authority || authority->lease != *lease) {
        ++foreign_;
        return judged;
    }
    const auto datagram = decode(bytes, authority->key);
    const auto holder = !datagram || datagram->kind != StopDatagram::Kind::Stop
                            ? authority->holders.end()
                            : std::find_if(authority->holders.begin(), authority->holders.end(),
                                           [&](const Holder& one) { return one.id == datagram->sender; });
    if (holder == authority->holders.end()) {
        ++foreign_;
        return judged;
    }
    auto& window = windowOf(*authority, datagram->sender);
    const auto behind = window.newest - datagram->sequence;
    if (behind >= kWindow) {
        ++old_;
        return judged;
    }
    judged.datagram = *datagram;
    judged.sender = holder->sender;
    judged.key = authority->key;
    if (behind < 0) {
        window.seen = -behind < kWindow ? window.seen << static_cast<unsigned>(-behind) : 0;
        window.seen |= 1U;
        window.newest = datagram->sequence;
        judged.verdict = Verdict::New;
    } else {
        const auto bit = std::uint64_t{1} << static_cast<unsigned>(behind);
        judged.verdict = (window.seen & bit) != 0 ? Verdict::Again : Verdict::New;
        window.seen |= bit;
    }
    ++(judged.verdict == Verdict::New ? accepted_ : again_);
    return judged;
}

StopSentry::Counters StopSentry::counters() const {
    return {accepted_.load(), again_.load(), unreadable_.load(), foreign_.load(), old_.load()};
}

}  // namespace axon::datagrams
