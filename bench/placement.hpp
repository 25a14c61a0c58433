// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace axon::bench {

/// On which cores a system under test runs.
enum class Cores : std::uint8_t {
    Any,  ///< wherever the kernel puts each thread
    One,  ///< all processes share one core
    Two,  ///< the sender has one core; servers and receivers share another
};
/// "any", "one", "two": as options and reports name them.
const char* nameOf(Cores cores);
/// The reverse of nameOf(). Throws std::invalid_argument for another name.
Cores coresOf(const std::string& name);

/// Moves the processes of a run to chosen cores. A latency on a machine with several cores depends on
/// where the kernel puts the threads: waking a sleeping core costs many times what a switch on the same
/// core costs. So systems are compared only while all of them are placed alike.
///
/// Uses the first two cores that this process was permitted when this was made. Linux only. The destructor
/// permits again what was permitted then. Not for use from several threads at a time.
class Placement {
  public:
    Placement();
    ~Placement();
    Placement(const Placement&) = delete;
    Placement& operator=(const Placement&) = delete;

    /// Two cores need two.
    bool permits(Cores cores) const;
    /// Of this process and its children, every thread that exists; those that they begin later follow. This
    /// process is the sender, its children are servers and receivers. Throws std::system_error when the
    /// kernel refuses.
    void apply(Cores cores);
    Cores applied() const { return applied_; }
    /// Child's `prepare` for a child that begins now: on which side it is. Without it a child begins on the
    /// sender's side and stays there until the next apply().
    std::function<void()> asSender() const;
    std::function<void()> asReceiver() const;

  private:
    const std::vector<int>& of(Cores cores, bool sender) const;

    std::vector<int> all_, first_, second_;
    Cores applied_ = Cores::Any;
};

}  // namespace axon::bench
