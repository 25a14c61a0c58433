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
/// `plug_in`: the property by which it was loaded; `for_this_only`: the plug-in does nothing else. Without
/// the traces that are needed, and without a trail, that one throws; another warns, and `refusals` is null.
/// Throws Ice::PluginInitializationException, with the fix, for a trail that cannot be kept, or that there
/// would be without the traces.
struct WatchedProgram {
    std::shared_ptr<Refusals> refusals;
    Ice::LoggerPtr logger;
};
WatchedProgram watchRefusals(const Ice::CommunicatorPtr& communicator, const std::string& plug_in,
                             bool for_this_only);

}  // namespace axon::router_guard
