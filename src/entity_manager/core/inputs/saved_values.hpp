// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/profile.pb.h>
#include <axon/status.pb.h>

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "common/refusal.hpp"

namespace axon::entity_manager {

class ServiceProfiler;
class Storage;

/// The values of savable parameters that were set. They outlive the link to the robot application, a change
/// of the profile that still admits them, and this process.
///
/// Where in the flow: told of each value that the robot application has granted; sets them again when a
/// profile has been loaded. Threads: the core's strand. Ownership: plain values; the storage has a copy.
/// Bounded: kBytesMax in the storage. CONFIG values come first; other values for which they leave no room
/// live as long as this process, which a finding says. Failure: a value that a profile no longer admits is
/// dropped, and a finding says so until the parameter is set again.
class SavedValues {
  public:
    static constexpr std::size_t kBytesMax = 1U << 20U;
    static constexpr std::size_t kFindings = 64;

    /// Waits for the disk.
    explicit SavedValues(Storage& storage);

    /// A parameter's own record, and what has been granted for it. Nothing where it is not savable.
    void set(const std::string& service, const proto::CtrlParam& meta, const proto::Param& param);
    /// TOO_LARGE where this value of a CONFIG parameter has no room in the storage beside the other CONFIG
    /// values.
    Refusal mayKeepConfig(const std::string& service, const proto::Param& param) const;
    /// Into a profile that has just been loaded. What was dropped, for the log; empty = nothing.
    std::string restore(ServiceProfiler& profiler);
    std::vector<proto::EntityFinding> findings() const;

  private:
    using Name = std::pair<std::string, std::string>;  // service, parameter
    struct Value {
        proto::Param param;
        bool config = false;  // as the present profile says; false before there is one
    };
    /// In the storage, at most.
    static std::size_t bytesOf(const std::string& service, const proto::Param& param);
    void keep();
    void find(const Name& name, std::string message, std::string fix);

    Storage& storage_;
    std::map<Name, Value> values_;
    bool all_kept_ = true;  // none is without room in the storage
    std::map<Name, proto::EntityFinding> findings_;
};

}  // namespace axon::entity_manager
