# SPDX-License-Identifier: GPL-2.0-or-later
"""Programs that use the robots of an Axon laboratory."""
