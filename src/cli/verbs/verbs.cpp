// SPDX-License-Identifier: GPL-2.0-or-later
#include <string_view>

#include "cli/session.hpp"

namespace axon::cli {

extern const Verb kLs, kInfo, kCheckout, kRelease, kRun, kSet, kUpload, kSend, kWatch, kTasks, kPause,
    kResume, kCancel, kStop, kDrill, kHandover, kRearm, kReset, kClear, kProfile, kDoctor, kAgent,
    kCerts, kCompletion, kComplete, kVersion;

const std::vector<const Verb*>& verbs() {
    static const std::vector<const Verb*> all{
        &kLs,          //
        &kInfo,        //
        &kCheckout,    //
        &kRun,         //
        &kStop,        //
        &kRearm,       //
        &kRelease,     //
        &kHandover,    //
        &kSet,         //
        &kUpload,      //
        &kSend,        //
        &kWatch,       //
        &kTasks,       //
        &kPause,       //
        &kResume,      //
        &kCancel,      //
        &kReset,       //
        &kClear,       //
        &kProfile,     //
        &kDrill,       //
        &kDoctor,      //
        &kCerts,       //
        &kAgent,       //
        &kCompletion,  //
        &kComplete,    //
        &kVersion,     //
    };
    return all;
}

const Verb* findVerb(const std::string& name) {
    for (const auto* verb : verbs()) {
        if (name == verb->name) return verb;
    }
    return nullptr;
}

}  // namespace axon::cli
