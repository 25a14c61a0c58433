// SPDX-License-Identifier: MIT
// A stationary robot that takes things from its table and hands them over.
#include <fstream>

#include "station.hpp"

namespace {

using Seconds = std::chrono::duration<double>;

/// All services are blocking, so one handler runs at a time and nothing here needs a lock.
class Arm {
  public:
    explicit Arm(const Options& options) : table_(options.folder / "table.txt"), speed_(options.speed) {}

    void pick(axon::Task& task) {
        const auto object = task.text("Object");
        if (!held_.empty()) return task.fail("I hold " + held_ + " already: give it first");
        if (!move(task, 1.0)) return;
        const auto weight_kg = weightOf(object);
        if (weight_kg < 0)
            return task.fail("there is no " + object + " on my table: put one there (a line in " +
                             table_.filename().string() + ")");
        if (weight_kg > kLiftsAtMost_kg)
            return task.fail(object + " is too heavy: " + std::to_string(int(weight_kg)) +
                             " kg, I lift at most " + std::to_string(int(kLiftsAtMost_kg)));
        held_ = object;
        task.result("Weight", weight_kg, "kg");
    }

    void give(axon::Task& task) {
        if (held_.empty()) return task.fail("my gripper is empty: pick something first");
        if (!move(task, 0.6)) return;
        task.feedback("here is " + held_);
        task.result("Object", std::exchange(held_, {}));
    }

    /// Whatever it holds goes back to the table.
    void fold(axon::Task& task) {
        if (!move(task, 0.6)) return;
        if (!held_.empty()) task.feedback(std::exchange(held_, {}) + " lies on my table again");
    }

  private:
    static constexpr double kLiftsAtMost_kg = 5;

    bool move(axon::Task& task, double seconds) const {
        constexpr int kParts = 10;
        for (int part = 1; part <= kParts; ++part) {
            if (!task.waitWhilePaused() || !task.waitFor(Seconds(seconds / kParts / speed_))) return false;
            task.progress(double(part) / kParts);
        }
        return true;
    }

    /// What its camera would see: lines "cup 0.3", read anew each time. Negative where there is none.
    double weightOf(const std::string& object) const {
        std::ifstream table(table_);
        std::string name;
        for (double weight_kg = 0; table >> name >> weight_kg;)
            if (name == object) return weight_kg;
        return -1;
    }

    const std::filesystem::path table_;
    const double speed_;
    std::string held_;
};

}  // namespace

int main(int argc, char** argv) {
    std::unique_ptr<Arm> arm;
    return runStation(argc, argv, "Arm", "arm",
                      [&](axon::EntityInterfacer& interfacer, const Options& options) {
                          arm = std::make_unique<Arm>(options);
                          interfacer.onTask("Pick", [&](axon::Task& task) { arm->pick(task); });
                          interfacer.onTask("Give", [&](axon::Task& task) { arm->give(task); });
                          interfacer.onTask("Fold", [&](axon::Task& task) { arm->fold(task); });
                      });
}
