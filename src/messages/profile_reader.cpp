// SPDX-License-Identifier: MIT
#include "messages/profile_reader.hpp"

#include <algorithm>
#include <fstream>
#include <optional>
#include <utility>

#include "common/entity_name.hpp"
#include "messages/profile_elements.hpp"
#include "messages/xml_document.hpp"

namespace axon {
namespace {

using namespace profiles;

proto::BasicProfile readBasic(const XmlElement& root, Findings& findings) {
    Reader reader(root, findings);
    proto::BasicProfile profile;
    profile.set_name(reader.name("name"));
    if (!profile.name().empty()) reader.nameIt(profile.name());
    if (!isEntityName(profile.name()))
        reader.error(reader.lineOf("name"), "name",
                     "a name that cannot mean another entity: no UUID, and no '#' with a number at its end",
                     "rename it; NAME#2 is the second of the entities that are called NAME");
    if (const auto category = reader.choice("category", kCategories, true)) profile.set_category(*category);
    if (const auto type = reader.choice("type", kMobilities, true)) profile.set_type(*type);
    profile.set_descr(reader.text("descr"));
    const auto position = [&](std::string_view attribute) {
        const bool given = reader.take(attribute) != nullptr;
        if (!given)
            reader.warning(reader.line(), attribute, "the position in millimetres; it counts as 0",
                           "add " + std::string(attribute) + "=\"0\"");
        return reader.number(attribute, "a position in millimetres").value_or(0);
    };
    profile.set_xpos(position("xpos"));
    profile.set_ypos(position("ypos"));
    profile.set_zpos(position("zpos"));
    reader.reportUnknownAttributes();
    reader.children({}, [](const XmlElement&) {});
    return profile;
}

ProfileKind kindOf(std::string_view root) {
    if (root == "BasicProfile") return ProfileKind::Basic;
    if (root == "ServiceProfile" || root == "ServicesProfile") return ProfileKind::Services;
    if (root == "GlobalProfile") return ProfileKind::Global;
    return ProfileKind::Unknown;
}

std::string_view rootName(ProfileKind kind) {
    switch (kind) {
        case ProfileKind::Basic:
            return "BasicProfile";
        case ProfileKind::Services:
            return "ServiceProfile";
        case ProfileKind::Global:
            return "GlobalProfile";
        case ProfileKind::Unknown:
            break;
    }
    return "";
}

template <class Message, class Read>
Reading<Message> readProfile(std::string_view xml, std::string_view file_name, ProfileKind kind,
                             const Read& read) {
    Findings findings(file_name);
    Reading<Message> reading;
    const auto document = parseXml(xml);
    for (const auto& fault : document.faults)
        findings.error(fault.line, fault.element, fault.expected, fault.fix);
    if (document.root) {
        const auto& root = *document.root;
        if (kindOf(root.name) != kind) {
            findings.error(root.line, root.name,
                           "<" + std::string(rootName(kind)) + "> as the outermost element",
                           kindOf(root.name) == ProfileKind::Unknown
                               ? "rename it"
                               : "this is a " + std::string(profileKindName(kindOf(root.name))) +
                                     ": give it where one is asked for");
        } else {
            if (root.name != rootName(kind))
                findings.warning(root.line, root.name,
                                 "<" + std::string(rootName(kind)) + "> as the outermost element",
                                 "rename it, as in figure 3.3");
            reading.message = read(root, findings);
        }
    }
    reading.findings = findings.take();
    return reading;
}

}  // namespace

std::string Finding::toString() const {
    return file + (line > 0 ? ":" + std::to_string(line) : std::string()) + ": " +
           (severity == Severity::Error ? "error" : "warning") + ": " + element + ": " + expected + ": " +
           fix;
}

bool hasError(const std::vector<Finding>& findings) {
    return std::any_of(findings.begin(), findings.end(),
                       [](const auto& f) { return f.severity == Severity::Error; });
}

std::string_view profileKindName(ProfileKind kind) {
    switch (kind) {
        case ProfileKind::Basic:
            return "basic profile";
        case ProfileKind::Services:
            return "services profile";
        case ProfileKind::Global:
            return "global services profile";
        case ProfileKind::Unknown:
            break;
    }
    return "unknown";
}

ProfileKind detectKind(std::string_view xml) {
    while (true) {
        const auto tag = xml.find('<');
        if (tag == std::string_view::npos) return ProfileKind::Unknown;
        xml.remove_prefix(tag);
        std::string_view closing;
        if (xml.starts_with("<!--"))
            closing = "-->";
        else if (xml.starts_with("<?"))
            closing = "?>";
        else if (xml.starts_with("<!"))
            closing = ">";
        else
            return kindOf(xml.substr(1, xml.find_first_of(" \t\r\n/>", 1) - 1));
        const auto end = xml.find(closing);
        if (end == std::string_view::npos) return ProfileKind::Unknown;
        xml.remove_prefix(end + closing.size());
    }
}

Reading<proto::BasicProfile> readBasicProfile(std::string_view xml, std::string_view file_name) {
    return readProfile<proto::BasicProfile>(xml, file_name, ProfileKind::Basic, readBasic);
}

Reading<proto::ServicesProfile> readServicesProfile(std::string_view xml, std::string_view file_name) {
    return readProfile<proto::ServicesProfile>(xml, file_name, ProfileKind::Services, profiles::readServices);
}

Reading<proto::GlobalProfile> readGlobalProfile(std::string_view xml, std::string_view file_name) {
    return readProfile<proto::GlobalProfile>(xml, file_name, ProfileKind::Global, profiles::readGlobal);
}

ProfileText readProfileText(const std::filesystem::path& path, std::string_view shown_name) {
    ProfileText text;
    const auto unreadable = [&](std::string expected, std::string fix) {
        text.unreadable =
            Finding{std::string(shown_name), 0, Severity::Error, "file", std::move(expected), std::move(fix)};
        return text;
    };
    std::error_code failure;
    const auto status = std::filesystem::status(path, failure);
    if (!std::filesystem::exists(status))
        return unreadable("expected a profile, found no file of this name", "check the path");
    if (!std::filesystem::is_regular_file(status))
        return unreadable("a regular file", "name the profile itself");
    std::ifstream file(path, std::ios::binary);
    if (!file) return unreadable("a file that may be read", "check its permissions");
    text.xml.resize(kMaxXmlBytes + 1);
    file.read(text.xml.data(), static_cast<std::streamsize>(text.xml.size()));
    if (file.bad()) return unreadable("a file that can be read", "check the disk, and try again");
    text.xml.resize(static_cast<std::size_t>(file.gcount()));
    return text;
}

ProfileCheck checkProfileFile(const std::filesystem::path& path) {
    ProfileCheck check;
    const std::string name = path.string();
    const auto text = readProfileText(path, name);
    if (text.unreadable) {
        check.findings.push_back(*text.unreadable);
        return check;
    }
    const auto& xml = text.xml;
    check.readable = true;
    check.kind = detectKind(xml);
    switch (check.kind) {
        case ProfileKind::Basic:
            check.findings = readBasicProfile(xml, name).findings;
            return check;
        case ProfileKind::Services:
            check.findings = readServicesProfile(xml, name).findings;
            return check;
        case ProfileKind::Global:
            check.findings = readGlobalProfile(xml, name).findings;
            return check;
        case ProfileKind::Unknown:
            break;
    }
    Findings findings(name);
    const auto document = parseXml(xml);
    for (const auto& fault : document.faults)
        findings.error(fault.line, fault.element, fault.expected, fault.fix);
    if (document.root)
        findings.error(document.root->line, document.root->name,
                       "one of <BasicProfile>, <ServiceProfile>, <GlobalProfile> as the outermost element",
                       "rename it");
    check.findings = findings.take();
    return check;
}

}  // namespace axon
