// SPDX-License-Identifier: GPL-2.0-or-later
// What a note for the audit trail costs the thread that makes it, in nanoseconds: axon-bench-audit [NOTES]
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "audit/trail.hpp"

namespace {

using namespace axon;
using Clock = std::chrono::steady_clock;

const audit::Note kStop{.kind = audit::Kind::Stop,
                        .name = "client1",
                        .client = "0b1c2d3e-4f50-8a6b-9c7d-8e9fa0b1c2d3",
                        .entity = "6f9619ff-8b86-4d01-b42d-00cf4fc964ff",
                        .what = "stop",
                        .outcome = "OK"};

/// One by one with a pause between them, as stops come, or all at once.
void measure(const char* what, audit::AuditTrail& trail, audit::Kind kind, int notes,
             std::chrono::microseconds pause) {
    auto note = kStop;
    note.kind = kind;
    std::vector<double> ns;
    ns.reserve(static_cast<std::size_t>(notes));
    for (int i = 0; i < notes; ++i) {
        const auto begin = Clock::now();
        trail.note(note);
        ns.push_back(std::chrono::duration<double, std::nano>(Clock::now() - begin).count());
        if (pause.count() > 0) std::this_thread::sleep_for(pause);
    }
    std::sort(ns.begin(), ns.end());
    const auto at = [&ns](double part) {
        return ns[static_cast<std::size_t>(part * static_cast<double>(ns.size() - 1))];
    };
    std::printf("%-28s n=%d  median %.0f ns  p99 %.0f ns  most %.0f ns\n", what, notes, at(0.5), at(0.99),
                ns.back());
}

}  // namespace

int main(int argc, char** argv) {
    const int notes = argc > 1 ? std::max(std::atoi(argv[1]), 100) : 20'000;
    std::string name = (std::filesystem::temp_directory_path() / "axon-bench-audit-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) return 1;
    audit::TrailSettings settings;
    settings.folder = name;
    measure("without a trail", audit::orNone(nullptr), audit::Kind::Stop, notes, {});
    {
        audit::Trail trail(settings, "bench", "",
                           [](const std::string& line) { std::fprintf(stderr, "%s\n", line.c_str()); });
        measure("stop, its thread sleeps", trail, audit::Kind::Stop, notes / 20,
                std::chrono::milliseconds{1});
        measure("log-in, its thread sleeps", trail, audit::Kind::Login, notes / 20,
                std::chrono::milliseconds{1});
        measure("stop, its thread writes", trail, audit::Kind::Stop, notes, {});
    }
    std::filesystem::remove_all(name);
    return 0;
}
