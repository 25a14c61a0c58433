// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/profile.pb.h>
#include <axon/status.pb.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/result.hpp"
#include "entity_manager/ports/resource_places.hpp"
#include "messages/composites.hpp"

namespace axon::entity_manager {

/// The registry of the entity's services (thesis: ServiceProfiler): parameters with their values, resources,
/// dependencies and readiness, activity.
///
/// Where in the flow: filled from the services profile, asked before a task is dispatched, told of what the
/// robot application has granted. Threads: the core's strand. Ownership: plain values. Failure: refusals that
/// name near names or all that is missing.
///
/// A service's record (proto::Service) always shows the present: `initial` of a parameter is its present
/// value, `ready` whether it has one, `missing` what must be set before the service can run.
///
/// The record of a composite service shows its parts' parameters and resources too, as "Part.Name": to set
/// one is to set the part's. What the composite declares itself under the name of a part's parameter is,
/// where it has a value, the value of that part's. Its flags are those of the whole: active and pausable
/// where it and all its parts are, blocking where it or one of them is.
class ServiceProfiler {
  public:
    using Params = google::protobuf::RepeatedPtrField<proto::Param>;
    /// A merged part of a task: everything the robot application needs to run one simple service.
    struct Order {
        struct Taken {
            proto::Param param;
            std::size_t level = 0;  ///< of `way`: whose value it is
        };
        int service = 0;
        Composites::Part way;  ///< to it, from the service that was asked for; for a simple one it is alone
        std::vector<Taken> params;
        std::vector<proto::Resource> resources;
    };
    /// A merged task. A simple service has one part, itself.
    struct Plan {
        int service = 0;
        bool composite = false;
        std::vector<Order> parts;
        /// With the task, by the service that declares it: the application has not been asked yet.
        std::vector<std::pair<int, proto::Param>> given;
        std::uint64_t stamp = 0;  ///< what was set later is not cleared by this task's end
        /// Parts' own parameters, by service and position, that no part takes its value from: a composite
        /// around it gives one.
        std::set<std::pair<int, int>> unused;
    };

    /// All resources that a profile declares, in its order.
    static std::vector<ResourceQuery> resourcesOf(const proto::ServicesProfile& profile);
    std::vector<ResourceQuery> resources() const { return resourcesOf(declared_); }
    /// Replaces everything. `places`: of resourcesOf(profile). Ready at once are the resources that are there
    /// and are savable, or ready by the profile's own word; a finding says what this word gets wrong.
    void load(proto::ServicesProfile profile, const std::string& entity_id,
              const std::vector<ResourcePlace>& places);
    /// Savable resources that have come or gone since, by other ways than an upload. The services that have
    /// changed.
    std::vector<int> relocate(const std::vector<ResourcePlace>& places);
    /// What is not as the profile says of its resources.
    std::vector<proto::EntityFinding> findings() const;
    /// Whether a resource has a url: it may come or go without an upload.
    bool hasUrls() const;

    const proto::ServicesProfile& profile() const { return profile_; }
    const proto::Service& record(int service) const { return profile_.services(service); }
    /// By name or global id; UNKNOWN_SERVICE names near ones.
    Result<int> find(std::string_view service) const;

    /// A parameter that a client wants to set: of which service (of a composite's "Part.Name" the part), and
    /// in the profile's own type. UNKNOWN_SERVICE, UNKNOWN_PARAMETER, WRONG_TYPE, WRONG_UNITS, OUT_OF_RANGE;
    /// WRONG_TYPE too for what only the robot may set.
    Result<std::pair<int, proto::Param>> checkParam(std::string_view service,
                                                    const proto::Param& param) const;
    /// After the robot application has granted it.
    void storeParam(int service, const proto::Param& param);

    /// Of a service's own parameters.
    bool isConfig(int service, std::string_view param) const;
    /// All CONFIG parameters that have a value, each of the service that declares it.
    std::vector<proto::ServiceParam> configuration() const;
    /// A CONFIG parameter has been stored after the task was accepted: its parts from this one on take the
    /// value where theirs is a CONFIG too and no composite further out has one for it. True when that part
    /// itself has taken it.
    bool reconfigure(Plan& plan, std::size_t from, int service, const proto::Param& param) const;
    /// Of a field in a message, at most: its tag, and its length where that is less than 2 MiB.
    static constexpr std::size_t kFieldHead = 4;
    /// Bytes that the parameters take in the messages of the parts from this one on, with the first part
    /// those given with the task too: a few more than they really do.
    static std::size_t bytesOf(const Plan& plan, std::size_t from);
    /// By how many of these bytes the plan grows (or shrinks) with reconfigure().
    std::ptrdiff_t growth(const Plan& plan, std::size_t from, int service, const proto::Param& param) const;

    /// A value of a savable parameter that was set before this profile was loaded: set again, or why this
    /// profile does not admit it. UNKNOWN_SERVICE, UNKNOWN_PARAMETER, and what checkParam() says.
    Refusal restoreParam(const std::string& service, const proto::Param& param);

    /// Position of service (of a composite's "Part.Name" the part) and resource; UNKNOWN_SERVICE,
    /// UNKNOWN_RESOURCE.
    Result<std::pair<int, int>> findResource(std::string_view service, std::string_view resource) const;
    void storeResource(int service, int resource, std::string path, std::string sha256, std::uint64_t size);

    /// Its file, at `path`, is gone. False: it has another by now.
    bool loseResource(int service, std::string_view resource, std::string_view path);

    /// The task's own parameters over the stored ones: INACTIVE_SERVICE, NOT_SUPPORTED (a composite without
    /// parts), the refusals of checkParam, and MISSING_DEPENDENCY with everything that is missing.
    /// `later`: parameters that count as given.
    Result<Plan> prepare(std::string_view service, const Params& given,
                         const std::vector<std::string>& later = {}) const;
    /// The parameters of a global service: texts become values of the profile's types. The refusals of
    /// parseParam; a parameter that the service does not have stays as it is. `told`: which come from another
    /// step, where a text is one value whatever stands in it.
    Result<Params> typed(std::string_view service, const Params& given,
                         const std::vector<std::string>& told = {}) const;
    /// Everything for which a task of a global service would be refused; `later` will be given by other
    /// steps, and other steps take `wanted` from it.
    std::vector<Refusal> problems(std::string_view service, const Params& given,
                                  const std::vector<std::string>& later,
                                  const std::vector<std::string>& wanted = {}) const;

    /// The composites that run this service, or show what is its: their records change with its own.
    const std::vector<int>& compositesWith(int service) const {
        return around_[static_cast<std::size_t>(service)];
    }
    /// Whether the two come down to a simple service of both.
    bool shareParts(int one, int other) const;

    /// UNKNOWN_SERVICE, or done; the service's position. The reason is told while the service is off.
    Result<int> setActive(std::string_view service, bool active, std::string reason = {});
    void setExecuting(int service, bool executing);

    struct Cleared {
        std::vector<int> changed;  ///< services
        std::vector<std::pair<int, std::string>>
            files;  ///< resources whose files are to be deleted, by service
    };
    /// What is not savable and was set before the task was accepted goes back to the profile's own value, or
    /// to none: of the service and of all its parts, those included that have not run. A part's value that
    /// the task had no use for, since a composite around the part gave another, stays.
    Cleared clearAfterTask(const Plan& plan);

  private:
    struct Stamps {
        std::vector<std::uint64_t> params;
        std::vector<std::uint64_t> resources;
    };
    using Values = google::protobuf::RepeatedPtrField<proto::Value>;
    /// Given with a task: of which service's own parameters, by position.
    using Given = std::map<std::pair<int, int>, proto::Param>;
    struct Lack {
        const char* kind;
        std::string name;
        bool operator==(const Lack&) const = default;
    };
    struct Switch {
        bool on = true;
        std::string reason;  ///< why it is off, where the application has said it
    };
    struct Accepted {
        Composites::View of;  ///< whose own parameter it is
        proto::Param param;
    };

    /// Where a part has the value of a CONFIG parameter of the service, or (behind the last) is to have it,
    /// and whose it is then; nothing: it does not take it.
    struct Slot {
        std::size_t at = 0;
        std::size_t level = 0;
    };
    std::optional<Slot> slotOf(const Order& order, int service, const std::string& param) const;

    void judge(int service, int resource, const ResourcePlace& place);
    void showParts(int service);
    void refresh(int service);
    void refreshRecord(int service);
    void refreshActive(int service);
    std::optional<int> inactivePart(int service) const;
    int ownParams(int service) const { return declared_.services(service).params_size(); }
    int ownResources(int service) const { return declared_.services(service).resources_size(); }
    std::optional<int> ownSettable(int service, std::string_view name) const;
    Composites::View ownerOf(int service, int param) const;
    Result<Accepted> accept(int service, const proto::Param& param) const;
    struct Source {
        const Values* values = nullptr;  ///< null = none
        std::size_t level = 0;           ///< of the way: whose they are
    };
    const Values* valuesOf(int service, int param, const Given& given) const;
    Source valuesOf(const Composites::Part& way, std::size_t level, int param, const Given& given) const;
    std::string nameIn(const Composites::Part& way, std::size_t level, const std::string& name) const;
    Order merge(const Composites::Part& way, const Given& given, std::vector<Lack>& lacks) const;
    std::set<std::pair<int, int>> unusedBy(const std::vector<Composites::Part>& parts,
                                           const Given& given) const;
    void clear(int service, const Plan& plan, Cleared& cleared);

    proto::ServicesProfile profile_;
    proto::ServicesProfile declared_;  ///< as it was loaded: what a value that is not savable goes back to
    Composites composites_;
    std::vector<std::vector<int>> around_;  ///< of each service the composites with it
    std::vector<Switch> active_;            ///< each by itself, whatever its parts are
    std::vector<Stamps> stamps_;
    std::map<std::pair<int, int>, proto::EntityFinding> findings_;  ///< by service and resource
    std::uint64_t clock_ = 0;                                       ///< counts what has been set
};

}  // namespace axon::entity_manager
