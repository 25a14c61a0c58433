// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "common/refusal.hpp"
#include "common/result.hpp"
#include "entity_manager/core/inputs/saved_values.hpp"
#include "entity_manager/core/inputs/upload_desk.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// What the holder gives the services beside their tasks: values of parameters, and files as resources.
///
/// Each counts only after the robot application has granted it. Until then it is a question, which the
/// application is given `answer_within` to answer; what has become of it is told to who asked. A value that
/// is savable outlives profile and process, and one that configures the robot reaches what waits and runs.
/// Threads: the core's strand. Bounded: 64 questions, and the uploads of UploadDesk.
class Inputs final : public Owner {
  public:
    struct Settings {
        Duration answer_within;
        std::uint64_t resource_bytes_max;
        std::uint64_t resource_window;
    };
    /// What it asks of other owners.
    class Others {
      public:
        virtual ~Others() = default;
        /// Whether a command counts whose sender had seen this stop generation, as StopLedger::whyNot().
        virtual Refusal checkGeneration(std::int32_t seen) const = 0;
        /// TOO_LARGE where a task that has been accepted could not be sent with this value of a service's own
        /// parameter.
        virtual Refusal leavesRoom(int service, const proto::Param& param) const = 0;
        /// A new value of a CONFIG parameter, to the application and to all that has been accepted.
        virtual void reconfigure(int service, const proto::Param& param) = 0;
    };
    Inputs(Turn& turn, Others& others, Storage& storage, ResourceStore& store, ServiceProfiler& profiler,
           Settings settings);

    // Actions of the state table.

    void askParameter(const Incident& incident);
    void carryResource(const Incident& incident);
    void refuseResource(const Incident& incident, const Refusal& refusal);
    /// The application cannot answer any more.
    void abandon(const Refusal& reason);
    /// What has arrived is kept for a later offer of the same file.
    void suspendUploads(const Refusal& reason);

    // The application and the profile.

    void answered(const proto::RequestAnswer& answer);
    /// Gives the profile that has been loaded the values that were saved; why not all of them.
    std::string restore() { return saved_.restore(profiler_); }
    /// What is not as it was saved.
    std::vector<proto::EntityFinding> findings() const { return saved_.findings(); }
    /// All of it, to an application that has just been linked or has new profiles.
    void tellConfiguration();
    /// A file that its task had for itself, unless another is being put in its place.
    void remove(const std::string& service, const std::string& resource);

    // Time.

    /// The store has done what it was asked for.
    void onStored();
    void onTimer() override;
    TimePoint nextDeadline() const override;

  private:
    /// A question to the robot application: a parameter or a resource.
    struct Question {
        Sender asker;
        LeaseNumber lease;
        std::string request_id;  ///< or the transfer's id
        int service = 0;
        proto::Param param;
        std::uint32_t generation = 0;  ///< of the stops, when a parameter was asked for
        bool of_resource = false;
        std::string resource_name;
        TimePoint until{};  ///< then it is TIMED_OUT
    };

    /// A value that the application has granted; TOO_LARGE where it does not fit.
    Refusal keepParameter(const Question& question);
    void conclude(const Question& question, const Refusal& refusal);
    /// `upload` as it was before.
    void uploadProgress(const UploadDesk::Upload& upload, const Result<UploadDesk::Progress>& progress);
    void askResource(const UploadDesk::Upload& upload, const std::string& path);
    void forgetQuestion(const std::string& transfer_id);
    void tellCredit(const UploadDesk::Upload& upload, std::uint64_t offset, std::uint64_t window);
    void sendResourceDone(const Sender& to, const std::string& transfer_id, const std::string& resource,
                          const Refusal& refusal);

    Turn& turn_;
    Others& others_;
    ResourceStore& store_;
    ServiceProfiler& profiler_;
    const Settings settings_;
    SavedValues saved_;
    UploadDesk uploads_;
    std::map<std::uint64_t, Question> questions_;
    std::uint64_t next_question_ = 1;
};

}  // namespace axon::entity_manager
