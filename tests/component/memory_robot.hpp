// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>

#include <asio/post.hpp>
#include <atomic>
#include <future>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "entity_manager/entity_manager.hpp"

// What a real Entity Manager needs beside it, in memory.
namespace axon::test {

using entity_manager::BackEndEvents;
using entity_manager::EntityManager;

class MemoryStore final : public entity_manager::Storage, public entity_manager::ResourceStore {
  public:
    std::optional<std::string> load(std::string_view key) override {
        const auto found = values_.find(std::string(key));
        return found == values_.end() ? std::nullopt : std::optional(found->second);
    }
    void save(std::string_view key, std::string_view value) override { values_[std::string(key)] = value; }
    void forget(std::string_view key) override { values_.erase(std::string(key)); }
    entity_manager::Later<Result<std::uint64_t>> begin(const proto::ResourceOffer&,
                                                       const std::string&) override {
        return Result<std::uint64_t>(0);
    }
    Result<void> write(std::string_view, std::uint64_t, std::string_view) override { return {}; }
    entity_manager::Later<Result<std::string>> check(std::string_view) override {
        return Result<std::string>("");
    }
    entity_manager::Later<Result<std::string>> place(std::string_view) override {
        return Result<std::string>("");
    }
    void suspend(std::string_view) override {}
    void drop(std::string_view) override {}
    void remove(std::string_view, std::string_view) override {}
    std::optional<std::string> find(std::string_view, std::string_view) override { return std::nullopt; }

  private:
    std::map<std::string, std::string> values_;
};

/// The link to a robot application in memory, "PeopleBot" with the service "Drive": stands still at once,
/// lets tasks run until they are stopped, and keeps what it is told.
class MemoryRobot final : public entity_manager::BackEndPort {
  public:
    struct Seen {
        std::mutex mutex;
        std::vector<std::string> texts;  // guarded by mutex
        std::string task;                // guarded by mutex: that runs
        std::atomic<int> stops{0}, tasks{0};
        std::atomic<bool> rolls{false};  // comes to rest after its stop callback has returned
        std::size_t count() {
            const std::lock_guard lock(mutex);
            return texts.size();
        }
    };
    MemoryRobot(EntityManager::Strand strand, BackEndEvents& events, Seen& seen)
        : strand_(std::move(strand)), events_(events), seen_(seen) {}
    void start() {
        events_.onLinkUp();
        profile(false, R"(<BasicProfile name="PeopleBot" category="ROBOT" type="MOBILE" descr="a robot"/>)");
        profile(
            true,
            R"(<ServiceProfile count="1"><Service name="Drive" global_id="drive" type="SMPL"/></ServiceProfile>)");
    }
    bool send(const proto::EmToEi& message) override {
        if (message.has_text()) {
            const std::lock_guard lock(seen_.mutex);
            seen_.texts.push_back(message.text().text());
        } else if (message.has_task()) {
            ++seen_.tasks;
            {
                const std::lock_guard lock(seen_.mutex);
                seen_.task = message.task().task_id();
            }
            proto::EiToEm granted;
            granted.mutable_task_answer()->set_task_id(message.task().task_id());
            answer(std::move(granted));
        }
        return true;
    }
    void stop(std::uint32_t generation, StopCause cause) override {
        if (cause == StopCause::Requested) ++seen_.stops;
        proto::EiToEm done;
        if (cause == StopCause::Drill) {
            done.mutable_stop_done()->set_drill(generation);
            return answer(std::move(done));
        }
        done.mutable_stop_done()->set_stop_generation(generation);
        done.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
        done.mutable_stop_done()->set_standstill_follows(seen_.rolls);
        answer(done);
        if (seen_.rolls) {
            done.mutable_stop_done()->set_stage(proto::StopReceipt::STANDSTILL);
            answer(std::move(done));
        }
        proto::EiToEm ended;
        {
            const std::lock_guard lock(seen_.mutex);
            ended.mutable_task()->mutable_event()->set_task_id(std::exchange(seen_.task, {}));
        }
        ended.mutable_task()->mutable_event()->set_state(proto::TASK_STOPPED);
        if (!ended.task().event().task_id().empty()) answer(std::move(ended));
    }
    void setBusy(bool) override {}
    /// Nothing more is under way from here to the Entity Manager: before that goes, and the executor does
    /// not.
    void awaitQuiet() {
        std::promise<void> quiet;
        asio::post(strand_, [&] { quiet.set_value(); });
        quiet.get_future().wait();
    }
    void text(std::string text) {
        proto::EiToEm message;
        message.mutable_text()->set_text(std::move(text));
        answer(std::move(message));
    }

  private:
    void answer(proto::EiToEm message) {
        asio::post(strand_, [this, message = std::move(message)] { events_.onLinkMessage(message); });
    }
    void profile(bool services, const std::string& xml) {
        proto::EiToEm message;
        message.mutable_profile()->set_services(services);
        message.mutable_profile()->set_file_name("profile.xml");
        message.mutable_profile()->set_xml(xml);
        events_.onLinkMessage(message);
    }
    EntityManager::Strand strand_;
    BackEndEvents& events_;
    Seen& seen_;
};

}  // namespace axon::test
