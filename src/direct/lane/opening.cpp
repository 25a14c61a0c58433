// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/opening.hpp"

#include <utility>

#include "common/frame.hpp"
#include "direct/lane/frames.hpp"

namespace axon::direct::lane {
namespace {

constexpr std::size_t kIdBytes = 16;
constexpr std::size_t kProofBytes = 32;
constexpr std::size_t kTextMax = 1024;  // of a refusal

std::optional<Id128> idIn(Fields& fields) {
    return Id128::fromBytes(fields.take(kIdBytes));
}

std::string otherContract(std::uint32_t ours, std::uint32_t theirs) {
    return "this side of a direct path has contract " + std::to_string(ours) +
           ", the other one has contract " + std::to_string(theirs) + "; fix: upgrade the " +
           (theirs < ours ? "other side" : "program that says this");
}

}  // namespace

std::string ManagerOpening::greeting() const {
    std::string content;
    appendNumber(content, kContract);
    content += nonce_.bytes();
    return frameOf(Kind::Nonce, content);
}

std::variant<ManagerOpening::Claimed, Refusal> ManagerOpening::onFrame(std::string_view frame) {
    if (state_ != State::Awaited) return Refusal{RefusalCode::WrongState, "direct path: one claim", {}};
    state_ = State::Judged;
    Fields fields(frame);
    const auto kind = static_cast<Kind>(fields.number(1));
    const auto contract = static_cast<std::uint32_t>(fields.number(4));
    // First, because what follows may be another edition's.
    if (kind == Kind::Claim && fields.good() && contract != kContract)
        return Refusal{RefusalCode::NotSupported, otherContract(kContract, contract), {}};
    Claimed claimed;
    auto& claim = claimed.claim;
    claim.lane = Lane::Data;
    claim.lease.epoch = static_cast<std::int32_t>(fields.number(4));
    claim.lease.number = static_cast<std::int32_t>(fields.number(4));
    const auto client = idIn(fields), path = idIn(fields);
    claimed.proof = fields.take(kProofBytes);
    if (kind != Kind::Claim || !fields.done() || !client || !path || path->isZero())
        return Refusal{RefusalCode::Malformed,
                       "direct path: expected a claim: the contract's number, the lease, the session UUID of "
                       "the holder, a path of 16 bytes that are not all 0, and the proof",
                       {}};
    claim.client = *client;
    claim.path = *path;
    claim.nonce = nonce_;
    return claimed;
}

std::string ManagerOpening::admit(std::string_view proof) {
    state_ = State::Open;
    return frameOf(Kind::Proof, proof);
}

std::string ManagerOpening::refuse(const Refusal& refusal) {
    state_ = State::Over;
    std::string content;
    appendNumber(content, static_cast<std::uint32_t>(refusal.code));
    content += refusal.message.substr(0, kTextMax);
    return frameOf(Kind::Refusal, content);
}

std::variant<std::string, Refusal> ClientOpening::over(RefusalCode code, std::string why) {
    state_ = State::Over;
    return Refusal{code, std::move(why), {}};
}

std::variant<std::string, Refusal> ClientOpening::onFrame(std::string_view frame) {
    Fields fields(frame);
    const auto kind = static_cast<Kind>(fields.number(1));
    if (kind == Kind::Refusal && (state_ == State::NonceAwaited || state_ == State::ProofAwaited)) {
        const auto code = static_cast<RefusalCode>(fields.number(4));
        return over(code, "it was refused: " + std::string(fields.rest().substr(0, kTextMax)));
    }
    if (kind == Kind::Nonce && state_ == State::NonceAwaited) {
        const auto contract = static_cast<std::uint32_t>(fields.number(4));
        if (fields.good() && contract != kContract)
            return over(RefusalCode::NotSupported, otherContract(kContract, contract));
        const auto nonce = idIn(fields);
        if (!fields.done() || !nonce) return over(RefusalCode::Malformed, "its nonce is none");
        state_ = State::ProofAwaited;
        std::string content;
        appendNumber(content, kContract);
        appendNumber(content, static_cast<std::uint32_t>(claim_.lease.epoch));
        appendNumber(content, static_cast<std::uint32_t>(claim_.lease.number));
        content += claim_.client.bytes() + claim_.path.bytes() + prove_(*nonce);
        return frameOf(Kind::Claim, content);
    }
    if (kind == Kind::Proof && state_ == State::ProofAwaited) {
        if (!trust_(fields.rest()))
            return over(RefusalCode::PermissionDenied,
                        "who answers does not know the lease's key; is it another machine's address?");
        state_ = State::Open;
        return std::string();
    }
    return over(RefusalCode::Malformed, "what answers is no Entity Manager of this edition");
}

}  // namespace axon::direct::lane
