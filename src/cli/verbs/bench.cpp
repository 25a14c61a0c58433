// SPDX-License-Identifier: GPL-2.0-or-later
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <filesystem>

#include "cli/holding.hpp"

// axon bench: the program axon-bench beside this one, with the same words
namespace axon::cli {
namespace {

int bench(Session& session) {
    std::error_code unknown;
    const auto program =
        std::filesystem::read_symlink("/proc/self/exe", unknown).parent_path() / "axon-bench";
    std::vector<std::string> words{program.string()};
    if (session.args.contains("words")) {
        for (const auto& word : session.args.at("words")) words.push_back(word);
    }
    std::vector<char*> arguments;
    for (auto& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    // It takes its own signals; ours are blocked, and that would be inherited.
    ::signal(SIGPIPE, SIG_DFL);
    sigset_t none, before;
    ::sigemptyset(&none);
    ::pthread_sigmask(SIG_SETMASK, &none, &before);
    ::execv(arguments[0], arguments.data());
    const int error = errno;
    ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
    ::signal(SIGPIPE, SIG_IGN);
    return misused(
        session, "cannot run " + program.string() + ": " + std::strerror(error),
        "install the package axon-tools, which has the benchmark; or build it from the sources with ./check, "
        "or with libmosquitto-dev installed and ninja -C build/release axon-bench, and run axon bench "
        "from that folder");
}

}  // namespace

extern const Verb kBench{
    "bench",
    "Measure Axon on this machine, and compare it with others (axon-bench)",
    "  axon bench                                     list the experiments\n"
    "  axon bench peers --entities 1,64               compare with Mosquitto, NATS, CycloneDDS and a raw "
    "router\n"
    "  axon bench chapter5 --table 5.2 --seconds 10   compare with what the thesis printed\n"
    "  axon bench peers --help                        show the options of one\n"
    "Everything after bench goes to axon-bench, which starts its own servers and touches no others.\n",
    Runs::Local,
    {{"words", Takes::Text, false, true, "An experiment, and its options"}},
    {},
    bench};

}  // namespace axon::cli
