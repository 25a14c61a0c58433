// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/entity_manager_core.hpp"

#include <utility>

#include "entity_manager/machine.hpp"

namespace axon::entity_manager {

EntityManagerCore::EntityManagerCore(EntityManagerCoreSettings settings, const Clock& clock,
                                     RandomSource& random, BackEndPort& back_end, ServerPort& server,
                                     Storage& storage, ResourceStore& resources, StopCounter& stop_counter,
                                     Journal* journal)
    : machine_(std::make_unique<Machine>(std::move(settings), clock, random, back_end, server, storage,
                                         resources, stop_counter, journal)) {}

EntityManagerCore::~EntityManagerCore() = default;

void EntityManagerCore::start() {
    machine_->start();
}
void EntityManagerCore::onApplicationSought(const std::string& finding) {
    machine_->onApplicationSought(finding);
}
void EntityManagerCore::onLinkUp() {
    machine_->onLinkUp();
}
void EntityManagerCore::onLinkDown(const std::string& reason, LinkEnd end) {
    machine_->onLinkDown(reason, end);
}
void EntityManagerCore::onLinkMessage(const proto::EiToEm& message) {
    auto copy = message;
    machine_->onLinkMessage(copy);
}
void EntityManagerCore::onLinkMessage(proto::EiToEm&& message) {
    machine_->onLinkMessage(message);
}
void EntityManagerCore::onServerUp() {
    machine_->onServerUp();
}
void EntityManagerCore::onServerDown(const std::string& reason) {
    machine_->onServerDown(reason);
}
void EntityManagerCore::onClientMsg(const Header& head, std::string_view bytes) {
    machine_->onClientMsg(head, bytes);
}
void EntityManagerCore::onPeerRefusal(const Header& head, const Refusal& refusal) {
    machine_->onPeerRefusal(head, refusal);
}
void EntityManagerCore::onDrill(const Header& head, std::uint32_t number) {
    machine_->onDrill(head, number);
}
void EntityManagerCore::onStopSignal(const Header& head, StopCause cause, std::uint32_t generation) {
    machine_->onStopSignal(head, cause, generation);
}
void EntityManagerCore::onStopRepeated(const Header& head, StopCause cause, std::uint32_t generation) {
    machine_->onStopRepeated(head, cause, generation);
}
void EntityManagerCore::onResetSignal(const Header& head) {
    machine_->onSignal(Event::Reset, head);
}
void EntityManagerCore::onClearSignal(const Header& head) {
    machine_->onSignal(Event::Clear, head);
}
void EntityManagerCore::onClientUpdate(const Header& head, ClientChange change) {
    machine_->onClientUpdate(head, change);
}
void EntityManagerCore::onServerHeartbeat() {
    machine_->onServerHeartbeat();
}
void EntityManagerCore::onTimer() {
    machine_->onTimer();
}
void EntityManagerCore::onStored() {
    machine_->onStored();
}
TimePoint EntityManagerCore::nextDeadline() const {
    return machine_->nextDeadline();
}
void EntityManagerCore::offerDatagrams(std::string endpoint) {
    machine_->offerDatagrams(std::move(endpoint));
}
void EntityManagerCore::offerDirect(std::string data, std::string signal) {
    machine_->offerDirect(std::move(data), std::move(signal));
}
void EntityManagerCore::shutDown() {
    machine_->shutDown();
}
EntityState EntityManagerCore::state() const {
    return machine_->state();
}
bool EntityManagerCore::latched() const {
    return machine_->latched();
}
bool EntityManagerCore::serverUp() const {
    return machine_->connected();
}
const std::string& EntityManagerCore::uuid() const {
    return machine_->uuid();
}
const LeaseBook::Held* EntityManagerCore::held() const {
    return machine_->held();
}
EntityStatus EntityManagerCore::status() const {
    return machine_->status();
}
const CoreCounters& EntityManagerCore::counters() const {
    return machine_->counters();
}

std::string EntityManagerCore::takeWarning() {
    return machine_->takeWarning();
}

std::string EntityManagerCore::takeNews() {
    return machine_->takeNews();
}

}  // namespace axon::entity_manager
