// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <string>
#include <string_view>

namespace axon {

/// Well-formed UTF-8 (RFC 3629: no surrogates, nothing overlong, nothing above U+10FFFF): what a `string`
/// field of a message may hold. Eight bytes of ASCII are checked at a time. Pure.
bool isUtf8(std::string_view text);

/// Bytes of the character at the front of the text; 0 where the text is empty or begins with none. Pure.
std::size_t utf8Length(std::string_view text);

/// The text with every sequence that is no UTF-8 replaced by U+FFFD. A `string` field of a message must hold
/// UTF-8: the receiver's parser refuses the whole message otherwise. So whatever a person, a file system or
/// an exception has named goes through here on its way into one. Pure.
std::string validUtf8(std::string_view text);

/// The longest beginning of at most `max` bytes that ends between two characters of a valid text. Pure.
std::string_view cutUtf8(std::string_view text, std::size_t max);

}  // namespace axon
