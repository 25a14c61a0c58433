// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <string>
#include <string_view>

namespace axon {

/// The text with every sequence that is no UTF-8 replaced by U+FFFD. A `string` field of a message must hold
/// UTF-8: the receiver's parser refuses the whole message otherwise. So whatever a person, a file system or
/// an exception has named goes through here on its way into one. Pure.
std::string validUtf8(std::string_view text);

/// The longest beginning of at most `max` bytes that ends between two characters of a valid text. Pure.
std::string_view cutUtf8(std::string_view text, std::size_t max);

}  // namespace axon
