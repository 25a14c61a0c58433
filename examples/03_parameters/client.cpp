// SPDX-License-Identifier: MIT
// draw-client [FOLDER_OF_DRAWINGS [SERVER]]: sets, uploads and watches what the entity Plotter takes and
// gives.
#include <atomic>
#include <axon/client.hpp>
#include <iostream>

namespace client = axon::client;

namespace {

[[noreturn]] void refused(const axon::Refusal& refusal) {
    std::cerr << axon::refusalName(refusal.code) << ": " << refusal.message << '\n';
    std::exit(1);
}

template <class T>
T must(axon::Result<T> result) {
    if (!result) refused(result.refusal());
    return std::move(result).value();
}

/// Prints how it went: a refusal is what this program wants to show.
void show(const std::string& what, const axon::Refusal& refusal) {
    std::cout << what << ": " << axon::refusalName(refusal.code);
    if (!refusal.ok()) std::cout << ", " << refusal.message;
    std::cout << std::endl;
}

// [describe]
void describe(const client::Service& service) {
    for (const auto& parameter : service.parameters) {
        std::cout << "  " << parameter.name << ": " << toString(parameter.kind) << ' '
                  << toString(parameter.data_type) << ' ' << parameter.units;
        for (const auto& choice : parameter.choices) std::cout << " [" << client::toText(choice) << ']';
        std::cout << '\n';
    }
    for (const auto& missing : service.missing) std::cout << "  missing: " << missing << '\n';
}
// [end]

}  // namespace

int main(int argc, char** argv) {
    const std::filesystem::path drawings = argc > 1 ? argv[1] : ".";
    client::Options options;
    if (argc > 2) options.server = argv[2];
    const auto lab = must(client::Client::connect(options));
    must(lab->waitFor("Plotter", client::Seconds(10)));
    const auto plotter = must(lab->checkOut("Plotter"));
    describe(must(plotter.service("Draw")));

    // [set]
    show("Speed 2000", plotter.set("Draw", {"Speed", {2000.0}, "mm/s"}).refusal());
    show("Speed 50 cm/s", plotter.set("Draw", {"Speed", {50.0}, "cm/s"}).refusal());
    show("Speed 400", plotter.set("Draw", {"Speed", {400.0}, "mm/s"}).refusal());
    // [end]
    // [upload]
    show("without a drawing", plotter.run("Draw", {{"Size", {100.0}}}).wait().reason);
    show("broken.txt", plotter.upload("Draw", "Drawing", drawings / "broken.txt").refusal());
    show("house.txt", plotter.upload("Draw", "Drawing", drawings / "house.txt").refusal());
    // [end]
    // [choices]
    show("in green", plotter.run("Draw", {{"Size", {100.0}}, {"Color", {"green"}}}).wait().reason);
    show("in red", plotter.run("Draw", {{"Size", {100.0}}, {"Color", {"red"}}}).wait().reason);
    // [end]
    // [watch]
    std::atomic<int> samples{0};
    const auto watching = must(lab->watch("Plotter", {"pen"}, [&](const client::Sample&) { ++samples; }));
    // [end]
    // [draw]
    const auto end = plotter.run("Draw", {{"Size", {100.0}}, {"Color", {"blue"}}}).wait();
    show("in blue", end.reason);
    std::cout << "Length " << client::toText(end.results.at("Length").front())
              << " mm, more than 20 samples: " << (samples > 20 ? "yes" : "no") << '\n';
    // [end]
}
