// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "common/result.hpp"

namespace axon::client {

/// What people call entities, and which UUID they mean by it. Names need not be unique (the thesis had two
/// PeopleBots), so a name can be refused with the candidates. A value; no threads of its own.
class NameIndex {
  public:
    void put(const std::string& id, const std::string& name);
    void remove(const std::string& id);
    void clear();

    /// The UUID meant by a UUID, a name, "Name#2" (the second of that name in order of UUID, counted from 1)
    /// or a unique beginning of a UUID (at least 4 characters); names and UUIDs in any case where that is not
    /// ambiguous. AMBIGUOUS_ENTITY names the candidates, UNKNOWN_ENTITY the nearest names.
    Result<std::string> resolve(std::string_view text) const;

    /// Likewise, but all that an ambiguous name may mean: for a stop.
    Result<std::vector<std::string>> resolveAll(std::string_view text) const;

    bool contains(const std::string& id) const { return names_.count(id) != 0; }
    std::vector<std::string> ids() const;
    /// As a person would have to write it: the name, with #n where several share it.
    std::string label(const std::string& id) const;

  private:
    Refusal ambiguous(std::string_view text, const std::vector<std::string>& candidates) const;

    std::map<std::string, std::string> names_;              // by UUID
    std::map<std::string, std::set<std::string>> by_name_;  // UUIDs in order, which gives #n its meaning
};

}  // namespace axon::client
