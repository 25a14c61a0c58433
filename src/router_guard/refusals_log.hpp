// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <memory>
#include <string>

#include "router_guard/refusals.hpp"

namespace axon::router_guard {

/// The logger of a program of Ice's. Passes everything on to the one that it had before, but traces of
/// category "Network" go to Refusals, and on only from Ice.Trace.Network=3 on, as 2 is what Refusals needs.
/// Threads: any. Written for the C++98 mapping of Ice.
class RefusalsLog final : public Ice::Logger {
  public:
    RefusalsLog(Ice::LoggerPtr before, std::shared_ptr<Refusals> refusals, bool pass_on);
    void print(const std::string& message) override;
    void trace(const std::string& category, const std::string& message) override;
    void warning(const std::string& message) override;
    void error(const std::string& message) override;
    std::string getPrefix() override;
    Ice::LoggerPtr cloneWithPrefix(const std::string& prefix) override;

  private:
    const Ice::LoggerPtr before_;
    const std::shared_ptr<Refusals> refusals_;
    const bool pass_on_;
};

/// What these properties say of refusals (docs/reference/audit.md): the logger of the program from now on.
/// Null where the configuration has neither a trail nor the traces that are needed. Throws
/// Ice::PluginInitializationException, with the fix, for a trail that cannot be kept or without the traces.
struct WatchedProgram {
    std::shared_ptr<Refusals> refusals;
    Ice::LoggerPtr logger;
};
WatchedProgram watchRefusals(const Ice::CommunicatorPtr& communicator);

}  // namespace axon::router_guard
