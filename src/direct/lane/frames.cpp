// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/frames.hpp"

#include "common/frame.hpp"

namespace axon::direct::lane {
namespace {

/// Numbers on this lane are as whole, and as large, as on those of Ice, which carry them as doubles.
constexpr std::int64_t kNumberEnd = std::int64_t{1} << 53U;

bool proper(std::int64_t number) {
    return number >= 0 && number < kNumberEnd;
}

}  // namespace

std::optional<HeadBytes> headOf(Keeping keeping, const Header& head, std::size_t content) {
    if (head.msg_type.size() > kTypeMax || content > kMessageMax) return std::nullopt;
    std::optional<HeadBytes> made(std::in_place);
    auto& bytes = *made;
    bytes.put(kFixedHead + head.msg_type.size() + content, 4);
    bytes.put(static_cast<std::uint8_t>(keeping == Keeping::Kept ? Kind::Kept : Kind::Droppable), 1);
    bytes.put(static_cast<std::uint32_t>(head.held.epoch), 4);
    bytes.put(static_cast<std::uint32_t>(head.held.number), 4);
    bytes.put(static_cast<std::uint32_t>(head.stop_generation), 4);
    bytes.put(proper(head.sequence) ? static_cast<std::uint64_t>(head.sequence) : 0, 8);
    bytes.put(proper(head.sent_at_us) ? static_cast<std::uint64_t>(head.sent_at_us) : 0, 8);
    bytes.put(head.msg_type.size(), 1);
    head.msg_type.copy(bytes.bytes_.data() + bytes.size_, head.msg_type.size());
    bytes.size_ += head.msg_type.size();
    return made;
}

std::optional<MessageView> messageIn(std::string_view frame) {
    Fields fields(frame);
    const auto kind = static_cast<Kind>(fields.number(1));
    if (kind != Kind::Kept && kind != Kind::Droppable) return std::nullopt;
    MessageView message;
    message.keeping = kind == Kind::Kept ? Keeping::Kept : Keeping::Droppable;
    message.held.epoch = static_cast<std::int32_t>(fields.number(4));
    message.held.number = static_cast<std::int32_t>(fields.number(4));
    message.stop_generation = static_cast<std::int32_t>(fields.number(4));
    message.sequence = static_cast<std::int64_t>(fields.number(8));
    message.sent_at_us = static_cast<std::int64_t>(fields.number(8));
    message.msg_type = fields.take(fields.number(1));
    message.content = fields.rest();
    if (!fields.good() || !proper(message.sequence) || !proper(message.sent_at_us) ||
        message.content.size() > kMessageMax)
        return std::nullopt;
    return message;
}

std::string frameOf(Kind kind, std::string_view content) {
    std::string frame;
    appendFrame(frame, std::string(1, static_cast<char>(kind)).append(content));
    return frame;
}

}  // namespace axon::direct::lane
