// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/profile.pb.h>

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/result.hpp"

namespace axon::entity_manager {

class ResourceStore;

/// The registry of the entity's services (thesis: ServiceProfiler): parameters with their values, resources,
/// dependencies and readiness, activity.
///
/// Where in the flow: filled from the services profile, asked before a task is dispatched, told of what the
/// robot application has granted. Threads: the core's strand. Ownership: plain values. Failure: refusals that
/// name near names or all that is missing.
///
/// A service's record (proto::Service) always shows the present: `initial` of a parameter is its present
/// value, `ready` whether it has one, `missing` what must be set before the service can run.
class ServiceProfiler {
  public:
    using Params = google::protobuf::RepeatedPtrField<proto::Param>;
    /// A merged task: everything the robot application needs to run it.
    struct Order {
        int service = 0;
        std::vector<proto::Param> params;
        std::vector<proto::Resource> resources;
        std::uint64_t stamp = 0;  ///< what was set later is not cleared by this task's end
    };

    /// Replaces everything. Savable resources that are in the store already are ready at once.
    void load(proto::ServicesProfile profile, const std::string& entity_id, ResourceStore& store);

    const proto::ServicesProfile& profile() const { return profile_; }
    const proto::Service& record(int service) const { return profile_.services(service); }
    /// By name or global id; UNKNOWN_SERVICE names near ones.
    Result<int> find(std::string_view service) const;

    /// A parameter that a client wants to set: of which service, and in the profile's own type.
    /// UNKNOWN_SERVICE, UNKNOWN_PARAMETER, WRONG_TYPE, WRONG_UNITS, OUT_OF_RANGE; WRONG_TYPE too for what
    /// only the robot may set.
    Result<std::pair<int, proto::Param>> checkParam(std::string_view service,
                                                    const proto::Param& param) const;
    /// After the robot application has granted it.
    void storeParam(int service, const proto::Param& param);

    /// Position of service and resource; UNKNOWN_SERVICE, UNKNOWN_RESOURCE.
    Result<std::pair<int, int>> findResource(std::string_view service, std::string_view resource) const;
    void storeResource(int service, int resource, std::string path, std::string sha256, std::uint64_t size);

    /// The task's own parameters over the stored ones: INACTIVE_SERVICE, NOT_SUPPORTED (composite services),
    /// the refusals of checkParam, and MISSING_DEPENDENCY with everything that is missing.
    /// `later`: parameters that count as given.
    Result<Order> prepare(std::string_view service, const Params& given,
                          const std::vector<std::string>& later = {}) const;
    /// The parameters of a global service: texts become values of the profile's types. The refusals of
    /// parseParam; a parameter that the service does not have stays as it is.
    Result<Params> typed(std::string_view service, const Params& given) const;
    /// Everything for which a task of a global service would be refused; `later` will be given by other steps, and other
    /// steps take `wanted` from it.
    std::vector<Refusal> problems(std::string_view service, const Params& given, const std::vector<std::string>& later,
                                  const std::vector<std::string>& wanted = {}) const;

    /// UNKNOWN_SERVICE, or done; the service's position.
    Result<int> setActive(std::string_view service, bool active);
    void setExecuting(int service, bool executing);

    struct Cleared {
        bool changed = false;
        std::vector<std::string> files;  ///< resources whose files are to be deleted
    };
    /// What is not savable and was set before the task was accepted goes back to the profile's own value, or to none.
    Cleared clearAfterTask(const Order& order);

  private:
    struct Stamps {
        std::vector<std::uint64_t> params;
        std::vector<std::uint64_t> resources;
    };
    void refreshMissing(int service);

    proto::ServicesProfile profile_;
    proto::ServicesProfile declared_;  ///< as it was loaded: what a value that is not savable goes back to
    std::vector<Stamps> stamps_;
    std::uint64_t clock_ = 0;  ///< counts what has been set
};

}  // namespace axon::entity_manager
