// SPDX-License-Identifier: MIT
// greet-client [SERVER]: lets the entity Greeter say hello. The whole life of a client on one page.
#include <axon/client.hpp>
#include <iostream>

namespace client = axon::client;

// [refusal]
/// A refusal is an ordinary answer, not an exception: a code for the program, and a message for the person.
int refused(const axon::Refusal& refusal) {
    std::cerr << axon::refusalName(refusal.code) << ": " << refusal.message << '\n';
    return 1;
}
// [end]

int main(int argc, char** argv) {
    // [connect]
    client::Options options;
    if (argc > 1) options.server = argv[1];  // otherwise 127.0.0.1:10410
    const auto lab = client::Client::connect(options);
    if (!lab) return refused(lab.refusal());
    // [end]

    // [find]
    const auto greeter = lab.value()->waitFor("Greeter", client::Seconds(10));
    if (!greeter) return refused(greeter.refusal());
    std::cout << greeter->name << ": " << greeter->descr << '\n';
    // [end]

    // [checkout]
    const auto held = lab.value()->checkOut("Greeter");
    if (!held) return refused(held.refusal());
    std::cout << "checked out\n";
    // [end]

    // [run]
    const auto task = held->run("Greet", {{"Name", {"Ada"}}, {"Times", {2}}});
    task.onUpdate([](const client::TaskReport& report) {
        std::cout << toString(report.state) << ' ' << report.progress << ' ' << report.feedback << std::endl;
    });
    const auto end = task.wait();
    if (end.state != client::TaskState::Succeeded) return refused(end.reason);
    // [end]

    // [release]
    const auto released = held->release();
    if (!released) return refused(released.refusal());
    std::cout << "released\n";
    // [end]
}
