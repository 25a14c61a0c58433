// SPDX-License-Identifier: MIT
#pragma once
#include <axon/profile.pb.h>

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace axon {

/// One thing to fix in a profile. docs/reference/profiles.md lists what is an error and what a warning.
struct Finding {
    enum class Severity { Warning, Error };

    std::string file;
    int line = 0;  ///< from 1; 0 = the whole file
    Severity severity = Severity::Error;
    std::string element;   ///< `Param "Distance"`, with the attribute where it is about one
    std::string expected;  ///< what was expected, and what was found
    std::string fix;       ///< what to write instead

    /// `file:line: severity: element: what was expected: how to fix it`
    std::string toString() const;
};

bool hasError(const std::vector<Finding>& findings);

/// A message and all findings of its file, in the order of lines. The message is complete when ok(); with
/// errors it holds what could be read and is good for display only.
template <class Message>
struct Reading {
    Message message;
    std::vector<Finding> findings;

    bool ok() const { return !hasError(findings); }
};

/// The largest number of findings that are kept. If there are more, one further finding says so.
inline constexpr std::size_t kMaxFindings = 500;

enum class ProfileKind { Unknown, Basic, Services, Global };

/// "basic profile", "services profile", "global services profile", "unknown".
std::string_view profileKindName(ProfileKind kind);

/// By the name of the root element; the text need not be a correct profile.
ProfileKind detectKind(std::string_view xml);

/// The three readers turn the seed's XML (figures 3.2, 3.3, A.1) into messages. They are pure functions of
/// the text: any thread, no file and no network access, nothing kept. `file_name` only appears in findings.
/// They never throw for bad input: whatever is wrong with the text is a finding.
///
/// entity_id, is_exec and missing are not of the profile and stay empty; Service.id is the position in the
/// profile; CtrlParam.ready says that the profile gives a value, which is `initial`.
Reading<proto::BasicProfile> readBasicProfile(std::string_view xml, std::string_view file_name);
Reading<proto::ServicesProfile> readServicesProfile(std::string_view xml, std::string_view file_name);
Reading<proto::GlobalProfile> readGlobalProfile(std::string_view xml, std::string_view file_name);

/// The text of a profile's file, or why there is none.
struct ProfileText {
    std::string xml;                    ///< cut one byte behind kMaxXmlBytes, which the readers then report
    std::optional<Finding> unreadable;  ///< no such file, no permission, not a regular file
};

/// `shown_name` is what findings call it. Never throws for what is wrong with the file.
ProfileText readProfileText(const std::filesystem::path& path, std::string_view shown_name);

struct ProfileCheck {
    bool readable =
        false;  ///< false: no such file, no permission, not a regular file; one finding says which
    ProfileKind kind = ProfileKind::Unknown;
    std::vector<Finding> findings;
};

/// Reads the file, finds out which of the three it is, and runs its reader.
ProfileCheck checkProfileFile(const std::filesystem::path& path);

}  // namespace axon
