// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/transfer.pb.h>

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// The resources that are on their way from clients into the store: windows, order, completeness.
///
/// Where in the flow: an offer, then chunks in order; what the client may send ahead is bounded by credits,
/// which are given for what is written: behind a slow disk no more waits than the window. What is complete is
/// put to the robot application, and takes its place once that has accepted it. Threads: the core's strand.
/// Bounded: at most kMaxUploads at once (OVERLOADED), chunks of at most kMaxChunk bytes, a window per upload.
/// Failure: any broken rule ends that upload, keeping what has arrived for a later offer of the same content;
/// a hash that differs deletes it.
class UploadDesk {
  public:
    static constexpr std::size_t kMaxUploads = 8;
    static constexpr std::size_t kMaxChunk = 64 * 1024;
    static constexpr std::size_t kMaxName = 255;
    /// A client that waits for the disk, or for the robot application, hears that often that it is not
    /// forgotten.
    static constexpr Duration kSignEvery = std::chrono::seconds{1};

    struct Upload {
        enum class Step : std::uint8_t {
            Opening,
            Arriving,
            Checking,
            Asked,    ///< the robot application has it to look at
            Placing,  ///< it has accepted it
        };
        proto::ResourceOffer offer;
        int service = 0;  ///< positions in the services profile
        int resource = 0;
        Sender asker;
        Step step = Step::Opening;
        std::uint64_t received = 0;
        std::uint64_t credited = 0;  ///< the client may send up to here
        TimePoint told{};            ///< when the client last heard of it
        std::optional<Later<Result<std::uint64_t>>> opened;
        std::optional<Later<Result<std::string>>> path;  ///< of Checking or Placing
    };
    /// What an accepted offer, a chunk or an answer of the store leads to.
    struct Progress {
        enum class Next : std::uint8_t { Nothing, Ask, Placed };
        std::uint64_t offset = 0;
        std::uint64_t window = 0;  ///< > 0: tell the client that it may go on
        Next next = Next::Nothing;
        std::string
            path;  ///< Ask: of the file to look at; Placed: where it lies, and the upload has left the desk
    };

    UploadDesk(ResourceStore& store, std::uint64_t bytes_max, std::uint64_t window);

    /// Without touching the disk: BAD_NAME, TOO_LARGE, OVERLOADED, DUPLICATE (that resource or transfer is
    /// being uploaded already), MALFORMED.
    Result<Progress> offer(const proto::ResourceOffer& offer, int service, int resource, const Sender& asker,
                           const std::string& owner, TimePoint now);
    /// MALFORMED (order), TOO_LARGE (chunk or window): the upload has ended then. UNKNOWN_RESOURCE: no such
    /// upload.
    Result<Progress> chunk(const proto::ResourceChunk& chunk);
    /// The store has answered, or written more of some: what that leads to, or why the upload has ended.
    std::vector<std::pair<Upload, Result<Progress>>> answered();
    /// The robot application has said what it thinks of the file. Accepted: a refusal ends the upload.
    Result<Progress> accept(const std::string& transfer_id);
    void deny(const std::string& transfer_id);
    /// Whether chunks of this ended upload may still be under way, so that they need no answer.
    bool endedLately(std::string_view transfer_id) const;
    const Upload* find(std::string_view transfer_id) const;
    /// Whether a file that was accepted is about to take the place of this resource's.
    bool placing(std::string_view service, std::string_view resource) const;
    /// It can be gone on with.
    void suspend(const std::string& transfer_id);
    /// All of them, but those that the robot application has accepted already.
    std::vector<Upload> suspendAll();

    /// The clients that are owed a sign of life at `now`; they have been given it.
    std::vector<Upload> takeSigns(TimePoint now);
    std::optional<TimePoint> nextSign() const;

  private:
    Result<Progress> advance(const std::string& transfer_id, Upload& upload);
    /// Whether the client can do nothing but wait.
    bool owesSign(const Upload& upload) const;
    void end(const std::string& transfer_id);

    ResourceStore& store_;
    const std::uint64_t bytes_max_;
    const std::uint64_t window_;
    std::map<std::string, Upload, std::less<>> uploads_;
    std::deque<std::string> ended_;
};

}  // namespace axon::entity_manager
