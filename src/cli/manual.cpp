// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/manual.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <sstream>
#include <string_view>

#include "cli/common_options.hpp"
#include "cli/synopsis.hpp"
#include "common/release.hpp"
#include "messages/text.hpp"

namespace axon::cli {
namespace {

/// The text for troff: no character of it is a request or an escape, and all is ASCII.
std::string troff(std::string_view text) {
    std::string out;
    bool line_begins = true;
    for (std::size_t i = 0; i < text.size(); ++i) {
        const auto c = static_cast<unsigned char>(text[i]);
        if (line_begins && (c == '.' || c == '\'')) out += "\\&";
        line_begins = c == '\n';
        if (c == '\\') {
            out += "\\e";
        } else if (c == '-') {
            out += "\\-";
        } else if (c == '\'') {
            out += "\\(aq";
        } else if (c == '`') {
            out += "\\(ga";
        } else if (c == '^') {
            out += "\\(ha";
        } else if (c == '~') {
            out += "\\(ti";
        } else if (c < 0x80U) {
            out += text[i];
        } else {
            const int more = c >= 0xF0U ? 3 : c >= 0xE0U ? 2 : 1;
            std::uint32_t point = c & (0x3FU >> static_cast<unsigned>(more));
            for (int n = 0; n < more && i + 1 < text.size(); ++n)
                point = (point << 6U) | (static_cast<unsigned char>(text[++i]) & 0x3FU);
            out += fmt::format("\\[u{:04X}]", point);
        }
    }
    return out;
}

std::string bold(std::string_view text) {
    return "\\fB" + troff(text) + "\\fR";
}

/// Words in capitals are what a user replaces: they are set in italics, all others in bold.
std::string synopsis(const std::string& text) {
    std::string out;
    std::istringstream words(text);
    for (std::string word; words >> word;) {
        const bool replaced =
            std::none_of(word.begin(), word.end(), [](char c) { return c >= 'a' && c <= 'z'; });
        out += (out.empty() ? "" : " ") + (replaced ? "\\fI" + troff(word) + "\\fR" : bold(word));
    }
    return out;
}

std::string paragraph(const std::string& tag, std::string_view text) {
    return ".TP\n" + tag + "\n" + troff(text) + "\n";
}

std::string title(const std::string& name) {
    return fmt::format(".TH {} 1 \"\" \"axon {}\" \"Axon\"\n", troff(name), kRelease);
}

/// A name and what it is, as the NAME section needs it: no full stop, one line.
std::string nameSection(const std::string& name, const std::string& summary) {
    return ".SH NAME\n" + troff(name) + " \\- " + troff(summary) + "\n";
}

/// Lines that begin with two spaces are typed by a user and stay as they are; others are sentences.
std::string examples(std::string_view text) {
    std::string out;
    bool typed = false;
    std::istringstream lines{std::string(text)};
    for (std::string one; std::getline(lines, one);) {
        if (one.empty()) continue;
        const bool example = one.starts_with("  ");
        if (example && !typed) out += (out.empty() ? "" : ".PP\n") + std::string(".nf\n");
        if (!example && typed) out += ".fi\n.PP\n";
        typed = example;
        out += troff(example ? std::string_view(one).substr(2) : one) + "\n";
    }
    return out + (typed ? ".fi\n" : "");
}

std::string describe(const Operand& operand) {
    std::string text = operand.help;
    if (!operand.choices.empty()) {
        std::string choices;
        for (const auto* choice : operand.choices)
            choices += (choices.empty() ? "" : ", ") + std::string(choice);
        if (text != choices) text += (text.empty() ? "" : ": ") + choices;
    }
    return text.empty() ? operand.name : text;
}

std::string describe(const Option& option) {
    std::string text = option.help;
    if (!option.choices.empty()) {
        text += ": ";
        for (const auto* choice : option.choices)
            text += std::string(choice == option.choices.front() ? "" : ", ") + choice;
    }
    if (option.repeated) text += " (may be given several times)";
    return text;
}

std::string tagOf(const Option& option) {
    const auto value = placeholderOf(option);
    const auto name = bold(std::string("--") + option.name);
    if (value.empty()) return name;
    return name + (value.front() == '[' ? "" : " ") + "\\fI" + troff(value) + "\\fR";
}

std::string exitSection() {
    std::string text = ".SH EXIT STATUS\n";
    for (const auto& one : exitMeanings()) text += paragraph(bold(std::to_string(one.status)), one.meaning);
    return text;
}

std::string seeAlso(const std::vector<std::string>& pages) {
    std::string text = ".SH SEE ALSO\n";
    for (const auto& page : pages)
        text += ".BR " + troff(page) + " (1)" + (&page == &pages.back() ? "" : " ,") + "\n";
    return text;
}

bool makeFile(const std::filesystem::path& path, const std::string& text) {
    std::error_code none;
    std::filesystem::create_directories(path.parent_path(), none);
    std::ofstream file(path, std::ios::binary | std::ios::trunc);
    file << text;
    file.close();
    return !file.fail();
}

}  // namespace

std::string manualName(const Verb& verb) {
    auto name = "axon-" + std::string(verb.name);
    std::replace(name.begin(), name.end(), ' ', '-');
    return name;
}

std::string manualPage(const Verb& verb) {
    auto text = title(manualName(verb)) + nameSection(manualName(verb), verb.summary);
    text += ".SH SYNOPSIS\n" + synopsis(synopsisOf(verb)) + "\n";
    if (!verb.operands.empty()) {
        text += ".SH OPERANDS\n";
        for (const auto& operand : verb.operands)
            text += paragraph("\\fI" + troff(placeholderOf(operand)) + "\\fR", describe(operand));
    }
    text += ".SH OPTIONS\n";
    for (const auto& option : verb.options) text += paragraph(tagOf(option), describe(option));
    text += paragraph(bold("--help"), "Show the help of this verb");
    text +=
        ".PP\nThe options of every verb, such as \\fB\\-\\-server\\fR and \\fB\\-\\-json\\fR, are in\n"
        ".BR axon (1).\n";
    if (*verb.examples != '\0') text += ".SH EXAMPLES\n" + examples(verb.examples);
    text += ".SH EXIT STATUS\nThe table of exit statuses is in\n.BR axon (1).\n";
    const std::string name = verb.name;
    std::vector<std::string> pages{"axon"};
    if (const auto space = name.find(' '); space != std::string::npos) {
        for (const auto* other : verbs())
            if (other != &verb && std::string_view(other->name).starts_with(name.substr(0, space + 1)))
                pages.push_back(manualName(*other));
    }
    return text + seeAlso(pages);
}

std::string manualPage() {
    auto text = title("axon") + nameSection("axon", "use the robots of an Axon laboratory");
    text +=
        ".SH SYNOPSIS\n\\fBaxon\\fR \\fIVERB\\fR [\\fIOPTIONS\\fR]\n.br\n"
        "\\fBaxon help\\fR [\\fIVERB\\fR]\n";
    text +=
        ".SH DESCRIPTION\nThe command shows the robots and machines of one server, checks them out, runs "
        "their "
        "services as tasks, and stops them.\nEach verb has a page of its own.\n";
    text += ".SH VERBS\n";
    for (const auto* verb : verbs()) {
        if (verb->hidden) continue;
        text += ".TP\n" + bold(verb->name) + "\n" + troff(verb->summary) + " (\\fB" +
                troff(manualName(*verb)) + "\\fR(1))\n";
    }
    text += ".SH OPTIONS\nThese are options of every verb.\n";
    std::string variables;
    const Settings defaults{};
    for (const auto& option : commonOptions()) {
        auto tag = bold(std::string("--") + option.name);
        if (*option.placeholder != '\0') tag += " \\fI" + troff(option.placeholder) + "\\fR";
        text += paragraph(tag, helpOf(option, defaults));
        if (*option.environment != '\0')
            variables += paragraph(bold(option.environment),
                                   std::string("Default of --") + option.name + ": " + option.help);
    }
    text += ".SH ENVIRONMENT\n" + variables +
            paragraph(bold("AXON_PASSWORD"), "The password; it takes precedence over the password file");
    text += exitSection();
    std::vector<std::string> pages;
    for (const auto* verb : verbs())
        if (!verb->hidden) pages.push_back(manualName(*verb));
    return text + seeAlso(pages);
}

Result<void> writeManual(const std::filesystem::path& folder) {
    std::vector<std::pair<std::filesystem::path, std::string>> files{{"man/man1/axon.1", manualPage()}};
    for (const auto* verb : verbs()) {
        if (!verb->hidden) files.emplace_back("man/man1/" + manualName(*verb) + ".1", manualPage(*verb));
    }
    files.emplace_back("bash-completion/completions/axon", completionScript("bash"));
    files.emplace_back("zsh/vendor-completions/_axon", completionScript("zsh"));
    files.emplace_back("fish/vendor_completions.d/axon.fish", completionScript("fish"));
    for (const auto& [name, text] : files) {
        if (!makeFile(folder / name, text))
            return Refusal{RefusalCode::Malformed, "cannot write " + inQuotes((folder / name).string(), 200)};
    }
    return {};
}

}  // namespace axon::cli
