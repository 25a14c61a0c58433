// SPDX-License-Identifier: MIT
#pragma once
#include "common/axon/refusal.hpp"  // public: part of what the client library's headers say
