// SPDX-License-Identifier: GPL-2.0-or-later
// Runs a fuzz target over stored inputs without libFuzzer, so that every finding of the past is an ordinary
// test. usage: NAME_replay FOLDER...   Exit status 2 where a folder is missing or holds no input.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size);

int main(int argc, char** argv) {
    std::size_t inputs = 0;
    for (int i = 1; i < argc; ++i) {
        std::error_code failure;
        std::vector<std::filesystem::path> files;
        for (const auto& entry : std::filesystem::directory_iterator(argv[i], failure))
            if (entry.is_regular_file()) files.push_back(entry.path());
        if (failure || files.empty()) {
            std::fprintf(stderr, "%s: a folder with inputs is expected: %s\n", argv[i],
                         failure ? failure.message().c_str() : "it is empty");
            return 2;
        }
        std::sort(files.begin(), files.end());
        for (const auto& file : files) {
            std::ifstream stream(file, std::ios::binary);
            const std::vector<char> bytes{std::istreambuf_iterator<char>(stream), {}};
            std::fprintf(stderr, "%s (%zu bytes)\n", file.c_str(), bytes.size());
            LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
            ++inputs;
        }
    }
    std::printf("%zu inputs replayed\n", inputs);
    return inputs > 0 ? 0 : 2;
}
