// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/built_folder.hpp"

#include <sodium.h>
#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <optional>

namespace axon::console {

namespace fs = std::filesystem;

namespace {

constexpr const char* kFirstPage = "index.html";

std::string digestOf(const std::string& content) {
    std::array<unsigned char, 16> digest{};
    crypto_generichash(digest.data(), digest.size(), reinterpret_cast<const unsigned char*>(content.data()),
                       content.size(), nullptr, 0);
    std::array<char, 2 * digest.size() + 1> text{};
    return sodium_bin2hex(text.data(), text.size(), digest.data(), digest.size());
}

std::shared_ptr<const std::string> contentOf(const fs::path& file, std::size_t most) {
    std::error_code unknown;
    const auto size = fs::file_size(file, unknown);
    if (unknown || size > most) return nullptr;
    std::ifstream in(file, std::ios::binary);
    std::string content(size + 1, '\0');  // one more: it may be growing
    in.read(content.data(), static_cast<std::streamsize>(content.size()));
    const auto got = static_cast<std::size_t>(in.gcount());
    if (in.bad() || got > size) return nullptr;
    return std::make_shared<const std::string>(content.data(), got);  // as large as the file, and no larger
}

bool isPlain(const std::string& path) {
    return std::all_of(path.begin(), path.end(), [](unsigned char c) { return c > 0x20 && c < 0x7f; });
}

}  // namespace

std::string typeOf(const fs::path& name) {
    static const std::map<std::string, const char*, std::less<>> kTypes{
        {".html", "text/html; charset=utf-8"},
        {".js", "text/javascript; charset=utf-8"},
        {".mjs", "text/javascript; charset=utf-8"},
        {".css", "text/css; charset=utf-8"},
        {".txt", "text/plain; charset=utf-8"},
        {".json", "application/json"},
        {".map", "application/json"},
        {".webmanifest", "application/manifest+json"},
        {".svg", "image/svg+xml"},
        {".png", "image/png"},
        {".jpg", "image/jpeg"},
        {".jpeg", "image/jpeg"},
        {".webp", "image/webp"},
        {".gif", "image/gif"},
        {".ico", "image/x-icon"},
        {".woff2", "font/woff2"},
        {".woff", "font/woff"},
    };
    const auto found = kTypes.find(name.extension().string());
    return found == kTypes.end() ? "application/octet-stream" : found->second;
}

fs::path consoleFolder(const fs::path& program) {
    const auto prefix = program.parent_path().parent_path();
    const auto installed = prefix / "share/axon/console";
    // Of a program in build/PRESET/bin.
    const auto built = prefix.parent_path().parent_path() / "web/console/dist";
    std::error_code unknown;
    if (!fs::is_regular_file(installed / kFirstPage, unknown) &&
        fs::is_directory(built.parent_path(), unknown))
        return built;
    return installed;
}

BuiltFolder::BuiltFolder(fs::path folder, const Clock& clock, Note note)
    : folder_(std::move(folder)), clock_(clock), note_(std::move(note)) {}

std::vector<BuiltFolder::Found> BuiltFolder::look() const {
    std::vector<Found> all;
    const auto add = [&](const fs::path& file) {
        struct stat facts {};
        if (::lstat(file.c_str(), &facts) != 0 || !S_ISREG(facts.st_mode)) return false;
        all.push_back({file, facts.st_ino, facts.st_mtim.tv_sec, facts.st_mtim.tv_nsec, facts.st_size});
        return true;
    };
    if (!add(folder_ / kFirstPage)) return {};
    std::error_code failure;
    fs::recursive_directory_iterator at(folder_, fs::directory_options::none, failure);
    for (; !failure && at != fs::recursive_directory_iterator() && all.size() <= kFilesMax;
         at.increment(failure)) {
        std::error_code unknown;
        const bool hidden = at->path().filename().string().starts_with('.');
        if (fs::is_directory(at->symlink_status(unknown))) {
            if (hidden || at.depth() > 8) at.disable_recursion_pending();
        } else if (!hidden && at->path() != folder_ / kFirstPage) {
            add(at->path());
        }
    }
    return all;
}

std::shared_ptr<const BuiltFiles> BuiltFolder::files() {
    if (const auto now = clock_.now(); now >= looks_again_) {
        looks_again_ = now + kLook;
        if (auto found = look(); found != found_) {
            found_ = std::move(found);
            read();
        }
    }
    return files_;
}

void BuiltFolder::read() {
    struct Codings {
        std::shared_ptr<const std::string> plain, gzip, br;
    };
    std::map<std::string, Codings> found;
    std::size_t count = 0, bytes = 0, left_out = 0;
    for (const auto& [file, inode, seconds, nanoseconds, size] : found_) {
        const auto path = "/" + file.lexically_relative(folder_).generic_string();
        const auto content = ++count > kFilesMax || !isPlain(path)
                                 ? nullptr
                                 : contentOf(file, std::min(kFileMax, kAllMax - bytes));
        if (!content) {
            ++left_out;
            continue;
        }
        bytes += content->size();
        const auto coding = file.extension().string();
        if (coding == ".gz" || coding == ".br") {
            auto& its = found[path.substr(0, path.size() - coding.size())];
            (coding == ".gz" ? its.gzip : its.br) = content;
        } else {
            found[path].plain = content;
        }
    }
    auto files = std::make_shared<BuiltFiles>();
    for (auto& [path, its] : found) {
        if (!its.plain) continue;  // nothing that a browser without this coding could be given
        (*files)[path] = {typeOf(path), digestOf(*its.plain), its.plain, its.gzip, its.br};
    }
    files_ = std::move(files);
    if (left_out > 0)
        note_("console: " + std::to_string(left_out) + " files of " + folder() +
              " are left out: they cannot be read, have names that are not plain ASCII, or exceed 2,000 "
              "files, 16 MiB each or 64 MiB in all");
}

}  // namespace axon::console
