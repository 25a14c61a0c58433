// SPDX-License-Identifier: GPL-2.0-or-later
#include "operator.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "board.hpp"
#include "client/axon/client.hpp"
#include "robots.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;
using namespace axon::client;

class Operator {
  public:
    Operator(const std::string& board_file, std::size_t entities, std::string server)
        : board_(board_file, entities, false), server_(std::move(server)) {
        for (std::size_t i = 0; i < entities; ++i) names_.push_back(robotName(i));
    }

    int run() {
        const auto parent = ::getppid();
        auto& desk = board_.desk();
        while (::getppid() == parent) {
            const auto order = desk.prepare.load();
            if (order == desk.prepared) {
                std::this_thread::sleep_for(1ms);
                continue;
            }
            if (prepare())
                desk.prepared = order;
            else
                std::this_thread::sleep_for(10ms);
        }
        ::_exit(0);
    }

  private:
    /// Of the robots that are to move.
    std::vector<std::string> names() {
        return {names_.begin(), names_.begin() + static_cast<std::ptrdiff_t>(board_.movers())};
    }

    void say(const std::string& words) {
        if (words == said_) return;
        said_ = words;
        std::fprintf(stderr, "%.3f %s\n", static_cast<double>(nowNs()) / 1e9, words.c_str());
    }
    bool no(const Refusal& refusal) {
        say(std::string(refusalName(refusal.code)) + ": " + refusal.message);
        return false;
    }

    bool connect() {
        if (client_ && client_->connected()) return true;
        if (client_) return false;  // it connects again by itself
        Options options;
        options.server = server_;
        options.timeout = 2s;
        options.keep_running = [&desk = board_.desk()] {
            while (desk.wedged == 2) std::this_thread::sleep_for(5ms);
            return desk.wedged == 0;
        };
        auto connected = Client::connect(options);
        if (!connected) return no(connected.refusal());
        client_ = std::move(connected).value();
        client_->onEntity([this](Presence presence, const Entity& entity) { told(presence, entity); });
        for (const auto& entity : client_->entities()) told(Presence::Joined, entity);
        return true;
    }

    void told(Presence presence, const Entity& entity) {
        for (std::size_t i = 0; i < names_.size(); ++i) {
            if (names_[i] != entity.name) continue;
            const bool gone = presence == Presence::Left || entity.state == EntityState::UNAV;
            if (!gone)
                board_[i].gone_at = 0;
            else if (board_[i].gone_at == 0)
                board_[i].gone_at = nowNs();
        }
    }

    bool prepare() {
        if (!connect()) return false;
        const auto movers = names();
        std::map<std::string, CheckOut> held;
        for (auto& one : client_->held()) held.emplace(one.entity().name, one);
        std::vector<std::string> missing;
        for (const auto& name : movers) {
            const auto entity = client_->find(name);
            if (!entity) return no(entity.refusal());
            if (entity->state < EntityState::IDLE || entity->state == EntityState::ERR) {
                say(name + " is " + toString(entity->state));
                return false;
            }
            if (!held.contains(name)) missing.push_back(name);
        }
        if (!missing.empty()) {
            auto granted = client_->checkOut(missing);
            if (!granted) return no(granted.refusal());
            for (auto& one : granted.value()) held.emplace(one.entity().name, one);
        }
        if (board_.desk().together != 0) return together();
        bool all = true;
        for (const auto& name : movers) {
            if (const auto task = tasks_.find(name); task != tasks_.end()) {
                const auto report = task->second.report();
                if (report.state == TaskState::Running) continue;
                if (!isFinal(report.state)) {
                    all = false;
                    continue;
                }
                if (report.state == TaskState::Refused) no(report.reason);
                tasks_.erase(task);
            }
            all = false;
            if (const auto entity = client_->find(name); entity && entity->latched)
                if (const auto armed = client_->rearm(name); !armed) {
                    no(armed.refusal());
                    continue;
                }
            tasks_.emplace(name, held.at(name).run("Drive"));
        }
        return all;
    }

    /// All that is held drives in one run, each time under another master.
    bool together() {
        if (run_) {
            const auto report = run_->report();
            if (!isFinal(report.state))
                return report.state == RunState::Running &&
                       std::all_of(report.steps.begin(), report.steps.end(), [](const StepReport& step) {
                           return step.state == client::TaskState::Running;
                       });
            if (!report.reason.ok()) no(report.reason);
            run_.reset();
        }
        for (const auto& name : names_)
            if (const auto entity = client_->find(name); entity && entity->latched)
                if (const auto armed = client_->rearm(name); !armed) return no(armed.refusal());
        GlobalService service;
        service.name = "Drive together";
        Bindings bindings;
        for (std::size_t i = 0; i < names_.size(); ++i) {
            GlobalStep step;
            step.role = static_cast<int>(i);
            step.category = "ROBOT";
            step.type = "MOBILE";
            step.service_global_id = "Drive";
            service.steps.push_back(std::move(step));
            bindings[static_cast<int>(i)] = names_[i];
        }
        auto& desk = board_.desk();
        desk.master = desk.together == 2 ? 0 : static_cast<std::uint32_t>(++launches_ % names_.size());
        auto run = client_->runGlobal(service, bindings, names_[desk.master]);
        if (!run) return no(run.refusal());
        run_ = std::move(run).value();
        return false;
    }

    Board board_;
    const std::string server_;
    std::vector<std::string> names_;
    std::unique_ptr<Client> client_;
    std::map<std::string, client::Task> tasks_;
    std::optional<client::Run> run_;
    std::size_t launches_ = 0;
    std::string said_;
};

}  // namespace

int runOperator(const std::string& board_file, std::size_t entities, const std::string& server) {
    return Operator(board_file, entities, server).run();
}

}  // namespace axon::faults
