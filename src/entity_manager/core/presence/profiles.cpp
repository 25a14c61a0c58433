// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/presence/profiles.hpp"

#include <utility>

#include "common/utf8.hpp"
#include "entity_manager/core/services/tell_services.hpp"
#include "entity_manager/ports/core_settings.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

constexpr std::size_t kActiveTold = 1024;

template <class Message>
std::string errorsOf(const Reading<Message>& reading) {
    std::string text;
    for (const auto& finding : reading.findings)
        if (finding.severity == Finding::Severity::Error)
            text += (text.empty() ? "" : "\n") + finding.toString();
    return text;
}

/// At the end of a line, where it is too long.
std::string cutReason(std::string text) {
    if (text.size() <= kReasonMax) return text;
    const auto line = text.rfind('\n', kReasonMax);
    text.resize(line == std::string::npos ? kReasonMax : line);
    return text + "\n… and more";
}

}  // namespace

Profiles::Profiles(Turn& turn, Others& others, Readiness& readiness, ResourceStore& store,
                   ServiceProfiler& profiler, Settings settings)
    : turn_(turn),
      others_(others),
      readiness_(readiness),
      store_(store),
      profiler_(profiler),
      settings_(std::move(settings)) {}

void Profiles::report() {
    answer({RefusalCode::Malformed, amiss_, {}});
}

void Profiles::amiss(std::string why) {
    amiss_ = std::move(why);
    readiness_.notReady(amiss_);
}

void Profiles::onStored() {
    takeGood();
    takeLook();
}

void Profiles::answer(const Refusal& refusal) {
    proto::EmToEi message;
    *message.mutable_profile_error() = toProto(refusal);
    turn_.toApplication(message);
}

void Profiles::await() {
    basic_.reset();
    services_.reset();
    due_ = turn_.now() + settings_.within;
}

void Profiles::linkDown() {
    due_.reset();
    kept_.clear();  // the next link begins with what the application has then
    located_.reset();
}

void Profiles::uploaded(proto::ProfileUpload& upload) {
    if (findRow(turn_.state(), Event::ProfileUploaded) == nullptr) {
        keep(upload);
        return;
    }
    read(upload);
    Incident incident{Event::ProfileUploaded};
    incident.reason = {
        RefusalCode::Unavailable, "Its profiles are being read again. Try again in a moment.", {}};
    turn_.fire(incident);
}

void Profiles::activeIs(const proto::ServiceActive& told) {
    auto reason = std::string(cutUtf8(told.reason(), kReasonMax));
    // Kept by name, for profiles that are read anew; the application says it only once.
    if (active_told_.size() < kActiveTold || active_told_.contains(told.service()))
        active_told_[told.service()] = {told.active(), reason};
    if (const auto service = profiler_.setActive(told.service(), told.active(), std::move(reason)))
        tellServices(turn_, profiler_, {service.value()});
    else
        ++turn_.count().unexpected;
}

void Profiles::read(const proto::ProfileUpload& upload) {
    if (upload.services()) {
        services_ = readServicesProfile(upload.xml(), upload.file_name());
        roots_ = {upload.folder(), {upload.resource_folders().begin(), upload.resource_folders().end()}};
    } else {
        basic_ = readBasicProfile(upload.xml(), upload.file_name());
    }
}

/// The services that a holder was granted do not change under its hands.
void Profiles::keep(proto::ProfileUpload& upload) {
    auto refusal = refusalFor(turn_.state(), Event::ProfileUploaded);
    const auto errors = upload.services() ? errorsOf(readServicesProfile(upload.xml(), upload.file_name()))
                                          : errorsOf(readBasicProfile(upload.xml(), upload.file_name()));
    if (!errors.empty()) refusal.message += " fix: correct its errors before that.\n" + cutReason(errors);
    answer(refusal);
    others_.tellNews(upload.file_name() +
                     " has changed while the entity is checked out: kept for its release" +
                     (errors.empty() ? "" : ", and it has errors: " + cutReason(errors)));
    kept_[upload.services()].Swap(&upload);
}

/// At the release, before the next who waits is given the entity.
void Profiles::takeKept() {
    if (kept_.empty() || findRow(turn_.state(), Event::KeptProfileTaken) == nullptr) return;
    std::string names;
    for (const auto& [services, upload] : std::exchange(kept_, {})) {
        names += (names.empty() ? "" : " and ") + upload.file_name();
        read(upload);
    }
    const auto news = names + ": the profile that was kept is uploaded now, at the release";
    others_.tellNews(news);
    answer({RefusalCode::Ok, news, {}});
    turn_.fire(Event::KeptProfileTaken);
}

void Profiles::consider() {
    located_.reset();
    if (!basic_ || !services_) {
        if (!due_) due_ = turn_.now() + settings_.within;
        return;
    }
    due_.reset();
    if (!basic_->ok() || !services_->ok()) {
        const auto basic = errorsOf(*basic_);
        const auto services = errorsOf(*services_);
        amiss(cutReason(basic + (basic.empty() || services.empty() ? "" : "\n") + services));
        turn_.fire(Event::ProfilesBad);
        return;
    }
    located_ = store_.locate(roots_, ServiceProfiler::resourcesOf(services_->message));
    due_ = turn_.now() + settings_.within;
    takeGood();
}

/// They are good, and where the files of the resources lie is known.
void Profiles::takeGood() {
    if (!located_ || !located_->ready()) return;
    due_.reset();
    const auto places = std::exchange(located_, std::nullopt)->value();
    located_again_.reset();
    profiler_.load(services_->message, settings_.entity, places);
    for (const auto& [service, told] : active_told_) {
        [[maybe_unused]] const auto known =
            profiler_.setActive(service, told.first, told.second);  // not all are in this profile
    }
    others_.profilesAreGood(basic_->message);
}

/// Files that the robot's owner puts in their places come without a word.
void Profiles::lookAgain() {
    if (located_ || located_again_ || !profiler_.hasUrls()) return;
    located_again_ = store_.locate(roots_, profiler_.resources());
    takeLook();
}

void Profiles::takeLook() {
    if (!located_again_ || !located_again_->ready()) return;
    tellServices(turn_, profiler_, profiler_.relocate(std::exchange(located_again_, std::nullopt)->value()));
}

/// What is missing, where an entity would wait in INIT for ever without a word: an application has uploaded
/// too little, or the disk does not answer.
void Profiles::onTimer() {
    if (!due_ || turn_.now() < *due_) return;
    due_.reset();
    if (turn_.state() != EntityState::INIT) return;
    if (located_) {
        const std::string why =
            "a disk of the robot's machine does not answer, so it is not known whether the files of the "
            "resources "
            "are there; fix: see that the state folder and the folders of the urls can be read";
        amiss(why);
        turn_.warn(why);
        others_.tellStatus();
        return;
    }
    std::string missing = "the robot application " + inQuotes(settings_.application) + " has uploaded ";
    if (!basic_ && !services_)
        missing +=
            "no profile; fix: give its Entity Interfacer both (uploadBasicProfile, uploadServiceProfile)";
    else if (!services_)
        missing +=
            "its basic profile and no services profile; fix: give its Entity Interfacer that too "
            "(uploadServiceProfile)";
    else
        missing +=
            "its services profile and no basic profile; fix: give its Entity Interfacer that too "
            "(uploadBasicProfile)";
    const auto errors = basic_ ? errorsOf(*basic_) : services_ ? errorsOf(*services_) : std::string();
    if (!errors.empty()) {
        amiss(cutReason(errors) + "\n" + missing);
        turn_.fire(Event::ProfilesBad);
        return;
    }
    amiss(missing);
    turn_.warn(missing);
    answer({RefusalCode::Malformed, missing, {}});
    others_.tellStatus();
}

TimePoint Profiles::nextDeadline() const {
    return due_.value_or(TimePoint::max());
}

}  // namespace axon::entity_manager
