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
    /// A name that a `ready` entity has means no other: what is not ready is called by it only where no ready
    /// entity is, and otherwise by its UUID (Entity::ready).
    void put(const std::string& id, const std::string& name, bool ready = true);
    void remove(const std::string& id);
    void clear();

    /// The UUID meant by a UUID, a name, "Name#2" (the second of that name in order of UUID, counted from 1)
    /// or a unique beginning of a UUID (at least 4 characters); names and UUIDs in any case where that is not
    /// ambiguous. AMBIGUOUS_ENTITY names the candidates, UNKNOWN_ENTITY the nearest names.
    Result<std::string> resolve(std::string_view text) const;

    /// The same, but returns all entities that an ambiguous name can mean, ready or not. For a stop.
    Result<std::vector<std::string>> resolveAll(std::string_view text) const;

    bool contains(const std::string& id) const { return names_.count(id) != 0; }
    std::vector<std::string> ids() const;
    /// As a person would have to write it: the name, with #n where several share it, or the beginning of the
    /// UUID.
    std::string label(const std::string& id) const;

  private:
    struct Known {
        std::string name;
        bool ready = true;
        bool operator==(const Known&) const = default;
    };
    /// UUIDs in order, which gives #n its meaning.
    using ByName = std::map<std::string, std::set<std::string>>;
    enum class Scope { ReadyFirst, All };
    Result<std::vector<std::string>> meant(std::string_view text, Scope scope) const;
    Refusal ambiguous(std::string_view text, const std::vector<std::string>& candidates) const;

    std::map<std::string, Known> names_;  // by UUID
    ByName by_name_, unready_;
};

}  // namespace axon::client
