// SPDX-License-Identifier: MIT
#pragma once
#include <axon/profile.pb.h>
#include <axon/refusal.pb.h>

#include <string>
#include <string_view>

#include "common/refusal.hpp"
#include "common/result.hpp"

// The rules for the values of control parameters, and for finding things in a services profile by name. The
// command, the client library, the Entity Manager and the profile reader all ask here, so a value that one of
// them accepts is accepted by the others. Pure functions: any thread, no state. docs/reference/profiles.md
// explains them to users.
namespace axon {

/// What the parameter accepts, for a person: `INT from 0 to 5000 in mm`, `STR, one of "red", "green"`.
std::string describeValues(const proto::CtrlParam& meta);

/// One value from a text (a command line, an XML attribute), of the parameter's data type. INT takes a whole
/// number, also written 1e3 or 1000.0; DBL any finite number with a decimal point; BOOL true/false, 1/0,
/// yes/no, on/off in any case; STR any UTF-8 text, unchanged. WRONG_TYPE says what was expected. Range and
/// choices: checkValue.
Result<proto::Value> parseValue(const proto::CtrlParam& meta, std::string_view text);

/// A whole parameter from a command line, ready to send: `1000`, `1000mm`, `1000 mm`, and for a "multiple"
/// parameter values separated by commas. Checked as by acceptParam; a unit that is not the profile's is
/// WRONG_UNITS.
Result<proto::Param> parseParam(const proto::CtrlParam& meta, std::string_view text);

/// Range and choices of a value that already is of the right type: OUT_OF_RANGE, or OK.
Refusal checkValue(const proto::CtrlParam& meta, const proto::Value& value);

/// The parameter with its values in the profile's data type: an INT given for a DBL is converted, a DBL for
/// an INT where it is whole. WRONG_TYPE (also for no value, or several where one is allowed), WRONG_UNITS,
/// OUT_OF_RANGE.
Result<proto::Param> acceptParam(const proto::CtrlParam& meta, const proto::Param& param);

/// acceptParam without the converted parameter.
Refusal checkParam(const proto::CtrlParam& meta, const proto::Param& param);

/// `1000`, `0.5`, `true`, or the text itself; the shortest form that parseValue reads back as the same value.
std::string toText(const proto::Value& value);

bool equalValues(const proto::Value& a, const proto::Value& b);

/// Where a file lies on the robot's machine: a path below the folder of the profiles, or an absolute one,
/// which the robot application must permit. No "..", no empty step, no drive, scheme, backslash or control
/// character, at most 512 characters. BAD_NAME otherwise.
Refusal checkResourceUrl(std::string_view url);

Refusal toRefusal(const proto::Refusal& refusal);
proto::Refusal toProto(const Refusal& refusal);

/// Position of the service with this name, or else this global id; where there is none, of the only one that
/// differs in upper and lower case alone. UNKNOWN_SERVICE names near ones, or the candidates.
Result<int> findServiceIndex(const proto::ServicesProfile& profile, std::string_view name_or_global_id);
/// The same; null if there is none.
const proto::Service* findService(const proto::ServicesProfile& profile, std::string_view name_or_global_id);
/// Position of the parameter with this name, or UNKNOWN_PARAMETER.
Result<int> findParamIndex(const proto::Service& service, std::string_view name);
/// Position of the resource with this name, or UNKNOWN_RESOURCE.
Result<int> findResourceIndex(const proto::Service& service, std::string_view name);

}  // namespace axon
