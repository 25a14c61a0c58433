// SPDX-License-Identifier: GPL-2.0-or-later
// Random global services over random entities, with failures, denials, stops, cancels, pauses, cuts, lost
// signals and frozen masters: the order is kept, equal places run side by side, nobody is left moving, and
// events and record agree.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <map>

#include "tests/support/fleet.hpp"

namespace axon::test {
namespace {

using namespace std::chrono_literals;
using What = Fleet::Happened::What;

int seeds() {
    const char* given = std::getenv("AXON_SEEDS");
    return given != nullptr ? std::max(50, std::atoi(given)) : 150;
}

struct Story {
    explicit Story(std::uint64_t seed)
        : random(seed), robots(2 + below(5)), master(below(robots)), fleet(robots, seed) {}

    std::size_t below(std::size_t bound) {
        std::uint32_t number = 0;
        random.fill(&number, sizeof number);
        return number % bound;
    }
    bool oneIn(std::size_t n) { return below(n) == 0; }

    /// Every robot takes part, with blocking services once in a place.
    proto::GlobalService invent() {
        std::vector<std::string> steps;
        const auto places = 1 + below(5);
        for (std::size_t robot = 0; robot < robots; ++robot) {
            const auto count = 1 + below(3);
            std::vector<std::size_t> taken;
            for (std::size_t i = 0; i < count; ++i) {
                const auto place = below(places);
                if (std::find(taken.begin(), taken.end(), place) != taken.end()) continue;
                taken.push_back(place);
                if (oneIn(3)) {  // two that do not exclude each other
                    steps.push_back(std::to_string(robot) + " Sonar " + std::to_string(place * 7));
                    steps.push_back(std::to_string(robot) + " Light " + std::to_string(place * 7));
                } else {
                    steps.push_back(std::to_string(robot) + " Turning " + std::to_string(place * 7));
                }
            }
        }
        auto service = globalService(steps, static_cast<proto::OnFailure>(below(3)));
        for (std::size_t robot = 0; robot < robots; ++robot) {
            if (service.on_failure() != proto::COMPENSATE || oneIn(3)) continue;
            auto& step = *service.add_compensation();
            step.set_role(static_cast<std::int32_t>(robot));
            step.set_service_global_id("Driving");  // which no other step is
            auto& distance = *step.add_params();
            distance.set_name("Distance");
            distance.add_values()->set_str("100");
        }
        return service;
    }

    SeededRandom random;
    std::size_t robots, master;
    Fleet fleet;
};

/// No step begins before all of an earlier place have ended, as the robots saw it.
void expectOrder(const Fleet& fleet, const proto::GlobalService& service, std::optional<std::size_t> lost) {
    const auto place = [&](std::size_t robot, const std::string& name, std::size_t nth) {
        std::vector<std::int32_t> places;
        for (const auto& step : service.steps())
            if (step.role() == static_cast<std::int32_t>(robot) && step.service_global_id() == name)
                places.push_back(step.preced());
        std::sort(places.begin(), places.end());
        return nth < places.size() ? places[nth] : std::int32_t{1'000'000};  // of the compensation
    };
    std::map<std::pair<std::size_t, std::string>, std::size_t> begun;
    std::map<std::int32_t, int> open;  // place → steps under way
    std::map<std::pair<std::size_t, std::string>, std::int32_t> under_way;
    std::int32_t newest = -1;
    for (const auto& event : fleet.log) {
        if (event.robot == lost) continue;
        const std::pair key{event.robot, event.service};
        if (event.what == What::Began) {
            const auto at = place(event.robot, event.service, begun[key]++);
            EXPECT_GE(at, newest) << event.service << " of robot " << event.robot << " began too late";
            for (const auto& [other, count] : open)
                if (other < at) {
                    EXPECT_EQ(count, 0) << event.service << " of robot " << event.robot << " began too early";
                }
            newest = std::max(newest, at);
            ++open[at];
            under_way[key] = at;
        } else {
            --open[under_way[key]];
        }
    }
}

TEST(CollaborationProperty, RandomRunsKeepOrderAndLeaveNobodyMoving) {
    int overlapping = 0;
    std::map<proto::RunState, int> outcomes;
    for (int seed = 1; seed <= seeds(); ++seed) {
        SCOPED_TRACE("seed " + std::to_string(seed));
        Story story(static_cast<std::uint64_t>(seed));
        auto& fleet = story.fleet;
        const bool faulty = !story.oneIn(3);
        fleet.behave = [&](std::size_t, const proto::TaskDispatch&) {
            // What has ended when it answers overlaps with nothing: only where overlap is not what is judged.
            const std::chrono::milliseconds least{faulty ? 0 : 1};
            Fleet::Outcome outcome{.lasts = std::max(least, std::chrono::milliseconds{story.below(200)})};
            if (faulty && story.oneIn(12)) outcome.verdict = proto::TASK_FAILED;
            if (faulty && story.oneIn(20)) outcome.denied = true;
            return outcome;
        };
        const auto service = story.invent();
        if (faulty && story.oneIn(2))  // the signal lane may drop what its receiver has no room for
            fleet.lose = [&](std::size_t, std::size_t, const proto::ToEntity& message) {
                const auto& of_slave = message.from_slave();
                const auto& of_master = message.from_master();
                const bool droppable = of_slave.has_beat() || of_slave.has_departure() ||
                                       of_master.has_beat() || of_master.end().stop();
                return droppable && story.oneIn(5);
            };
        fleet.launch(service, story.master);
        std::optional<std::size_t> lost;
        bool retried = false;
        for (int i = 0; i < 60; ++i) {
            fleet.advance(std::chrono::milliseconds{5 * (1 + story.below(10))});
            if (!faulty) continue;
            const auto robot = story.below(story.robots);
            if (story.oneIn(60)) fleet.stop(robot);
            if (story.oneIn(60)) fleet.control(story.master, "run", proto::PAUSE);
            if (story.oneIn(20)) fleet.control(story.master, "run", proto::RESUME);
            if (story.oneIn(90)) fleet.control(story.master, "run", proto::CANCEL);
            if (story.oneIn(120) && !lost) {
                lost = robot;
                story.oneIn(2) ? fleet.cut(robot) : fleet.freeze(robot);
            }
        }
        for (const auto& [number, step] : fleet.told.steps) retried = retried || step.tries() > 1;
        if (fleet.told.state == proto::RUN_HELD || fleet.told.state == proto::RUN_PAUSED)
            fleet.control(story.master, "run", proto::CANCEL);
        fleet.advance(12s);

        const bool master_lost = lost == story.master;
        for (std::size_t i = 0; i < story.robots; ++i) {
            if (i == lost) continue;  // its own Entity Interfacer sees to it
            EXPECT_FALSE(fleet.moves(i)) << "robot " << i;
            EXPECT_EQ(fleet.state(i), EntityState::REG) << "robot " << i;
        }
        if (!retried) expectOrder(fleet, service, lost);  // what is tried again begins a second time
        EXPECT_TRUE(fleet.told.in_order);
        if (master_lost) continue;
        const auto record = fleet.record(story.master);
        ++outcomes[record.state()];
        EXPECT_GE(record.state(), proto::RUN_SUCCEEDED);
        EXPECT_EQ(record.state(), fleet.told.state);
        ASSERT_EQ(record.steps_size(), static_cast<int>(fleet.told.steps.size()));
        for (const auto& step : record.steps())
            EXPECT_EQ(step.SerializeAsString(), fleet.told.steps[step.step()].SerializeAsString())
                << step.step();
        if (faulty) continue;
        EXPECT_EQ(record.state(), proto::RUN_SUCCEEDED) << record.reason().message();
        // All that share a place begin before the first of them ends.
        int most = 0;
        int now = 0;
        for (const auto& event : fleet.log) most = std::max(most, now += event.what == What::Began ? 1 : -1);
        std::map<std::int32_t, int> places;
        for (const auto& step : service.steps()) ++places[step.preced()];
        int widest = 0;
        for (const auto& [place, steps] : places) widest = std::max(widest, steps);
        EXPECT_EQ(most, widest);
        overlapping += most > 1 ? 1 : 0;
    }
    EXPECT_GT(overlapping, 5);
    for (const auto state :
         {proto::RUN_SUCCEEDED, proto::RUN_FAILED, proto::RUN_STOPPED, proto::RUN_CANCELLED})
        EXPECT_GT(outcomes[state], 0) << proto::RunState_Name(state);
}

}  // namespace
}  // namespace axon::test
