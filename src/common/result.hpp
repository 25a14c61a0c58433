// SPDX-License-Identifier: MIT
#pragma once
#include "common/axon/result.hpp"  // public: part of what the client library's headers say
