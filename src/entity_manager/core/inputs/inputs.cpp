// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/inputs/inputs.hpp"

#include <algorithm>
#include <chrono>
#include <utility>

#include "entity_manager/core/services/message_size.hpp"
#include "entity_manager/core/services/tell_services.hpp"
#include "entity_manager/ports/core_settings.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

constexpr std::size_t kQuestions = 64;

/// An application that does not answer must not leave its asker waiting for ever.
Refusal unanswered(Duration within) {
    return {RefusalCode::TimedOut,
            "The robot application has not answered within " +
                std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(within).count()) +
                " ms. It may be hanging: look at it, then try again.",
            {}};
}

}  // namespace

Inputs::Inputs(Turn& turn, Others& others, Storage& storage, ResourceStore& store, ServiceProfiler& profiler,
               Settings settings)
    : turn_(turn),
      others_(others),
      store_(store),
      profiler_(profiler),
      settings_(settings),
      saved_(storage),
      uploads_(store, settings.resource_bytes_max, settings.resource_window) {}

void Inputs::askParameter(const Incident& incident) {
    const auto& request = incident.body->set_param();
    auto checked = profiler_.checkParam(request.service(), request.param());
    if (!checked) {
        turn_.refuse(incident, checked.refusal());
        return;
    }
    if (questions_.size() >= kQuestions) {
        turn_.refuse(incident, {RefusalCode::Overloaded,
                                "The robot application has " + std::to_string(kQuestions) +
                                    " requests to answer already. Wait for some answers.",
                                {}});
        return;
    }
    Question question;
    question.asker = incident.head->sender;
    question.lease = incident.head->held;
    question.request_id = request.request_id();
    question.service = checked->first;
    question.param = std::move(checked->second);
    const auto number = next_question_++;
    proto::EmToEi message;
    auto& ask = *message.mutable_param();
    ask.set_request(number);
    ask.set_service(profiler_.record(question.service).name());
    *ask.mutable_param() = question.param;
    question.generation = turn_.stops().generation;
    ask.set_stop_generation(question.generation);
    if (const auto refusal = checkSize(message.ByteSizeLong()); !refusal.ok()) {
        turn_.refuse(incident, refusal);
        return;
    }
    question.until = turn_.now() + settings_.answer_within;
    questions_.emplace(number, std::move(question));
    turn_.toApplication(message);
}

void Inputs::answered(const proto::RequestAnswer& answer) {
    const auto at = questions_.find(answer.request());
    if (at == questions_.end()) {
        ++turn_.count().unexpected;
        return;
    }
    const auto question = std::move(at->second);
    questions_.erase(at);
    Refusal refusal;
    if (answer.has_refusal() && answer.refusal().code() != proto::OK) {
        refusal = toRefusal(answer.refusal());
        if (refusalName(refusal.code) == refusalName(RefusalCode::Internal))
            refusal.code = RefusalCode::Denied;
        if (refusal.message.empty()) refusal.message = "The robot application denied it without a reason.";
    }
    if (question.of_resource) {
        const auto* found = uploads_.find(question.request_id);
        if (found == nullptr) return;
        if (refusal.ok()) {
            const auto upload = *found;
            uploadProgress(upload, uploads_.accept(question.request_id));
        } else {
            uploads_.deny(question.request_id);
            conclude(question, refusal);
        }
        return;
    }
    // Between question and answer the lease may have ended; what was meant for it is not kept for the next
    // holder.
    const bool present = turn_.held() != nullptr && turn_.held()->number == question.lease;
    if (refusal.ok() && !present)
        refusal = {
            RefusalCode::RevokedLease, "The lease ended before the robot application had answered.", {}};
    if (refusal.ok()) refusal = keepParameter(question);
    conclude(question, refusal);
    if (refusal.ok()) tellServices(turn_, profiler_, {question.service});
}

Refusal Inputs::keepParameter(const Question& question) {
    const auto& record = profiler_.record(question.service);
    const bool config = profiler_.isConfig(question.service, question.param.name());
    if (config) {
        // It reaches what runs now, which may have begun after a stop that came before the answer, or go on
        // alone.
        if (auto refusal = others_.checkGeneration(static_cast<std::int32_t>(question.generation));
            !refusal.ok())
            return refusal;
        if (turn_.orphaned())
            return {RefusalCode::ClientLost,
                    "The client was lost before the robot application had answered.",
                    {}};
        if (auto refusal = saved_.mayKeepConfig(record.name(), question.param); !refusal.ok()) return refusal;
        if (auto refusal = others_.leavesRoom(question.service, question.param); !refusal.ok())
            return refusal;
    }
    profiler_.storeParam(question.service, question.param);
    if (const auto param = findParamIndex(record, question.param.name()))
        saved_.set(record.name(), record.params(param.value()), question.param);
    if (config) others_.reconfigure(question.service, question.param);
    return {};
}

void Inputs::tellConfiguration() {
    proto::EmToEi message;
    std::size_t bytes = 0;
    for (auto& one : profiler_.configuration()) {
        const auto more = one.ByteSizeLong() + 8;  // with its tag and length
        if (bytes > 0 && bytes + more > kMessageMax) {
            turn_.toApplication(message);
            message.Clear();
            bytes = 0;
        }
        message.mutable_configuration()->add_params()->Swap(&one);
        bytes += more;
    }
    if (bytes > 0) turn_.toApplication(message);
}

void Inputs::conclude(const Question& question, const Refusal& refusal) {
    if (question.of_resource)
        sendResourceDone(question.asker, question.request_id, question.resource_name, refusal);
    else
        turn_.reply(question.asker, question.request_id, refusal);
}

void Inputs::abandon(const Refusal& reason) {
    for (const auto& [number, question] : std::exchange(questions_, {})) {
        if (question.of_resource) uploads_.suspend(question.request_id);
        conclude(question, reason);
    }
}

void Inputs::carryResource(const Incident& incident) {
    const auto& to = incident.head->sender;
    if (incident.body->has_resource_offer()) {
        const auto& offer = incident.body->resource_offer();
        const auto place = profiler_.findResource(offer.service(), offer.resource());
        if (!place) {
            turn_.refuse(incident, place.refusal());
            return;
        }
        // The names of the profile, not the spelling of the client: they become a path.
        auto named = offer;
        const auto& service = profiler_.record(place->first);
        named.set_service(service.name());
        named.set_resource(service.resources(place->second).name());
        const auto progress =
            uploads_.offer(named, place->first, place->second, to, turn_.held()->taken_by, turn_.now());
        if (!progress)
            turn_.refuse(incident, progress.refusal());
        else if (const auto* upload = uploads_.find(offer.transfer_id()))
            uploadProgress(*upload, progress);
        return;
    }
    const auto& chunk = incident.body->resource_chunk();
    const auto* found = uploads_.find(chunk.transfer_id());
    const auto upload = found != nullptr ? std::optional(*found) : std::nullopt;
    auto progress = uploads_.chunk(chunk);
    if (upload) {
        if (!progress) forgetQuestion(chunk.transfer_id());
        uploadProgress(*upload, progress);
    } else {
        turn_.refuse(incident, progress.refusal());
    }
}

void Inputs::uploadProgress(const UploadDesk::Upload& upload, const Result<UploadDesk::Progress>& progress) {
    const std::string transfer_id = upload.offer.transfer_id();
    if (!progress) {
        sendResourceDone(upload.asker, transfer_id, upload.offer.resource(), progress.refusal());
        return;
    }
    if (progress->window > 0) tellCredit(upload, progress->offset, progress->window);
    if (progress->next == UploadDesk::Progress::Next::Ask) askResource(upload, progress->path);
    if (progress->next != UploadDesk::Progress::Next::Placed) return;
    // The profile may have been read anew meanwhile, and then has found the file by itself or has no such
    // resource.
    const auto place = profiler_.findResource(upload.offer.service(), upload.offer.resource());
    if (place)
        profiler_.storeResource(place->first, place->second, progress->path, upload.offer.sha256(),
                                upload.offer.size());
    sendResourceDone(upload.asker, transfer_id, upload.offer.resource(), {});
    if (place) tellServices(turn_, profiler_, {place->first});
}

void Inputs::askResource(const UploadDesk::Upload& upload, const std::string& path) {
    if (questions_.size() >= kQuestions) {
        uploads_.suspend(upload.offer.transfer_id());
        sendResourceDone(upload.asker, upload.offer.transfer_id(), upload.offer.resource(),
                         {RefusalCode::Overloaded,
                          "The robot application has too many requests to answer. Try again.",
                          {}});
        return;
    }
    Question question;
    question.asker = upload.asker;
    question.request_id = upload.offer.transfer_id();
    question.of_resource = true;
    question.resource_name = upload.offer.resource();
    const auto number = next_question_++;
    proto::EmToEi message;
    auto& ask = *message.mutable_resource();
    ask.set_request(number);
    ask.set_service(upload.offer.service());
    ask.set_resource(upload.offer.resource());
    ask.set_path(path);
    ask.set_size(upload.offer.size());
    question.until = turn_.now() + settings_.answer_within;
    questions_.emplace(number, std::move(question));
    turn_.toApplication(message);
}

/// Of an upload that has ended.
void Inputs::forgetQuestion(const std::string& transfer_id) {
    std::erase_if(questions_, [&](const auto& question) {
        return question.second.of_resource && question.second.request_id == transfer_id;
    });
}

/// Without a window: it is not forgotten, and nothing more may be sent yet.
void Inputs::tellCredit(const UploadDesk::Upload& upload, std::uint64_t offset, std::uint64_t window) {
    proto::ToClient message;
    auto& credit = *message.mutable_resource_credit();
    credit.set_transfer_id(upload.offer.transfer_id());
    credit.set_offset(offset);
    credit.set_window(window);
    turn_.tell(upload.asker, kMsgResource, message);
}

void Inputs::onStored() {
    for (const auto& [upload, progress] : uploads_.answered()) uploadProgress(upload, progress);
}

void Inputs::onTimer() {
    const auto now = turn_.now();
    while (!questions_.empty() && questions_.begin()->second.until <= now) {
        const auto question = std::move(questions_.begin()->second);
        questions_.erase(questions_.begin());
        if (question.of_resource) uploads_.suspend(question.request_id);
        conclude(question, unanswered(settings_.answer_within));
    }
    for (const auto& upload : uploads_.takeSigns(now)) tellCredit(upload, upload.received, 0);
}

TimePoint Inputs::nextDeadline() const {
    auto next = uploads_.nextSign().value_or(TimePoint::max());
    if (!questions_.empty()) next = std::min(next, questions_.begin()->second.until);
    return next;
}

void Inputs::refuseResource(const Incident& incident, const Refusal& refusal) {
    const auto& to = incident.head->sender;
    if (incident.body->has_resource_offer()) {
        const auto& offer = incident.body->resource_offer();
        sendResourceDone(to, offer.transfer_id(), offer.resource(), refusal);
    } else if (!uploads_.endedLately(incident.body->resource_chunk().transfer_id())) {
        sendResourceDone(to, incident.body->resource_chunk().transfer_id(), {}, refusal);
    }
}

void Inputs::remove(const std::string& service, const std::string& resource) {
    if (!uploads_.placing(service, resource)) store_.remove(service, resource);
}

void Inputs::suspendUploads(const Refusal& reason) {
    for (const auto& upload : uploads_.suspendAll()) {
        forgetQuestion(upload.offer.transfer_id());
        sendResourceDone(upload.asker, upload.offer.transfer_id(), upload.offer.resource(), reason);
    }
}

void Inputs::sendResourceDone(const Sender& to, const std::string& transfer_id, const std::string& resource,
                              const Refusal& refusal) {
    proto::ToClient message;
    auto& done = *message.mutable_resource_done();
    done.set_transfer_id(transfer_id);
    done.set_resource(resource);
    if (!refusal.ok()) *done.mutable_refusal() = toProto(refusal);
    turn_.tell(to, kMsgResource, message);
}

}  // namespace axon::entity_manager
