// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <string>
#include <vector>

#include "common/result.hpp"
#include "entity_manager/core/streams/stream_watches.hpp"
#include "entity_manager/core/turn/turn.hpp"

namespace axon::entity_manager {

/// Samples of the robot application's streams on their way to whoever watches them, and which streams the
/// application is told to send. The holder watches all of them without asking.
class Streams {
  public:
    explicit Streams(Turn& turn) : turn_(turn) {}

    /// A client begins or ends to watch. Why not: a name that is too long, or too many streams.
    Result<void> watch(const std::string& client, const proto::Watch& watch);
    /// The client is gone.
    void forget(const std::string& client) { tellApplication(watches_.forget(client)); }
    /// The holder has changed: to somebody the application has to send all streams.
    void holderBegan() {
        if (all_off_) tellApplication({{"", true}});
    }
    /// A link begins with all streams on.
    void linkUp() { all_off_ = false; }
    /// The application's profiles are good: it is told what is watched.
    void tellPresent() { tellApplication(watches_.present()); }

    /// To everybody who watches its stream; counted as undelivered where nobody does. The sample is left in
    /// some valid state.
    void pass(proto::StreamSample& sample);

  private:
    void tellApplication(const std::vector<StreamWatches::Switch>& switches);
    std::string holderId() const;

    Turn& turn_;
    StreamWatches watches_;
    bool all_off_ = false;     ///< the application has been told to send only what is watched by name
    proto::ToClient message_;  ///< kept for its memory
};

}  // namespace axon::entity_manager
