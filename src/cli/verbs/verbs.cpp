// SPDX-License-Identifier: GPL-2.0-or-later
#include <string_view>

#include "cli/session.hpp"

namespace axon::cli {

extern const Verb kLs, kInfo, kCheckout, kRelease, kRun, kSet, kUpload, kSend, kWatch, kTasks, kWait, kPause,
    kResume, kCancel, kStop, kDrill, kHandover, kRearm, kReset, kClear, kProfile, kDoctor, kAgent, kBench,
    kCerts, kCompletion, kComplete, kVersion, kGlobalLs, kGlobalInfo, kGlobalCheck, kGlobalRun, kGlobalStop,
    kGlobalPause, kGlobalResume, kGlobalCancel, kGlobalHistory, kHelp, kInit, kManual;

extern const Verb kAudit, kConsole, kDocs, kShell, kUsers;

const std::vector<const Verb*>& verbs() {
    static const std::vector<const Verb*> all{
        &kLs,             //
        &kInfo,           //
        &kCheckout,       //
        &kRun,            //
        &kStop,           //
        &kRearm,          //
        &kRelease,        //
        &kHandover,       //
        &kSet,            //
        &kUpload,         //
        &kSend,           //
        &kWatch,          //
        &kTasks,          //
        &kWait,           //
        &kPause,          //
        &kResume,         //
        &kCancel,         //
        &kReset,          //
        &kClear,          //
        &kGlobalLs,       //
        &kGlobalInfo,     //
        &kGlobalCheck,    //
        &kGlobalRun,      //
        &kGlobalStop,     //
        &kGlobalPause,    //
        &kGlobalResume,   //
        &kGlobalCancel,   //
        &kGlobalHistory,  //
        &kInit,           //
        &kProfile,        //
        &kDrill,          //
        &kDoctor,         //
        &kBench,          //
        &kCerts,          //
        &kUsers,          //
        &kAudit,          //
        &kAgent,          //
        &kConsole,        //
        &kShell,          //
        &kDocs,           //
        &kCompletion,     //
        &kHelp,           //
        &kComplete,       //
        &kManual,         //
        &kVersion,        //
    };
    return all;
}

const std::vector<VerbGroup>& verbGroups() {
    static const std::vector<VerbGroup> all{
        {"global", "Global services: several robots together",
         "Get started:\n"
         "  axon global ls                  list the global services of the server\n"
         "  axon global info 'Fetch ball'   show its steps, and which robots can play its roles\n"
         "  axon global check 'Fetch ball'  check whether it can run; nothing moves\n"
         "  axon global run 'Fetch ball'    run it\n"
         "axon global VERB --help shows more. axon --help shows the options that all verbs share (--server, "
         "--json, …).\n"}};
    return all;
}

const VerbGroup* findGroup(const std::string& name) {
    for (const auto& group : verbGroups()) {
        if (name == group.name) return &group;
    }
    return nullptr;
}

const Verb* findVerb(const std::string& name) {
    for (const auto* verb : verbs()) {
        if (name == verb->name) return verb;
    }
    return nullptr;
}

}  // namespace axon::cli
