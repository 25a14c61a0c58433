# SPDX-License-Identifier: GPL-2.0-or-later
# slice2cpp names the header as the target of its dependency line; Ninja wants the first declared output.
file(READ "${IN}" text)
string(REGEX REPLACE "^[^:]+:" "${TGT}:" text "${text}")
file(WRITE "${OUT}" "${text}")
