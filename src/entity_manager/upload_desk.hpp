// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/transfer.pb.h>

#include <cstdint>
#include <deque>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "common/ids.hpp"
#include "common/result.hpp"
#include "entity_manager/ports.hpp"

namespace axon::entity_manager {

/// The resources that are on their way from clients into the store: windows, order, completeness.
///
/// Where in the flow: an offer and then chunks in order; what the client may send ahead is bounded by
/// credits, which are given for what is written: behind a slow disk no more waits than the window. One that is gone on
/// with begins when the disk has what came before. Threads: the core's strand. Bounded: at most kMaxUploads at once (OVERLOADED), chunks of at most
/// kMaxChunk bytes, a window per upload. Failure: any broken rule ends that upload, keeping what has arrived
/// for a later offer of the same content; a hash that differs deletes it.
class UploadDesk {
  public:
    static constexpr std::size_t kMaxUploads = 8;
    static constexpr std::size_t kMaxChunk = 64 * 1024;
    static constexpr std::size_t kMaxName = 255;

    struct Upload {
        proto::ResourceOffer offer;
        int service = 0;  ///< positions in the services profile
        int resource = 0;
        std::uint64_t received = 0;
        std::uint64_t credited = 0;  ///< the client may send up to here
        bool begun = false;          ///< it has been told where to begin: once nothing waits that came before
    };
    /// What an accepted offer or chunk leads to.
    struct Progress {
        std::uint64_t offset = 0;
        std::uint64_t window = 0;  ///< > 0: tell the client that it may go on
        bool complete = false;     ///< call finish()
    };

    UploadDesk(ResourceStore& store, std::uint64_t bytes_max, std::uint64_t window);

    /// MALFORMED, BAD_NAME, TOO_LARGE, OVERLOADED, DUPLICATE (that resource or transfer is being uploaded
    /// already), or what the store says.
    Result<Progress> offer(const proto::ResourceOffer& offer, int service, int resource);
    /// MALFORMED (order), TOO_LARGE (chunk or window): the upload has ended then. UNKNOWN_RESOURCE: no such
    /// upload.
    Result<Progress> chunk(const proto::ResourceChunk& chunk);
    /// The store has written more of some: what that leads to, or why the upload has ended.
    std::vector<std::pair<Upload, Result<Progress>>> written();
    /// Whether chunks of this ended upload may still be under way, so that they need no answer.
    bool endedLately(std::string_view transfer_id) const;
    const Upload* find(std::string_view transfer_id) const;
    /// The upload leaves the desk; the path of the file, or HASH_MISMATCH.
    Result<std::string> finish(std::string_view transfer_id);
    /// All of them, resumable.
    std::vector<Upload> suspendAll();

  private:
    Result<Progress> advance(const std::string& transfer_id, Upload& upload);
    void end(const std::string& transfer_id);

    ResourceStore& store_;
    const std::uint64_t bytes_max_;
    const std::uint64_t window_;
    std::map<std::string, Upload, std::less<>> uploads_;
    std::deque<std::string> ended_;
};

}  // namespace axon::entity_manager
