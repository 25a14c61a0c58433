// SPDX-License-Identifier: MIT
// A mobile robot that follows a way of cells and carries one thing.
#include <vector>

#include "station.hpp"

namespace {

using Seconds = std::chrono::duration<double>;

/// All services are blocking, so one handler runs at a time and nothing here needs a lock.
class Shuttle {
  public:
    Shuttle(axon::EntityInterfacer& interfacer, double speed) : interfacer_(interfacer), speed_(speed) {
        tell();
    }

    void where(axon::Task& task) { task.result("Cell", toText(at_)); }

    void follow(axon::Task& task) {
        std::vector<Cell> way;
        for (const auto& cell : task.texts("Way")) way.push_back(toCell(cell));
        if (way.empty() || way.front() != at_)
            return task.fail("the way begins at " + (way.empty() ? "no cell" : toText(way.front())) +
                             ", and I stand at " + toText(at_) + ": ask for one from there");
        for (std::size_t i = 1; i < way.size(); ++i) {
            if (!way[i].isBeside(way[i - 1]))
                return task.fail("from " + toText(way[i - 1]) + " to " + toText(way[i]) + " is no step");
        }
        for (std::size_t i = 1; i < way.size(); ++i) {
            if (!stepTo(task, way[i])) return;
            task.progress(double(i) / double(way.size() - 1));
            trail_.push_back(way[i - 1]);
        }
        task.result("Cell", toText(at_));
    }

    void load(axon::Task& task) {
        if (!load_.empty()) return task.fail("I carry " + load_ + " already: unload it first");
        if (!task.waitFor(Seconds(0.4 / speed_))) return;
        load_ = task.text("Object");
        task.feedback("I have " + load_);
    }

    void unload(axon::Task& task) {
        if (load_.empty()) return task.fail("I carry nothing");
        if (!task.waitFor(Seconds(0.4 / speed_))) return;
        task.result("Object", std::exchange(load_, {}));
        task.result("Cell", toText(at_));
    }

    /// The way it came, backwards: what it drove over once was free.
    void park(axon::Task& task) {
        for (const double cells = double(trail_.size()); !trail_.empty(); trail_.pop_back()) {
            if (!stepTo(task, trail_.back())) return;
            task.progress(1 - double(trail_.size() - 1) / cells);
        }
        task.result("Cell", toText(at_));
    }

  private:
    bool stepTo(axon::Task& task, const Cell& next) {
        if (!task.waitWhilePaused() || !task.waitFor(Seconds(0.5 / speed_))) return false;
        at_ = next;
        tell();
        std::cout << "at " << toText(at_) << std::endl;
        task.feedback("at " + toText(at_));
        return true;
    }
    void tell() { interfacer_.setPosition(at_.x * 500.0, at_.y * 500.0, 0); }

    axon::EntityInterfacer& interfacer_;
    const double speed_;
    Cell at_{1, 1};
    std::vector<Cell> trail_;  // where it has been since it was at home, the newest last
    std::string load_;
};

}  // namespace

int main(int argc, char** argv) {
    std::unique_ptr<Shuttle> shuttle;
    return runStation(
        argc, argv, "Shuttle", "shuttle", [&](axon::EntityInterfacer& interfacer, const Options& options) {
            shuttle = std::make_unique<Shuttle>(interfacer, options.speed);
            interfacer.onTask("Where", [&](axon::Task& task) { shuttle->where(task); });
            interfacer.onTask("Follow", failing([&](axon::Task& task) { shuttle->follow(task); }));
            interfacer.onTask("Load", [&](axon::Task& task) { shuttle->load(task); });
            interfacer.onTask("Unload", [&](axon::Task& task) { shuttle->unload(task); });
            interfacer.onTask("Park", [&](axon::Task& task) { shuttle->park(task); });
        });
}
