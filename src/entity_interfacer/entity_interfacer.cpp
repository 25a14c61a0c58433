// SPDX-License-Identifier: MIT
#include "entity_interfacer/axon/entity_interfacer.hpp"

#include <axon/link.pb.h>

#include "common/clock.hpp"
#include "common/utf8.hpp"
#include "entity_interfacer/communicator.hpp"

namespace axon {

const char* toString(StopSignal::Cause cause) {
    using Cause = StopSignal::Cause;
    switch (cause) {
        case Cause::Unspecified:
            return "stop";
        case Cause::Requested:
            return "stop requested";
        case Cause::ClientLost:
            return "the holding client is lost";
        case Cause::Released:
            return "released";
        case Cause::Improper:
            return "the client misbehaved";
        case Cause::ServerLost:
            return "the server is lost";
        case Cause::LinkLost:
            return "the link to the Entity Manager is lost";
        case Cause::Reset:
            return "reset";
        case Cause::Clear:
            return "clear";
        case Cause::Cancel:
            return "cancelled";
        case Cause::Shutdown:
            return "the robot application or its Entity Manager shuts down";
        case Cause::Fault:
            return "an exception left a callback";
    }
    return "stop";
}

namespace {

void sendSample(Stream::Channel& channel, proto::EiToEm& message, std::uint64_t sequence) {
    auto& sample = *message.mutable_sample();
    sample.set_stream(channel.name);
    sample.set_sequence(sequence);
    sample.set_taken_at_us(toMicroseconds(channel.communicator.now()));
    if (!channel.communicator.send(message, Link::Kind::Droppable))
        channel.communicator.log(
            LogLevel::Error,
            "stream '" + channel.name + "': a sample exceeds 1 MiB and was dropped; fix: send smaller ones");
}

/// Counts the sample even where nobody wants it; fills in and sends it otherwise.
template <class Fill>
void sample(Stream::Channel& channel, Fill fill) {
    const auto sequence = ++channel.sequence;
    if (!channel.wanted || !channel.communicator.linked()) return;
    proto::EiToEm message;
    fill(*message.mutable_sample());
    sendSample(channel, message, sequence);
}

}  // namespace

void Stream::send(double value, std::string_view units) {
    sample(*channel_, [&](proto::StreamSample& out) {
        out.mutable_scalar()->set_value(value);
        out.mutable_scalar()->set_units(validUtf8(units));
    });
}
void Stream::send(const std::vector<double>& values, std::string_view units) {
    sample(*channel_, [&](proto::StreamSample& out) {
        out.mutable_vector()->mutable_values()->Add(values.begin(), values.end());
        out.mutable_vector()->set_units(validUtf8(units));
    });
}
void Stream::send(const Pose& pose) {
    sample(*channel_, [&](proto::StreamSample& out) {
        auto& p = *out.mutable_pose();
        p.set_x(pose.x), p.set_y(pose.y), p.set_z(pose.z);
        p.set_roll(pose.roll), p.set_pitch(pose.pitch), p.set_yaw(pose.yaw);
        p.set_frame(validUtf8(pose.frame));
    });
}
void Stream::send(const Scan& scan) {
    sample(*channel_, [&](proto::StreamSample& out) {
        auto& s = *out.mutable_scan();
        s.set_start_angle(scan.start_angle), s.set_step(scan.step), s.set_max_range(scan.max_range);
        s.mutable_ranges()->Add(scan.ranges.begin(), scan.ranges.end());
        s.mutable_angles()->Add(scan.angles.begin(), scan.angles.end());
    });
}
void Stream::send(const Image& image) {
    sample(*channel_, [&](proto::StreamSample& out) {
        auto& i = *out.mutable_image();
        i.set_width(image.width), i.set_height(image.height);
        i.set_encoding(validUtf8(image.encoding));
        i.set_pixels(image.pixels);
    });
}
void Stream::sendBytes(std::string_view bytes) {
    sample(*channel_, [&](proto::StreamSample& out) { out.set_raw(std::string(bytes)); });
}
bool Stream::wanted() const {
    return channel_->wanted && channel_->communicator.linked();
}

EntityInterfacer::EntityInterfacer(Options options)
    : communicator_(std::make_unique<Communicator>(std::move(options))) {}
EntityInterfacer::~EntityInterfacer() = default;

void EntityInterfacer::uploadBasicProfile(const std::filesystem::path& file) {
    communicator_->upload(false, file);
}
void EntityInterfacer::uploadServiceProfile(const std::filesystem::path& file) {
    communicator_->upload(true, file);
}

void EntityInterfacer::onParameter(std::function<Decision(const std::string&, const Parameter&)> callback) {
    communicator_->settableCallbacks().parameter = std::move(callback);
}
void EntityInterfacer::onConfig(std::function<void(const std::string&, const Parameter&)> callback) {
    communicator_->settableCallbacks().config = std::move(callback);
}
void EntityInterfacer::onResource(
    std::function<Decision(const std::string&, const std::string&, const std::filesystem::path&)> callback) {
    communicator_->settableCallbacks().resource = std::move(callback);
}
void EntityInterfacer::onTaskRequest(std::function<Decision(const Task&)> callback) {
    communicator_->settableCallbacks().task_request = std::move(callback);
}
void EntityInterfacer::onTask(std::string service, TaskHandler handler) {
    communicator_->settableCallbacks().tasks[std::move(service)] = std::move(handler);
}
void EntityInterfacer::onAnyTask(TaskHandler handler) {
    communicator_->settableCallbacks().any_task = std::move(handler);
}
void EntityInterfacer::onPause(std::function<void(const Task&)> callback) {
    communicator_->settableCallbacks().pause = std::move(callback);
}
void EntityInterfacer::onResume(std::function<void(const Task&)> callback) {
    communicator_->settableCallbacks().resume = std::move(callback);
}
void EntityInterfacer::onText(std::function<void(const std::string&, const std::string&)> callback) {
    communicator_->settableCallbacks().text = std::move(callback);
}
void EntityInterfacer::onRaw(
    std::function<void(const std::vector<std::string>&, const std::string&)> callback) {
    communicator_->settableCallbacks().raw = std::move(callback);
}
void EntityInterfacer::onNotSent(std::function<void(const std::string&, const std::string&)> callback) {
    communicator_->settableCallbacks().not_sent = std::move(callback);
}
void EntityInterfacer::onStop(std::function<void(const StopSignal&)> callback) {
    communicator_->settableCallbacks().stop = std::move(callback);
}
void EntityInterfacer::onLinkUp(std::function<void()> callback) {
    communicator_->settableCallbacks().link_up = std::move(callback);
}
void EntityInterfacer::onLinkDown(std::function<void(const std::string&)> callback) {
    communicator_->settableCallbacks().link_down = std::move(callback);
}
void EntityInterfacer::standstill() {
    communicator_->standstill();
}

void EntityInterfacer::setStatus(bool busy, std::string_view text) {
    proto::EiToEm message;
    message.mutable_status()->set_busy(busy);
    message.mutable_status()->set_text(validUtf8(text));
    communicator_->send(message, Link::Kind::Control);
}
void EntityInterfacer::sendInfoMsg(std::string_view text) {
    proto::EiToEm message;
    message.mutable_text()->set_text(validUtf8(text));
    if (!communicator_->send(message, Link::Kind::Control))
        communicator_->log(LogLevel::Error,
                           "sendInfoMsg: the text exceeds 1 MiB and was dropped; fix: send it in parts");
}
void EntityInterfacer::sendTaskFeedback(const Task& task, std::string_view text) {
    Task(task).feedback(text);
}
void EntityInterfacer::sendTaskFeedback(std::string_view service, std::string_view text) {
    communicator_->sendTaskFeedback(service, text);
}
void EntityInterfacer::sendRaw(std::string_view bytes) {
    sendRaw(std::vector<std::string>{std::string(bytes)});
}
void EntityInterfacer::sendRaw(const std::vector<std::string>& blocks) {
    sendRawTo({}, blocks);
}
void EntityInterfacer::sendRawTo(std::string_view participant, const std::vector<std::string>& blocks) {
    proto::EiToEm message;
    message.mutable_raw()->set_to(std::string(participant));
    for (const auto& block : blocks) message.mutable_raw()->add_data(block);
    if (!communicator_->send(message, Link::Kind::Droppable))
        communicator_->log(
            LogLevel::Error,
            "sendRaw: the blocks exceed 1 MiB together and were dropped; fix: send them in parts");
}
void EntityInterfacer::setPosition(double x_mm, double y_mm, double z_mm) {
    communicator_->setPosition(x_mm, y_mm, z_mm);
}
void EntityInterfacer::setServiceActive(std::string_view service, bool active, std::string_view reason) {
    communicator_->setServiceActive(service, active, reason);
}
Stream EntityInterfacer::stream(std::string_view name) {
    return Stream(communicator_->channel(name));
}

void EntityInterfacer::start() {
    communicator_->start();
}
void EntityInterfacer::run() {
    communicator_->run();
}
void EntityInterfacer::quit() {
    communicator_->quit();
}
void EntityInterfacer::shutdown() {
    communicator_->shutdown();
}
bool EntityInterfacer::linked() const {
    return communicator_->linked();
}
std::uint16_t EntityInterfacer::port() const {
    return communicator_->port();
}

}  // namespace axon
