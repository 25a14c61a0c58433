// SPDX-License-Identifier: MIT
#pragma once
#include <array>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

namespace axon::proto {
class EiToEm;
}  // namespace axon::proto

namespace axon {

/// What the application has said of itself and the next Entity Manager must know too: its position, and which
/// of its services are active. A service is inactive as well while onConfig has not taken the value of one of
/// its parameters, whatever the application says.
///
/// Threads: any. The mutex is held while a statement is sent, so that none overtakes a newer one, and while a
/// link is published, so that none comes between what is repeated and what is sent. Sending does not wait:
/// what the socket does not take goes into the link's queue. The stop thread takes the mutex only where
/// onStop itself makes a statement. Bounded by the names that the application uses.
class Statements {
  public:
    /// Called with the mutex held; must not call back.
    using Send = std::function<void(const proto::EiToEm&)>;

    /// To be repeated to the next link. The caller sends it.
    void positionIs(double x, double y, double z);
    void activeIs(std::string_view service, bool active, std::string_view reason, const Send& send);
    /// Whether onConfig has taken the value of this parameter, or why not. Sent where that changes anything.
    void valueTaken(const std::string& service, const std::string& parameter,
                    const std::optional<std::string>& why_not, const Send& send);
    /// Why no task of this service may begin; nothing: one may.
    std::optional<std::string> whyNotTaken(const std::string& service) const;
    /// A link begins: repeats all that was said to it, and then lets others send by it (`publish`). What was
    /// not taken is forgotten, since all values are told again.
    void repeat(const Send& send, const std::function<void()>& publish);

  private:
    proto::EiToEm activityOf(const std::string& service) const;

    mutable std::mutex mutex_;
    std::optional<std::array<double, 3>> position_;  // these three guarded by mutex_
    /// By service: active or not, and why.
    std::map<std::string, std::pair<bool, std::string>, std::less<>> active_;
    /// Of the present link: by service and parameter, why onConfig has not taken the value. What the
    /// application says of such a service counts when it has taken another.
    std::map<std::pair<std::string, std::string>, std::string> not_taken_;
};

}  // namespace axon
