// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <map>
#include <optional>
#include <string>
#include <string_view>

// What the console reads of a request itself. Pure; any text is accepted or refused.
namespace axon::console {

using Form = std::map<std::string, std::string, std::less<>>;

/// A body of the type application/x-www-form-urlencoded. Nothing for one that is none: a '%' without two
/// hexadecimal digits, a byte that must have been encoded, a name that is there twice, or more than 8 names.
std::optional<Form> parseForm(std::string_view body);

/// The value of the cookie of this name in a header `Cookie`. Nothing where there is none, or several.
std::optional<std::string> cookie(std::string_view header, std::string_view name);

/// Whether a header `Accept-Encoding` permits the coding ("br", "gzip").
bool accepts(std::string_view header, std::string_view coding);

/// The last address in a header `X-Forwarded-For`, which is the one that the nearest proxy has seen; those
/// before it may be anybody's invention. Nothing where it is no address.
std::optional<std::string> forwardedFor(std::string_view header);

/// Whether one of the tags in a header `If-None-Match` is this one, quotes included.
bool matchesTag(std::string_view header, std::string_view tag);

}  // namespace axon::console
