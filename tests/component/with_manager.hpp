// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <gtest/gtest.h>

#include <asio/thread_pool.hpp>
#include <axon/client.hpp>
#include <memory>
#include <string>
#include <utility>

#include "component/any_ports.hpp"
#include "component/memory_robot.hpp"
#include "entity_manager/entity_manager.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "server/server.hpp"
#include "transport/ice/endpoint.hpp"

namespace axon::test {

/// Both servers, a real Entity Manager and the client library in one process, over loopback. A test starts
/// what it needs: startServer(), then createManager() and manager_->start(), and connected() for a client.
/// Whatever else calls the Entity Manager ends before TearDown() of this does, and what the Entity Manager
/// uses outlives it.
class WithManager : public ::testing::Test {
  protected:
    void startServer(server::ServerSettings settings = onLoopback()) {
        server_ = std::make_unique<server::Server>(std::move(settings));
        const auto at = transport::parseEndpoint(server_->entityAddress(Lane::Data));
        entity_server_ = {at.host, at.port, "", ""};
        entity_server_.tls = at.tls;
    }
    /// At the newest server, whether it still runs or not. Says nothing before manager_->start().
    void createManager(entity_manager::EntityManagerCoreSettings core,
                       const EntityManager::BackEndFactory& application, entity_manager::Storage& storage,
                       entity_manager::ResourceStore& resources, entity_manager::Journal* journal = nullptr) {
        manager_ = EntityManager::create(executor_.get_executor(), ice_, std::move(core), entity_server_,
                                         application, clock_, random_, storage, resources, journal);
    }
    /// With what it keeps in memory.
    void createManager(entity_manager::EntityManagerCoreSettings core,
                       const EntityManager::BackEndFactory& application) {
        createManager(std::move(core), application, storage_, storage_);
    }
    /// The application "peoplebot", a MemoryRobot: robot_.
    void createManagerOfMemoryRobot(entity_manager::EntityManagerCoreSettings core = {}) {
        core.application = "peoplebot";
        createManager(std::move(core), [this](const EntityManager::Strand& strand,
                                              const entity_manager::StopGenerations&, const Clock&,
                                              BackEndEvents& events) {
            auto robot = std::make_unique<MemoryRobot>(strand, events, seen_);
            robot_ = robot.get();
            return EntityManager::BackEnd{std::move(robot), [its = robot_] { its->start(); }, [] {}};
        });
    }
    /// Null where that fails, which fails the test.
    std::unique_ptr<client::Client> connected(client::Options options = {}) const {
        options.server = server_->clientAddress(Lane::Data);
        auto connection = client::Client::connect(options);
        if (connection) return std::move(connection).value();
        ADD_FAILURE() << connection.refusal().message;
        return nullptr;
    }
    void TearDown() override {
        client_.reset();
        if (manager_) manager_->stop();
        ice_->destroy();  // its threads post to the executor
        executor_.join();
        manager_.reset();
    }

    SteadyClock clock_;
    SystemRandom random_;
    MemoryStore storage_;
    MemoryRobot::Seen seen_;
    MemoryRobot* robot_ = nullptr;  // the manager's
    std::unique_ptr<server::Server> server_;
    entity_manager::ServerAddress entity_server_;
    asio::thread_pool executor_{1};
    std::shared_ptr<entity_manager::ServerCommunicators> ice_ =  // a test may choose others, at first
        std::make_shared<entity_manager::ServerCommunicators>(1, 1);
    std::shared_ptr<EntityManager> manager_;
    std::unique_ptr<client::Client> client_;
};

}  // namespace axon::test
