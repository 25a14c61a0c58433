// SPDX-License-Identifier: GPL-2.0-or-later
#include <string_view>

#include "cli/holding.hpp"
#include "cli/open_page.hpp"
#include "cli/verbs/docs_place.hpp"

// axon docs: the documentation site that is installed, or was built, with this program
namespace axon::cli {

namespace fs = std::filesystem;

std::optional<fs::path> docsPage(const fs::path& program, std::string_view page) {
    const auto folder = program.parent_path().parent_path();
    fs::path name = page.empty() ? "index.html" : page;
    if (name.extension() == ".md") name.replace_extension(".html");
    // Installed: PREFIX/bin/axon. Built: build/PRESET/bin/axon, and tools/make_docs writes into build.
    for (const auto& site : {folder / "share/doc/axon/html", folder.parent_path() / "docs-site"}) {
        const auto found = site / name;
        std::error_code unknown;
        if (fs::is_regular_file(found, unknown)) return found.lexically_normal();
    }
    return std::nullopt;
}

namespace {

int docs(Session& session) {
    std::error_code unknown;
    const auto page = session.args.value("page", std::string{});
    const auto program = fs::read_symlink("/proc/self/exe", unknown);
    const auto found = docsPage(program, page);
    if (!found && !page.empty() && docsPage(program, {}))
        return misused(
            session, "the documentation has no page " + page,
            "name a page by its path in the sources, such as docs/questions.md, or none for the first one");
    if (!found)
        return misused(
            session, "the documentation is not installed with this program",
            "install the package axon-doc, or build the pages from the sources with tools/make_docs; "
            "the same texts are in the folder docs of the sources");
    const bool open = !session.args.value("path", false) && hasDisplay();
    const int error = open ? openPage(found->string()) : 0;
    session.events.emit({{"event", "line"}, {"text", found->string()}});
    if (error == 0) return kDone;
    session.events.emit(
        {{"event", "notice"}, {"message", "xdg-open cannot show it; fix: open that file in a browser"}});
    return kRefused;
}

}  // namespace

extern const Verb kDocs{
    "docs",
    "Open the documentation in a browser, or print where it is",
    "  axon docs\n"
    "  axon docs docs/questions.md       open one page\n"
    "  axon docs --path                  print the path only\n"
    "Without a graphical session it prints the path. It needs no server and no network.\n",
    Runs::Local,
    {{"page", Takes::Text, false, false, "A page, by its path in the sources"}},
    {{"path", Takes::Nothing, "Print the path and open nothing"}},
    docs};

}  // namespace axon::cli
