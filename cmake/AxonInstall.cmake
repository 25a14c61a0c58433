# SPDX-License-Identifier: GPL-2.0-or-later
# Install rules and the package configuration live here; filled in as components land.
