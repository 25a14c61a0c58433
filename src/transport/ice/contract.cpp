// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/contract.hpp"

#include <axon/commutil.h>

#include <charconv>
#include <string>
#include <string_view>

#include "common/release.hpp"

namespace axon::transport {
namespace {

constexpr int kOurs = Axon::CommUtil::ContractNumber;

std::optional<int> numberIn(std::string_view text) {
    int number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
    return number;
}

}  // namespace

std::string ofContract(const std::string& topic) {
    return topic + "-" + std::to_string(kOurs);
}

std::optional<int> contractOfOther(const std::string& topic, const std::string& found) {
    if (found == topic) return 1;  // before names had a number
    if (!found.starts_with(topic + "-")) return std::nullopt;
    const auto theirs = numberIn(std::string_view(found).substr(topic.size() + 1));
    return theirs == kOurs ? std::nullopt : theirs;
}

Ice::Context contractContext() {
    return {{kContextContract, std::to_string(kOurs)}, {kContextRelease, kRelease}};
}

Ice::Context releaseContext() {
    return {{kContextRelease, kRelease}};
}

std::string releaseIn(const Ice::Context& of_peer) {
    const auto found = of_peer.find(kContextRelease);
    return found == of_peer.end() ? std::string() : found->second.substr(0, kReleaseMax + 1);
}

std::string ourContract() {
    return "contract " + std::to_string(kOurs);
}

std::optional<Refusal> otherContract(const Ice::Context& of_peer) {
    const auto ours = "this server has " + ourContract() + " (release " + kRelease + ")";
    const auto found = of_peer.find(kContextContract);
    if (found == of_peer.end())
        return Refusal{RefusalCode::NotSupported,
                       ours +
                           ", and the program that opens the session names none; fix: upgrade that program, "
                           "or let it send the request context axon-contract (CommUtil.ContractNumber)",
                       {}};
    const auto& text = found->second;
    const auto theirs = numberIn(text);
    if (!theirs)
        return Refusal{
            RefusalCode::Malformed,
            ours + ", and the program that opens the session says '" + text.substr(0, 16) +
                "'; expected a number in the request context axon-contract (CommUtil.ContractNumber)",
            {}};
    if (*theirs == kOurs) return std::nullopt;
    const auto release = releaseIn(of_peer);
    return Refusal{RefusalCode::NotSupported,
                   ours + ", the program that opens the session has contract " + std::to_string(*theirs) +
                       (isRelease(release) ? " (release " + release + ")" : "") + "; fix: upgrade " +
                       (*theirs < kOurs ? "that program" : "the server"),
                   {}};
}

}  // namespace axon::transport
