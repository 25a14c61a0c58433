// SPDX-License-Identifier: MIT
// stop-client [SERVER]: stops the entity Cart, and loses it in three ways. What follows each time is printed.
#include <atomic>
#include <axon/client.hpp>
#include <chrono>
#include <iostream>
#include <semaphore>

namespace client = axon::client;
using namespace std::chrono_literals;

namespace {

/// Says why something was not done, and ends the program.
[[noreturn]] void refused(const axon::Refusal& refusal) {
    std::cerr << axon::refusalName(refusal.code) << ": " << refusal.message << '\n';
    std::exit(1);
}

template <class T>
T must(axon::Result<T> result) {
    if (!result) refused(result.refusal());
    return std::move(result).value();
}

void must(const axon::Result<void>& result) {
    if (!result) refused(result.refusal());
}

const char* yes(bool is) {
    return is ? "yes" : "no";
}

// [present]
/// Whether somebody watches the robot. A real program asks a dead-man's switch or the touch of a screen.
std::atomic<bool> present{true};
// [end]

std::binary_semaphore orphaned{0}, resumed{0};

/// Starts a task, and returns when the cart moves.
client::Task begin(const client::CheckOut& cart, const char* service) {
    const auto task = cart.run(service, {{"Seconds", {2.0}}});
    auto report = task.report();
    while (report.progress <= 0 && !isFinal(report.state)) report = task.wait(client::Seconds(0.01));
    std::cout << service << ": " << toString(report.state) << std::endl;
    return task;
}

// [stop]
void stop(client::Client& lab, const client::CheckOut& cart) {
    const auto task = begin(cart, "Drive");
    for (const auto& receipt : must(lab.stop({"Cart"}, 1s, 5s))) {
        std::cout << "stopped, confirmed: " << yes(receipt.confirmed())
                  << ", stands still: " << yes(receipt.standstill.has_value()) << '\n';
    }
    const auto end = task.wait();
    std::cout << "Drive: " << toString(end.state) << ", " << end.reason.message << '\n';
    // [end]
    // [rearm]
    const auto next = cart.run("Drive").wait();
    std::cout << "Drive again: " << toString(next.state) << ", " << axon::refusalName(next.reason.code)
              << '\n';
    must(lab.rearm("Cart"));
    const auto last = begin(cart, "Drive").wait();
    std::cout << "Drive after a rearm: " << toString(last.state) << '\n';
    // [end]
}

// [lose]
client::Task lose(client::Client& lab, const client::CheckOut& cart, const char* service) {
    const auto task = begin(cart, service);
    present = false;  // heartbeats end, and the server stops waiting for them after 250 ms
    orphaned.acquire();
    present = true;  // the library has reconnected by itself, and gets its lease back
    resumed.acquire();
    std::cout << "back, latched: " << yes(must(lab.find("Cart")).latched) << '\n';
    return task;
}
// [end]

}  // namespace

int main(int argc, char** argv) {
    // [options]
    client::Options options;
    if (argc > 1) options.server = argv[1];
    options.keep_running = [] { return present.load(); };
    // [end]
    const auto lab = must(client::Client::connect(options));
    must(lab->waitFor("Cart", 10s));
    const auto cart = must(lab->checkOut("Cart"));
    // [news]
    cart.onOrphaned([](const std::string& reason) {
        std::cout << "orphaned: " << reason << std::endl;
        orphaned.release();
    });
    cart.onResumed([] { resumed.release(); });
    cart.onLost([](const axon::Refusal& why) {
        std::cout << "lost: " << why.message << std::endl;
        std::exit(1);
    });
    // [end]

    stop(*lab, cart);

    // [losses]
    const auto drive = lose(*lab, cart, "Drive");  // on_client_loss="stop", the default
    std::cout << "Drive: " << toString(drive.wait().state) << '\n';
    must(lab->rearm("Cart"));

    const auto carry = lose(*lab, cart, "Carry");  // on_client_loss="hold"
    must(carry.resume());
    std::cout << "Carry: " << toString(carry.wait().state) << '\n';

    const auto park = lose(*lab, cart, "Park");  // on_client_loss="finish"
    std::cout << "Park: " << toString(park.wait().state) << '\n';
    // [end]
    must(cart.release());
}
