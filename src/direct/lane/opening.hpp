// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include "common/ids.hpp"
#include "common/refusal.hpp"
#include "direct/proof.hpp"

// The opening of a data lane, both halves (docs/reference/direct.md, "Opening"): frames in, frames out. Pure
// and not thread-safe.
//
//     Entity Manager                      client
//        Nonce (contract, nonce)     ──►
//                                    ◄──  Claim (contract, lease, client, path, proof)
//        Proof, or Refusal and the end ──►
namespace axon::direct::lane {

/// CommUtil::ContractNumber, of which this folder knows nothing; checked where both are seen.
inline constexpr std::uint32_t kContract = 3;

/// At the Entity Manager.
///
///     Awaited ── a claim ──► Judged ── admit() ──► Open
///        └── anything else ──► Over ◄── refuse() ──┘
///
/// While it is Judged, its owner reads nothing: what comes next is known only then.
class ManagerOpening {
  public:
    enum class State : std::uint8_t { Awaited, Judged, Open, Over };
    struct Claimed {
        Claim claim;
        std::string proof;
    };

    explicit ManagerOpening(const Id128& nonce) : nonce_(nonce) {}

    /// The first frame, which goes out at once.
    std::string greeting() const;
    /// The claim, to be judged; or why this connection ends, which refuse() is to say.
    std::variant<Claimed, Refusal> onFrame(std::string_view frame);
    /// The frame that says so.
    std::string admit(std::string_view proof);
    std::string refuse(const Refusal& refusal);
    State state() const { return state_; }

  private:
    const Id128 nonce_;
    State state_ = State::Awaited;
};

/// At the client.
///
///     Nonce awaited ── a nonce ──► Proof awaited ── the right proof ──► Open
///           └──────── anything else ──► Over ◄──── anything else ──────┘
class ClientOpening {
  public:
    enum class State : std::uint8_t { NonceAwaited, ProofAwaited, Open, Over };
    using Prove = std::function<std::string(const Id128& nonce)>;
    using Trust = std::function<bool(std::string_view proof)>;

    /// `claim`: its lane is Data and its nonce is not known yet.
    ClientOpening(const Claim& claim, Prove prove, Trust trust)
        : claim_(claim), prove_(std::move(prove)), trust_(std::move(trust)) {}

    /// A frame to send, or why it is over; an empty frame where there is none.
    std::variant<std::string, Refusal> onFrame(std::string_view frame);
    State state() const { return state_; }

  private:
    std::variant<std::string, Refusal> over(RefusalCode code, std::string why);

    const Claim claim_;
    const Prove prove_;
    const Trust trust_;
    State state_ = State::NonceAwaited;
};

}  // namespace axon::direct::lane
