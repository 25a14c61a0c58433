// SPDX-License-Identifier: GPL-2.0-or-later
#include "tests/support/core_rig.hpp"

#include <algorithm>
#include <charconv>
#include <cstdio>

#include "common/rights.hpp"

namespace axon::test {

const char* const kRigBasicProfile = R"(<?xml version="1.0" encoding="UTF-8"?>
<BasicProfile name="Rig" category="ROBOT" type="MOBILE" descr="Not a robot" xpos="1000" ypos="1500" zpos="0"/>
)";

const char* const kRigServicesProfile = R"(<?xml version="1.0" encoding="UTF-8"?>
<ServiceProfile count="6">
  <Service name="Driving" type="SMPL" global_id="Drive" blocking="true" pausable="true" parameter_count="3">
    <Parameters>
      <Param name="Distance" type="INPUT" data_type="INT" units="mm" required="true" savable="false" minimum="-5000" maximum="5000"/>
      <Param name="Speed" type="CONFIG" data_type="INT" units="mm/s" value="200" savable="true"/>
      <Param name="Travelled" type="OUTPUT" data_type="INT" units="mm"/>
    </Parameters>
  </Service>
  <Service name="Turning" type="SMPL" blocking="true" pausable="false"/>
  <Service name="Sonar" type="SMPL" blocking="false"/>
  <Service name="Light" type="SMPL" blocking="false"/>
  <Service name="Delivery" type="SMPL" parameter_count="1" resource_count="1">
    <Parameters>
      <Param name="Room" type="INPUT" data_type="STR" required="true"/>
    </Parameters>
    <Resources>
      <Resource name="Map" required="true" savable="false"/>
    </Resources>
  </Service>
  <Service name="Tour" type="CMPLX">
    <Services>
      <ServiceRef name="Driving"/>
      <ServiceRef name="Turning"/>
    </Services>
  </Service>
</ServiceProfile>
)";

std::string idOf(const std::string& name) {
    std::string id = name;
    id.resize(16);
    return id;
}

std::string nameOf(const std::string& id) {
    return id.empty() ? "-" : id.substr(0, id.find('\0'));
}

proto::Param paramOf(const std::string& text) {
    proto::Param param;
    const auto equals = text.find('=');
    param.set_name(text.substr(0, equals));
    const auto value = equals == std::string::npos ? std::string() : text.substr(equals + 1);
    std::int64_t number = 0;
    double real = 0;
    const auto* end = value.data() + value.size();
    auto& out = *param.add_values();
    if (std::from_chars(value.data(), end, number).ptr == end && !value.empty())
        out.set_int_(number);
    else if (std::from_chars(value.data(), end, real).ptr == end && !value.empty())
        out.set_dbl(real);
    else if (value == "true" || value == "false")
        out.set_bool_(value == "true");
    else
        out.set_str(value);
    return param;
}

std::optional<std::string> MemoryStorage::load(std::string_view key) {
    const auto at = values.find(key);
    return at == values.end() ? std::nullopt : std::optional(at->second);
}
void MemoryStorage::save(std::string_view key, std::string_view value) {
    writes.push_back({std::string(key), std::string(value), true});
    values[std::string(key)] = value;
}
void MemoryStorage::keep(std::string_view key, std::string_view value) {
    if (full) return;
    writes.push_back({std::string(key), std::string(value)});
    values[std::string(key)] = value;
}
void MemoryStorage::forget(std::string_view key) {
    writes.push_back({std::string(key), std::nullopt});
    values.erase(std::string(key));
}

bool MemoryJournal::append(const entity_manager::JournalRecord& record) {
    if (full) return false;
    records.push_back(record);
    return true;
}
entity_manager::Later<bool> MemoryJournal::appendDispatch(const entity_manager::JournalRecord& record) {
    return answer<bool>([this, record] { return append(record); });
}
void MemoryJournal::replay(const std::function<void(const entity_manager::JournalRecord&)>& each) {
    for (const auto& record : records) each(record);
}

std::string MemoryResources::fakeHash(std::string_view content) {
    SeededRandom random(std::hash<std::string_view>{}(content));
    std::string hash(32, '\0');
    random.fill(hash.data(), hash.size());
    return hash;
}
entity_manager::Later<Result<std::uint64_t>> MemoryResources::begin(const proto::ResourceOffer& offer,
                                                                    const std::string& owner) {
    return answer<Result<std::uint64_t>>([this, offer, owner] {
        open[offer.transfer_id()] = offer;
        if (owners[offer.sha256()] != owner) partial[offer.sha256()].clear();
        owners[offer.sha256()] = owner;
        return static_cast<std::uint64_t>(partial[offer.sha256()].size());
    });
}
Result<void> MemoryResources::write(std::string_view transfer_id, std::uint64_t offset,
                                    std::string_view content) {
    auto& so_far = partial[open.find(transfer_id)->second.sha256()];
    if (offset != so_far.size()) return Refusal{RefusalCode::Internal, "gap", {}};
    so_far += content;
    return {};
}
Result<std::uint64_t> MemoryResources::waiting(std::string_view) const {
    if (!failure.ok()) return failure;
    return behind;
}
entity_manager::Later<Result<std::string>> MemoryResources::check(std::string_view transfer_id) {
    return answer<Result<std::string>>([this, id = std::string(transfer_id)]() -> Result<std::string> {
        const auto& offer = open.at(id);
        if (fakeHash(partial[offer.sha256()]) == offer.sha256())
            return "/store/" + offer.service() + '/' + offer.resource();
        drop(id);
        return Refusal{RefusalCode::HashMismatch, "The hash differs.", {}};
    });
}
entity_manager::Later<Result<std::string>> MemoryResources::place(std::string_view transfer_id) {
    return answer<Result<std::string>>([this, id = std::string(transfer_id)]() -> Result<std::string> {
        const auto offer = open.at(id);
        const auto path = offer.service() + '/' + offer.resource();
        complete[path] = partial[offer.sha256()];
        drop(id);
        return "/store/" + path;
    });
}
void MemoryResources::suspend(std::string_view transfer_id) {
    const auto at = open.find(transfer_id);
    if (at != open.end()) open.erase(at);
}
void MemoryResources::drop(std::string_view transfer_id) {
    const auto at = open.find(transfer_id);
    if (at == open.end()) return;
    partial.erase(at->second.sha256());
    open.erase(at);
}
void MemoryResources::remove(std::string_view service, std::string_view resource) {
    complete.erase(std::string(service) + '/' + std::string(resource));
}
std::optional<std::string> MemoryResources::find(std::string_view service, std::string_view resource) {
    const auto path = std::string(service) + '/' + std::string(resource);
    return complete.contains(path) ? std::optional("/store/" + path) : std::nullopt;
}

entity_manager::Later<std::vector<entity_manager::ResourcePlace>> MemoryResources::locate(
    const entity_manager::ResourceRoots& told, std::vector<entity_manager::ResourceQuery> queries) {
    roots = told;
    auto places = ResourceStore::locate(told, queries).value();
    return answer<std::vector<entity_manager::ResourcePlace>>(
        [this, places, queries = std::move(queries)]() mutable {
            for (std::size_t i = 0; i < queries.size(); ++i) {
                const auto& url = queries[i].url;
                if (url.empty()) continue;
                auto& place = places[i];
                place = {};
                if (url.front() == '/' && roots.permitted.empty()) {
                    place.refusal = {RefusalCode::BadName, "It is not permitted.", {}};
                    continue;
                }
                place.path = url.front() == '/' ? url : roots.profiles + '/' + url;
                const auto at = files.find(place.path);
                place.there = at != files.end();
                if (place.there) place.size = at->second;
            }
            return places;
        });
}

entity_manager::Later<std::vector<std::string>> MemoryResources::absent(std::vector<std::string> wanted) {
    return answer<std::vector<std::string>>([this, files = std::move(wanted)]() mutable {
        std::erase_if(files, [this](const std::string& file) {
            return this->files.contains(file) ||
                   std::any_of(complete.begin(), complete.end(),
                               [&](const auto& resource) { return "/store/" + resource.first == file; });
        });
        return files;
    });
}

CoreRig::CoreRig(std::uint64_t seed, entity_manager::EntityManagerCoreSettings settings)
    : settings_(std::move(settings)), random_(seed) {
    restart();
}

void CoreRig::restart() {
    core_.reset();
    core_ = std::make_unique<entity_manager::EntityManagerCore>(
        settings_, clock, random_, *this, *this, storage, resources, stop_generations, &journal);
}

void CoreRig::linkUp() {
    core_->onLinkUp();
}

void CoreRig::fromApplication(proto::EiToEm message) {
    core_->onLinkMessage(std::move(message));
}

void CoreRig::upload(bool services, const std::string& xml) {
    proto::EiToEm message;
    message.mutable_profile()->set_services(services);
    message.mutable_profile()->set_file_name(services ? "services.xml" : "basic.xml");
    message.mutable_profile()->set_xml(xml);
    message.mutable_profile()->set_folder("/profiles");
    fromApplication(std::move(message));
}

void CoreRig::uploadProfiles() {
    upload(false, kRigBasicProfile);
    upload(true, kRigServicesProfile);
}

std::string CoreRig::nameOfSent(const std::string& id) const {
    const auto at = std::find(parts_.begin(), parts_.end(), id);
    return at == parts_.end() ? nameOf(id) : "part" + std::to_string(at - parts_.begin() + 1);
}

std::string CoreRig::idOfSent(const std::string& name) const {
    for (const auto& id : parts_)
        if (nameOfSent(id) == name) return id;
    return idOf(name);
}

void CoreRig::grant(const std::string& task) {
    proto::EiToEm message;
    message.mutable_task_answer()->set_task_id(idOfSent(task));
    fromApplication(std::move(message));
}

void CoreRig::deny(const std::string& task, const std::string& reason) {
    proto::EiToEm message;
    message.mutable_task_answer()->set_task_id(idOfSent(task));
    message.mutable_task_answer()->mutable_refusal()->set_code(proto::DENIED);
    message.mutable_task_answer()->mutable_refusal()->set_message(reason);
    fromApplication(std::move(message));
}

void CoreRig::update(const std::string& task, proto::TaskState state, double progress) {
    proto::EiToEm message;
    auto& event = *message.mutable_task()->mutable_event();
    event.set_task_id(idOfSent(task));
    event.set_state(state);
    event.set_progress(progress);
    fromApplication(std::move(message));
}

void CoreRig::stopDone(std::uint32_t stopped, proto::StopReceipt::Stage stage, bool standstill_follows) {
    proto::EiToEm message;
    message.mutable_stop_done()->set_stop_generation(stopped);
    message.mutable_stop_done()->set_stage(stage);
    message.mutable_stop_done()->set_standstill_follows(standstill_follows);
    fromApplication(std::move(message));
}

void CoreRig::drillDone(std::uint32_t number) {
    proto::EiToEm message;
    message.mutable_stop_done()->set_drill(number);
    message.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
    fromApplication(std::move(message));
}

Header CoreRig::headOf(const std::string& client) {
    // A client that joins is told the present status of every entity.
    const auto [at, joined] = clients.try_emplace(client);
    auto& belief = at->second;
    if (joined && !statuses.empty()) belief.generation = statuses.back().stop_generation;
    Header head;
    head.sender = {client, client + "@lab",
                   client.starts_with("admin")      ? Role::Admin
                   : client.starts_with("observer") ? Role::Observer
                                                    : Role::Operator};
    head.entity = core_->uuid();
    head.held = lease.value_or(belief.lease);
    head.stop_generation = generation.value_or(belief.generation);
    head.sequence = ++belief.sequence;
    lease.reset();
    generation.reset();
    return head;
}

Header CoreRig::headOf(const std::string& client, const proto::ToEntity& message) {
    auto head = headOf(client);
    if (const auto* right = rightOf(message.body_case())) head.msg_type = right->msg_type;
    return head;
}

void CoreRig::send(const std::string& client, const proto::ToEntity& message) {
    core_->onClientMsg(headOf(client, message), message.SerializeAsString());
}

void CoreRig::take(const std::string& client, const std::string& request, const std::string& root) {
    proto::ToEntity message;
    message.mutable_check_out()->set_root(root);
    message.mutable_check_out()->set_phase(proto::TAKE);
    message.mutable_check_out()->set_request_id(idOf(request));
    send(client, message);
}

void CoreRig::resumeLease(const std::string& client, const std::string& request, const std::string& of) {
    const auto& belief = clients[of];
    proto::ToEntity message;
    message.mutable_check_out()->set_phase(proto::RESUME_LEASE);
    message.mutable_check_out()->set_request_id(idOf(request));
    auto& resumed = *message.mutable_check_out()->mutable_resume();
    resumed.set_epoch(static_cast<std::uint32_t>(belief.lease.epoch));
    resumed.set_number(static_cast<std::uint32_t>(belief.lease.number));
    resumed.set_key(belief.key);
    send(client, message);
}

void CoreRig::task(const std::string& client, const std::string& id, const std::string& service,
                   const std::vector<std::string>& params, double not_after_s) {
    proto::ToEntity message;
    auto& task = *message.mutable_task();
    task.set_task_id(idOf(id));
    task.set_service(service);
    task.set_not_after_s(not_after_s);
    for (const auto& param : params) *task.add_params() = paramOf(param);
    send(client, message);
}

void CoreRig::setParam(const std::string& client, const std::string& request, const std::string& service,
                       const std::string& param) {
    proto::ToEntity message;
    message.mutable_set_param()->set_service(service);
    *message.mutable_set_param()->mutable_param() = paramOf(param);
    message.mutable_set_param()->set_request_id(idOf(request));
    send(client, message);
}

void CoreRig::stop(const std::string& client, StopCause cause, std::int64_t sequence) {
    auto head = headOf(client);
    if (sequence != 0) head.sequence = sequence;
    if (cause == StopCause::ClientLost && stop_generations.sparesClientLoss()) {
        core_->onClientUpdate(head, ClientChange::Lost);
        return;
    }
    const bool drill = cause == StopCause::Drill;
    const auto raised = drill ? stop_generations.drill(head.sender.id, head.sequence)
                              : stop_generations.raise(head.sender.id, head.sequence);
    if (!raised) {
        note("stop: seen before");
        return;
    }
    stop(*raised, cause);
    if (drill) return core_->onDrill(head, *raised);
    core_->onStopSignal(head, cause, *raised);
}

void CoreRig::reset(const std::string& client) {
    core_->onResetSignal(headOf(client));
}

void CoreRig::clear(const std::string& client) {
    core_->onClearSignal(headOf(client));
}

void CoreRig::rearm(const std::string& client, const std::string& request) {
    proto::ToEntity message;
    message.mutable_rearm()->set_request_id(idOf(request));
    send(client, message);
}

void CoreRig::makeIdle() {
    linkUp();
    uploadProfiles();
    core_->onServerUp();
}

void CoreRig::advance(Duration by, bool server_beats) {
    const auto end = clock.now() + by;
    constexpr Duration kBeat = std::chrono::milliseconds{50};
    // One row of beats over many short calls: else a server that lives would fall silent.
    if (!server_beats) {
        beat_ = {};
    } else if (beat_ < clock.now()) {
        beat_ = clock.now() + kBeat;
    }
    while (true) {
        auto next = std::min(end, std::max(core_->nextDeadline(), clock.now()));
        if (server_beats) next = std::min(next, beat_);
        const bool stuck = next == clock.now() && next == core_->nextDeadline();
        clock.set(next);
        if (server_beats && next >= beat_) {
            core_->onServerHeartbeat();
            beat_ += kBeat;
        }
        if (core_->nextDeadline() <= clock.now()) core_->onTimer();
        if (clock.now() >= end) return;
        if (stuck && core_->nextDeadline() <= clock.now()) {
            note("a deadline that onTimer does not clear");
            return;
        }
    }
}

std::vector<std::string> CoreRig::takeLines() {
    return std::exchange(lines_, {});
}

namespace {

std::string shown(const proto::Refusal& refusal) {
    if (refusal.code() == proto::OK && refusal.message().empty()) return "OK";
    return proto::RefusalCode_Name(refusal.code()) +
           (refusal.message().empty() ? "" : " \"" + refusal.message() + '"') +
           (refusal.holder().empty() ? "" : " holder=" + refusal.holder());
}

std::string shown(const proto::Value& value) {
    char number[32];
    switch (value.kind_case()) {
        case proto::Value::kInt:
            return std::to_string(value.int_());
        case proto::Value::kDbl:
            std::snprintf(number, sizeof number, "%g", value.dbl());
            return number;
        case proto::Value::kStr:
            return '"' + value.str() + '"';
        case proto::Value::kBool:
            return value.bool_() ? "true" : "false";
        case proto::Value::KIND_NOT_SET:
            break;
    }
    return "?";
}

std::string shown(const proto::Param& param) {
    std::string text = param.name() + '=';
    for (int i = 0; i < param.values_size(); ++i) text += (i == 0 ? "" : ",") + shown(param.values(i));
    return text;
}

std::string shown(LeaseNumber lease) {
    return std::to_string(lease.epoch) + '/' + std::to_string(lease.number);
}

std::string shown(const proto::Service& service) {
    std::string text =
        service.name() + (service.is_active() ? "" : " inactive") + (service.is_exec() ? " executing" : "");
    for (const auto& param : service.params()) {
        if (!param.ready()) continue;
        text += ' ' + param.name() + '=';
        for (int i = 0; i < param.initial_size(); ++i) text += (i == 0 ? "" : ",") + shown(param.initial(i));
    }
    for (const auto& resource : service.resources())
        if (resource.ready()) text += ' ' + resource.name() + "@" + resource.url();
    for (int i = 0; i < service.missing_size(); ++i)
        text += (i == 0 ? " missing " : ", ") + service.missing(i);
    return text;
}

std::string shown(const proto::ToClient& message) {
    switch (message.body_case()) {
        case proto::ToClient::kCheckOut: {
            const auto& reply = message.check_out();
            std::string text = "CheckOutReply " + nameOf(reply.request_id()) + ' ' +
                               proto::CheckOutPhase_Name(reply.phase()) + ' ' +
                               (reply.has_refusal() ? shown(reply.refusal()) : "OK");
            if (reply.has_lease())
                text += " lease=" + std::to_string(reply.lease().epoch()) + '/' +
                        std::to_string(reply.lease().number()) +
                        " key=" + std::to_string(reply.lease().key().size()) +
                        "bytes services=" + std::to_string(reply.services().services_size()) +
                        (reply.lease().root().empty() ? "" : " root=" + nameOf(reply.lease().root()));
            if (reply.place() != 0) text += " place=" + std::to_string(reply.place());
            return text + " gen=" + std::to_string(reply.stop_generation()) +
                   (reply.latched() ? " latched" : "");
        }
        case proto::ToClient::kLeaseEnded:
            return "LeaseEnded " + std::to_string(message.lease_ended().lease().epoch()) + '/' +
                   std::to_string(message.lease_ended().lease().number()) + ' ' +
                   shown(message.lease_ended().reason());
        case proto::ToClient::kReply:
            return "Reply " + nameOf(message.reply().request_id()) + ' ' + shown(message.reply().refusal());
        case proto::ToClient::kTask: {
            const auto& task = message.task();
            std::string text = "TaskEvent " + nameOf(task.task_id()) + ' ' + task.service() + ' ' +
                               proto::TaskState_Name(task.state());
            char progress[32];
            std::snprintf(progress, sizeof progress, " %g%%", task.progress() * 100);
            if (task.progress() >= 0) text += progress;
            if (!task.feedback().empty()) text += " feedback=\"" + task.feedback() + '"';
            for (const auto& result : task.results()) text += ' ' + shown(result);
            return text + (task.has_reason() ? ' ' + shown(task.reason()) : "");
        }
        case proto::ToClient::kStatus: {
            const auto& status = message.status();
            std::string text = "EntityStatus " + nameOf(status.request_id()) + ' ' +
                               proto::EntityState_Name(status.state()) +
                               (status.latched() ? " latched" : "") +
                               " gen=" + std::to_string(status.stop_generation());
            if (!status.holder().empty()) text += " holder=" + status.holder();
            if (status.orphaned()) text += " orphaned";
            if (status.waiting() != 0) text += " waiting=" + std::to_string(status.waiting());
            for (const auto& task : status.tasks())
                text += ' ' + nameOf(task.task_id()) + '=' + proto::TaskState_Name(task.state());
            for (const auto& task : status.ended())
                text += " ended " + nameOf(task.task_id()) + '=' + proto::TaskState_Name(task.state());
            for (const auto& service : status.services()) text += " {" + shown(service) + '}';
            return text;
        }
        case proto::ToClient::kReceipt: {
            const auto& receipt = message.receipt();
            return "StopReceipt " + receipt.stop_id() + ' ' +
                   proto::StopReceipt::Stage_Name(receipt.stage()) +
                   " gen=" + std::to_string(receipt.stop_generation()) + ' ' +
                   proto::StopCause_Name(receipt.cause()) + " by=" + receipt.by() +
                   " state=" + proto::EntityState_Name(receipt.state()) +
                   (receipt.absence() > proto::StopReceipt::NONE
                        ? ' ' + proto::StopReceipt::Absence_Name(receipt.absence()) + " \"" +
                              receipt.absence_reason() + '"'
                        : "") +
                   (receipt.standstill_follows() ? " standstill follows" : "") +
                   (receipt.tasks_ended() > 0 ? " ended=" + std::to_string(receipt.tasks_ended()) : "") +
                   (receipt.tasks_removed() > 0 ? " removed=" + std::to_string(receipt.tasks_removed()) : "");
        }
        case proto::ToClient::kResourceCredit:
            return "ResourceCredit " + nameOf(message.resource_credit().transfer_id()) +
                   " offset=" + std::to_string(message.resource_credit().offset()) +
                   " window=" + std::to_string(message.resource_credit().window());
        case proto::ToClient::kResourceDone:
            return "ResourceDone " + nameOf(message.resource_done().transfer_id()) + ' ' +
                   message.resource_done().resource() + ' ' + shown(message.resource_done().refusal());
        case proto::ToClient::kText:
            return "Text \"" + message.text().text() + '"';
        case proto::ToClient::kRaw:
            return "Raw " + std::to_string(message.raw().data_size()) + " items";
        case proto::ToClient::kSample:
            return "StreamSample " + message.sample().stream() + " #" +
                   std::to_string(message.sample().sequence());
        case proto::ToClient::kService:
            return "Service " + shown(message.service());
        case proto::ToClient::kHandOver: {
            const auto& question = message.hand_over();
            char within[32];
            std::snprintf(within, sizeof within, " within %g s", question.answer_within_s());
            return "HandOverRequest " + nameOf(question.request_id()) + " by=" + question.by() +
                   (question.reason().empty() ? "" : " \"" + question.reason() + '"') + within +
                   (question.yield() ? " yield" : "") + (question.withdrawn() ? " withdrawn" : "");
        }
        case proto::ToClient::kRun:
        case proto::ToClient::kRunHistory:
        case proto::ToClient::kGlobalServices:
            return message.ShortDebugString();
        case proto::ToClient::kWay:  // of the path below the core
        case proto::ToClient::BODY_NOT_SET:
            break;
    }
    return "nothing";
}

std::string shown(const proto::EmToEi& message, const CoreRig& rig) {
    switch (message.body_case()) {
        case proto::EmToEi::kParam:
            return "ParamRequest #" + std::to_string(message.param().request()) + ' ' +
                   message.param().service() + ' ' + shown(message.param().param());
        case proto::EmToEi::kResource:
            return "ResourceRequest #" + std::to_string(message.resource().request()) + ' ' +
                   message.resource().service() + '/' + message.resource().resource() + ' ' +
                   message.resource().path() + " size=" + std::to_string(message.resource().size());
        case proto::EmToEi::kTask: {
            std::string text = "TaskDispatch " + rig.nameOfSent(message.task().task_id()) + ' ' +
                               message.task().service() +
                               " gen=" + std::to_string(message.task().stop_generation());
            for (const auto& param : message.task().params()) text += ' ' + shown(param);
            for (const auto& resource : message.task().resources())
                text += ' ' + resource.name() + '@' + resource.url();
            return text;
        }
        case proto::EmToEi::kConfiguration: {
            std::string text = "Configuration";
            for (const auto& one : message.configuration().params())
                text += ' ' + one.service() + '.' + shown(one.param());
            if (!message.configuration().task_id().empty())
                text += " for " + rig.nameOfSent(message.configuration().task_id());
            return text;
        }
        case proto::EmToEi::kCancel:
            return "CancelTask " + rig.nameOfSent(message.cancel().task_id());
        case proto::EmToEi::kPause:
            return (message.pause().resume() ? "PauseTask resume " : "PauseTask ") +
                   rig.nameOfSent(message.pause().task_id());
        case proto::EmToEi::kText:
            return "LinkText \"" + message.text().text() + "\" from " + message.text().from();
        case proto::EmToEi::kRaw:
            return "LinkRaw " + std::to_string(message.raw().data_size()) + " items from " +
                   message.raw().from();
        case proto::EmToEi::kStream:
            return "StreamControl \"" + message.stream().stream() + "\" " +
                   (message.stream().on() ? "on" : "off");
        case proto::EmToEi::kNotSent:
            return "NotSent to " + message.not_sent().to() + ' ' + shown(message.not_sent().reason());
        case proto::EmToEi::kProfileError:
            return "profile_error " + shown(message.profile_error());
        default:
            return "unexpected message";
    }
}

}  // namespace

bool CoreRig::send(const proto::EmToEi& message) {
    if (message.ByteSizeLong() > frame_max) return false;
    // Which task it is of stands in the journal, always.
    if (message.has_task() &&
        (journal.records.empty() || journal.records.back().task.bytes() != message.task().task_id()))
        parts_.push_back(message.task().task_id());
    note("application: " + shown(message, *this));
    to_application.push_back(message);
    if (on_application) on_application(message);
    return true;
}

void CoreRig::stop(std::uint32_t raised, StopCause cause) {
    if (cause == StopCause::Drill) return note("application: DRILL " + std::to_string(raised));
    note("application: STOP gen=" + std::to_string(raised) + " (" + toString(cause) + ')');
    stops.emplace_back(raised, cause);
}

void CoreRig::setBusy(bool now) {
    note(std::string("application: watchdog ") + (now ? "busy" : "idle"));
    busy = now;
}

void CoreRig::wantConnection(bool now) {
    note(std::string("server: ") + (now ? "wanted" : "not wanted"));
    wanted = now;
}

void CoreRig::sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) {
    if (profile.ByteSizeLong() == 0) return note("server: not ready " + registration.name);
    char position[96];
    std::snprintf(position, sizeof position, "(%g, %g, %g)", profile.xpos(), profile.ypos(), profile.zpos());
    note("server: profile " + registration.name + ' ' + registration.category + '/' + registration.type +
         ' ' + position);
}

void CoreRig::sendStatus(const EntityStatus& status) {
    std::string line = std::string("server: status ") + toString(status.state) +
                       (status.latched ? " latched" : "") + " gen=" + std::to_string(status.stop_generation);
    if (!status.holder.id.empty()) line += " holder=" + status.holder.id + " lease=" + shown(status.held);
    if (status.orphaned) line += " orphaned";
    if (status.waiting != 0) line += " waiting=" + std::to_string(status.waiting);
    if (status.state != EntityState::IDLE && !status.reason.empty())
        line += " \"" + status.reason.substr(0, status.reason.find('\n')) + '"';
    note(std::move(line));
    statuses.push_back(status);
    for (auto& [name, belief] : clients)
        belief.generation = std::max(belief.generation, status.stop_generation);
}

void CoreRig::sendToClient(Lane lane, const Header& head, const proto::ToClient& message) {
    note(head.sender.id + (lane == Lane::Signal ? " (signal): " : ": ") + shown(message));
    to_clients.push_back({lane, head, message, false});
    if (on_client) on_client(to_clients.back());
    auto& belief = clients[head.sender.id];
    belief.generation = std::max(belief.generation, head.stop_generation);
    if (message.has_check_out() && message.check_out().has_lease()) {
        belief.key = message.check_out().lease().key();
        belief.lease = {static_cast<std::int32_t>(message.check_out().lease().epoch()),
                        static_cast<std::int32_t>(message.check_out().lease().number())};
    }
}

void CoreRig::sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) {
    note("to a peer: " + message.ShortDebugString());
    if (on_peer) on_peer(lane, head, message);
}

void CoreRig::sendToClientDataSeq(const Header& head, const proto::ToClient& message) {
    note(head.sender.id + " (data): " + shown(message));
    to_clients.push_back({Lane::Data, head, message, true});
}

}  // namespace axon::test
