// SPDX-License-Identifier: MIT
#pragma once
#include <string>
#include <string_view>

namespace axon {

/// Why a request was refused: the enumerators NotHolder = 1, AlreadyHeld = 2, … of the list refusals.def,
/// which says what each one means and how to fix it. axon.proto.RefusalCode and the command's JSON have the
/// same names and numbers. Take a number that you do not know for Internal.
enum class RefusalCode : int {
#define AXON_REFUSAL(enumerator, name, number, ...) enumerator = number,
#include "refusals.def"
#undef AXON_REFUSAL
};

/// The name of a code as it is written in the contracts: "NOT_HOLDER". Never empty; an unknown number gives
/// "INTERNAL".
std::string_view refusalName(RefusalCode code);

/// Why something was not done. The code is for programs. The message is for people: it says what was expected
/// and how to fix it.
struct Refusal {
    RefusalCode code = RefusalCode::Ok;
    std::string message;
    std::string holder;  ///< name of the present holder, if the entity is refused because of it

    bool ok() const { return code == RefusalCode::Ok; }
};

}  // namespace axon
