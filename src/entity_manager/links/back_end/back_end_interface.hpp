// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include "common/ids.hpp"
#include "entity_manager/links/back_end/application_search.hpp"
#include "entity_manager/ports/ports.hpp"
#include "entity_manager/ports/stop_generations.hpp"
#include "host/port_range.hpp"

namespace axon::proto {
class EiToEm;
}

namespace axon::entity_manager {

struct BackEndSettings {
    std::string application;  ///< the robot application's name, as its Entity Interfacer was given it
    std::string instance;     ///< empty = any instance
    LinkPorts where;          ///< of ports.cfg
    std::string ports_from;   ///< which file or option said so, for people
    std::string manager;      ///< who we are, for the messages that a second Entity Manager gets
    std::chrono::milliseconds watchdog_busy{250};
    std::chrono::milliseconds watchdog_idle{500};
    bool beyond_loopback = false;                       ///< the link has no authentication
    Duration report_after = ApplicationSearch::kFirst;  ///< looking for the application in vain
};

/// Whom the link tells. Called on the strand, never from within a call of BackEndInterface.
class BackEndEvents {
  public:
    virtual ~BackEndEvents() = default;
    virtual void onLinkUp() = 0;
    virtual void onLinkDown(const std::string& reason, LinkEnd end) = 0;
    /// Everything but Welcome and beats, from both lanes.
    virtual void onLinkMessage(const proto::EiToEm& message) = 0;
    /// For the operator: our application is there and does not want us (ALREADY_HELD, NOT_SUPPORTED), or a
    /// message was larger than a frame (TOO_LARGE). Told when the reason changes.
    virtual void onLinkRefused(const Refusal&) {}
    /// For the operator: the application has not been found for a while. Repeated, less and less often.
    virtual void onLinkSought(const SearchReport&) {}
    /// For the operator: the application's beats come late, once a minute at most.
    virtual void onLinkSlow(const std::string&) {}
    /// For the operator: the application that has been linked has another release than this program. Once for
    /// each release.
    virtual void onLinkRelease(const std::string&) {}
};

/// The Entity Manager's end of the link to the robot application (thesis 3.3.1), over TCP.
///
/// Where in the flow: between EntityManagerCore and the Entity Interfacer.
///
/// States: looking → linking (first connection welcome) → linked → looking. While looking it tries the first
/// 32 ports of the range and the last good one every 100 ms, and the whole range with backoff (50 ms to 1 s):
/// a robot application listens on its first free port, so it is found within the shorter period. Listeners
/// that are not our application are passed over for a while. What is there instead is reported after
/// `report_after` and again with back-off (onLinkSought).
///
/// Threads: everything on the strand it is given, but stop(), which any thread may call: it writes to the
/// signal connection at once, past the strand and everything queued. Ownership: destroyed on the strand, or
/// when the strand runs no more; no event after that. Failure: an application that is silent, closes, sends
/// nonsense or does not read ends the link (onLinkDown), and looking begins again.
class BackEndInterface final : public BackEndPort {
  public:
    /// Throws std::invalid_argument, with the fix, where the settings cannot work.
    BackEndInterface(asio::any_io_executor strand, BackEndSettings settings,
                     const StopGenerations& stop_generations, const Clock& clock, RandomSource& random,
                     BackEndEvents& events);
    ~BackEndInterface() override;
    BackEndInterface(const BackEndInterface&) = delete;
    BackEndInterface& operator=(const BackEndInterface&) = delete;

    /// Begins to look. From then on for ever, until close().
    void start();
    /// Ends the link (the application stops by itself) without an event.
    void close();

    /// Raw data for an application that reads slowly: the oldest is dropped. Anything else ends the link when
    /// the queue is full.
    bool send(const proto::EmToEi& message) override;
    std::uint64_t rawDropped() const;  ///< frames, since construction. Any thread.
    void stop(std::uint32_t generation, StopCause cause) override;
    void setBusy(bool busy) override;
    std::vector<HopMargin> margins() const override;

  private:
    class Connections;
    std::shared_ptr<Connections> connections_;
};

}  // namespace axon::entity_manager
